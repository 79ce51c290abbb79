use super::player::Player;
use crate::hosts::token::{draw, refuse_public};
use crate::output::{name, terminal};
use crate::preflight::programs;
use crate::run::identity::{host_name, no_folder};
use crate::viewer::RunReaders;
use crate::wrong::demand;
use anyhow::{Context, Result, bail, ensure};
use std::convert::Infallible;
use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempPath;
use view::data::Runs;
use view::{Settings, serve};

/// Show runs on a page: live, and any recorded episode from any camera
///
/// Serves a page to browsers on this machine until Ctrl-C. The address that it prints holds a token, without which
/// nothing of a run is shown. It only reads run folders, from a process of its own: it can be started and ended at any
/// time, and a run neither waits for it nor ends with it. Episodes are simulated again from their recorded actions and
/// drawn as they are looked at; nothing needs to have been recorded as pictures.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # all runs below runs/
  orchestrator view
  # these two, their curves over each other
  orchestrator view runs/a runs/b
  # the same episodes of two evaluations side by side
  orchestrator view --compare E1 E2
  # then the address that is printed there opens here, too
  ssh -L 8765:127.0.0.1:8765 HOST
  # for other machines, too
  orchestrator view --address 0.0.0.0
  # the token is the same at each start
  orchestrator view --token-file token")]
pub struct ViewArgs {
    /// Run folders, those of evaluations, or folders that hold runs [default: runs]
    #[arg(value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Show episodes of two evaluations or runs side by side
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with = "runs")]
    compare: Vec<PathBuf>,
    /// Open the page in a browser
    #[arg(long)]
    open: bool,
    #[command(flatten)]
    page: PageArgs,
}

/// Where the page is served.
#[derive(Debug, clap::Args)]
pub struct PageArgs {
    /// Port; another one is taken if it is in use and was not asked for [default: 8765]
    #[arg(long, value_name = "N")]
    port: Option<u16>,
    /// Address to listen at
    #[arg(long, value_name = "IP", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST), value_parser = ip)]
    address: IpAddr,
    /// Keep the token in this file: the same one at each start; made if it is not there
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

const PORT: u16 = 8765;
const PORTS: u16 = 20;
/// A shorter token could be guessed.
const TOKEN_LETTERS_MIN: usize = 16;
const OPENING: Duration = Duration::from_mins(1);
/// The server gives way to whatever trains on the machine.
const NICENESS: i32 = 10;

pub fn run(args: &ViewArgs) -> Result<()> {
    let (readers, open) = readers(args)?;
    let shows = crate::output::format::counted(readers.count() as u64, "run");
    let note = format!("shows {shows} until Ctrl-C; it only reads, and ends no run");
    show(Shown { readers, open, compare: !args.compare.is_empty(), player: None, note }, &args.page, args.open)
}

pub fn play(player: Player, page: &PageArgs, open: bool) -> Result<()> {
    let readers = RunReaders::of(vec![player.root.clone()]);
    let note = format!("{} plays until Ctrl-C, on the CPU", player.plays);
    show(Shown { readers, open: Vec::new(), compare: false, player: Some(player), note }, page, open)
}

struct Shown {
    readers: RunReaders,
    open: Vec<String>,
    compare: bool,
    player: Option<Player>,
    note: String,
}

fn show(shown: Shown, page: &PageArgs, open: bool) -> Result<()> {
    let listener = listen(page)?;
    let address = listener.local_addr().context("the listener has no address")?;
    let token = match &page.token_file {
        Some(file) => token_in(file)?,
        None => draw()?,
    };
    let place = link(address, &token);
    let settings = Settings {
        actor: programs::find("actor")?,
        token,
        open: shown.open,
        compare: shown.compare,
        play: shown.player.as_ref().map(|player| player.plays.clone()),
        program: name::called(),
        speed: shown.player.as_ref().map(|player| player.steps_per_s),
    };
    // Where it is refused the server is as important as others.
    let _ = rustix::process::setpriority_process(None, NICENESS);
    terminal::out(&format!("view: {place}"));
    terminal::note(&shown.note);
    let opened = if open { open_browser(&place) } else { None };
    serve_until_interrupted(listener, Arc::new(shown.readers), settings, shown.player, opened)
}

fn readers(args: &ViewArgs) -> Result<(RunReaders, Vec<String>)> {
    let asked = if args.compare.is_empty() { &args.runs } else { &args.compare };
    for path in asked {
        demand!(!path.is_file(), "{}", no_folder(path));
        demand!(path.is_dir(), "{} is not a folder: give the folder of a run, or one that holds runs", path.display());
    }
    if asked.is_empty() && !Path::new("runs").is_dir() {
        bail!(
            "there is no folder runs/ here: give the folder of a run, start one with `orchestrator up`, or see the shipped \
             policy at work with `orchestrator play`"
        );
    }
    let readers = RunReaders::of(if asked.is_empty() { vec![PathBuf::from("runs")] } else { asked.clone() });
    let (count, open) = (readers.count(), readers.names_of(asked));
    if count == 0 && !asked.is_empty() {
        bail!("there is no run in {} (a run has a run.toml)", asked[0].display());
    }
    ensure!(args.compare.is_empty() || open.len() == 2, "--compare takes the folders of two different runs");
    Ok((readers, open))
}

fn serve_until_interrupted(
    listener: TcpListener,
    runs: Arc<dyn Runs>,
    settings: Settings,
    mut player: Option<Player>,
    page: Option<TempPath>,
) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let served = runtime.block_on(async {
        use tokio::signal::unix::{SignalKind, signal};
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let (mut interrupted, mut terminated) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        let end = async move {
            tokio::select! {
                _ = interrupted.recv() => {}
                _ = terminated.recv() => {}
            }
        };
        let served = tokio::select! {
            served = serve(listener, runs, settings, end) => served.map_err(Into::into),
            failed = played(player.as_mut()) => failed,
            never = keep(page) => match never {},
        };
        let stopped = match &mut player {
            Some(player) => player.stop().await,
            None => Ok(()),
        };
        served.and(stopped)
    });
    // Readings that still go on are nobody's any more.
    runtime.shutdown_background();
    served
}

/// Lets a policy play as long as it can; without one nothing ends.
async fn played(player: Option<&mut Player>) -> Result<()> {
    match player {
        Some(player) => match player.play().await? {},
        None => std::future::pending().await,
    }
}

async fn keep(page: Option<TempPath>) -> Infallible {
    tokio::time::sleep(OPENING).await;
    drop(page);
    std::future::pending().await
}

fn listen(args: &PageArgs) -> Result<TcpListener> {
    let ports = args.port.map_or(PORT..=PORT + PORTS, |port| port..=port);
    let (first, mut last_error) = (*ports.start(), None);
    for port in ports {
        match TcpListener::bind(SocketAddr::new(args.address, port)) {
            Ok(listener) => {
                listener.set_nonblocking(true).context("cannot listen")?;
                return Ok(listener);
            }
            Err(error) => last_error = Some(error),
        }
    }
    let cause = last_error.map_or_else(String::new, |error| error.to_string());
    bail!("cannot listen at {}: {cause}; choose another port with --port", SocketAddr::new(args.address, first))
}

/// The token in a file, which is made if it is not there.
fn token_in(path: &Path) -> Result<String> {
    use std::os::unix::fs::OpenOptionsExt;
    let text = match proto::bounded::read_text(path) {
        Ok(text) => text,
        Err(_) if !path.exists() => {
            let text = draw()?;
            let mut options = std::fs::OpenOptions::new();
            let file = options.write(true).create_new(true).mode(0o600).open(path);
            let written = file.and_then(|mut file| file.write_all(text.as_bytes()));
            written.with_context(|| format!("cannot write {}", path.display()))?;
            text
        }
        Err(error) => return Err(error).with_context(|| path.display().to_string()),
    };
    refuse_public(path, &std::fs::metadata(path)?)?;
    let text = text.trim();
    let is_plain = text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte));
    ensure!(
        is_plain && text.len() >= TOKEN_LETTERS_MIN,
        "{} holds no token: at least {TOKEN_LETTERS_MIN} letters, digits, - and _ (remove it, and one is made)",
        path.display()
    );
    Ok(text.to_owned())
}

fn ip(text: &str) -> Result<IpAddr, String> {
    text.parse().map_err(|_| match text.parse::<SocketAddr>() {
        Ok(both) => format!("give the port alone: --address {} --port {}", both.ip(), both.port()),
        Err(_) => "expected an address of this machine, 127.0.0.1 or 0.0.0.0 for all".to_owned(),
    })
}

/// The address that a browser opens.
///
/// Browsers do not send what stands behind `#`. So no log has the token, and the page takes it out of the address.
fn link(address: SocketAddr, token: &str) -> String {
    let host =
        if address.ip().is_unspecified() { format!("{}:{}", host_name(), address.port()) } else { address.to_string() };
    format!("http://{host}/#token={token}")
}

/// Opens the page in a browser, by a file that leads there: command lines, which hold its name, can be read by every
/// user. A browser that is not there is no failure: the address was printed.
fn open_browser(place: &str) -> Option<TempPath> {
    let opened = page_that_leads_to(place).and_then(|page| {
        let mut command = Command::new("xdg-open");
        command.arg(&page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().map(|_| page)
    });
    let said = |error| terminal::note(&format!("cannot open a browser by xdg-open ({error}): open the address above"));
    opened.map_err(said).ok()
}

/// A file for this user alone, in the home folder: a browser in a sandbox (snap) sees neither /tmp nor hidden folders.
fn page_that_leads_to(place: &str) -> std::io::Result<TempPath> {
    let folder = std::env::home_dir().unwrap_or_else(std::env::temp_dir);
    let mut page = tempfile::Builder::new().prefix("stillroom-view-").suffix(".html").tempfile_in(folder)?;
    writeln!(
        page,
        "<!doctype html><meta http-equiv=\"refresh\" content=\"0; url={place}\"><a href=\"{place}\">Stillroom</a>"
    )?;
    Ok(page.into_temp_path())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_address_holds_the_token_and_a_name_that_can_be_opened() {
        let loopback: SocketAddr = "127.0.0.1:8765".parse().unwrap();
        assert_eq!(link(loopback, "ab"), "http://127.0.0.1:8765/#token=ab");
        let all: SocketAddr = "0.0.0.0:80".parse().unwrap();
        assert_eq!(link(all, "ab"), format!("http://{}:80/#token=ab", host_name()));
    }

    #[test]
    fn a_token_in_a_file_is_made_once_and_a_weak_one_refused() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        let made = token_in(&path).unwrap();
        assert_eq!((made.len(), token_in(&path).unwrap()), (64, made));
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        for weak in ["", "short", "0123456789abcde\n", "0123456789 abcdef", "0123456789abcdef;"] {
            std::fs::write(&path, weak).unwrap();
            assert!(token_in(&path).unwrap_err().to_string().contains("holds no token"), "{weak}");
        }
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
        let refused = token_in(&path).unwrap_err().to_string();
        assert!(refused.contains("every user") && refused.contains("chmod 600"), "{refused}");
    }
}
