//! The terminal around the screen: it is taken over, drawn on until a key or a signal leaves, and given back, also by a
//! panic.

use super::draw::draw;
use super::model::{Look, Model};
use crate::output::terminal;
use crate::suite::Standing;
use crate::viewer::RunReaders;
use anyhow::{Context, Result, bail};
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread;
use std::time::{Duration, Instant};
use tokio::signal::unix::{SignalKind, signal};
use view::data::Runs;

const LOOK_EVERY: Duration = Duration::from_secs(1);
const WAIT: Duration = Duration::from_millis(100);
/// From a signal until the process ends, if the screen has not.
const PATIENCE: Duration = Duration::from_secs(2);

enum News {
    Look(Box<Look>),
    Leave,
}

/// `suite`: the folder of a suite, whose run at work is shown, whichever that is.
pub fn show(readers: RunReaders, run: String, suite: Option<PathBuf>) -> Result<()> {
    let (sender, inbox) = channel();
    leave_on_signals(sender.clone())?;
    let look = move || look(&readers, run, suite.as_deref(), &sender);
    thread::Builder::new().name("look".to_owned()).spawn(look).context("a thread")?;
    let mut screen = Screen::open()?;
    let mut model = Model::default();
    let mut is_new = true;
    loop {
        if GIVEN_BACK.load(Ordering::Relaxed) {
            bail!("the reader of the run failed, see above");
        }
        if is_new {
            screen.terminal.draw(|frame| draw(frame, &model)).context("cannot draw on the terminal")?;
        }
        is_new = false;
        let mut wait = WAIT;
        while event::poll(wait).context("the terminal")? {
            wait = Duration::ZERO;
            match event::read().context("the terminal")? {
                Event::Key(key) if !model.key(key) => return Ok(()),
                _ => is_new = true,
            }
        }
        match newest(&inbox)? {
            Some(News::Leave) => return Ok(()),
            Some(News::Look(look)) => {
                model.take(*look);
                is_new = true;
            }
            None => {}
        }
    }
}

fn newest(inbox: &Receiver<News>) -> Result<Option<News>> {
    match inbox.try_recv() {
        Ok(news) => Ok(Some(news)),
        Err(TryRecvError::Empty) => Ok(None),
        Err(TryRecvError::Disconnected) => bail!("nobody reads the run any more"),
    }
}

fn look(readers: &RunReaders, mut run: String, suite: Option<&Path>, sender: &Sender<News>) {
    let (mut edition, mut known) = (0, 0);
    loop {
        let begun = Instant::now();
        let newest = suite.and_then(|_| readers.newest_run(true)).filter(|newest| newest.id != run);
        if let Some(newest) = newest {
            (run, edition, known) = (newest.id, 0, 0);
        }
        let curves = readers.curves(&run, edition, known);
        if let Ok(curves) = &curves {
            (edition, known) = (curves.edition, curves.from + curves.frames.len());
        }
        let live = readers.live(&run);
        let standing = suite.and_then(|suite| Standing::read(suite).ok());
        let suite = standing.zip(live.as_ref().ok()).map(|(suite, live)| suite.around(Path::new(&live.card.folder)));
        let look = Look { live, curves, suite };
        if sender.send(News::Look(Box::new(look))).is_err() {
            return;
        }
        thread::sleep(LOOK_EVERY.saturating_sub(begun.elapsed()).max(WAIT));
    }
}

fn leave_on_signals(sender: Sender<News>) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("tokio")?;
    let entered = runtime.enter();
    let mut interrupt = signal(SignalKind::interrupt()).context("SIGINT")?;
    let mut terminate = signal(SignalKind::terminate()).context("SIGTERM")?;
    let mut hang_up = signal(SignalKind::hangup()).context("SIGHUP")?;
    drop(entered);
    let wait = move || {
        runtime.block_on(async {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
                _ = hang_up.recv() => {}
            }
        });
        // Whoever does not listen has left.
        let _ = sender.send(News::Leave);
        // crossterm reads a terminal that is gone without end.
        thread::sleep(PATIENCE);
        give_back();
        std::process::exit(0);
    };
    thread::Builder::new().name("signals".to_owned()).spawn(wait).context("a thread")?;
    Ok(())
}

struct Screen {
    terminal: DefaultTerminal,
}

/// A panic, of whichever thread, has given the terminal back, before its message.
static GIVEN_BACK: AtomicBool = AtomicBool::new(false);

impl Screen {
    fn open() -> Result<Self> {
        terminal::mute(true);
        let opened = ratatui::try_init();
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            GIVEN_BACK.store(true, Ordering::Relaxed);
            // The library's, which gives the terminal back; then the one that writes the message.
            before(panic);
        }));
        opened.map(|terminal| Self { terminal }).context("cannot take over the terminal").inspect_err(|_| give_back())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        give_back();
    }
}

fn give_back() {
    // Twice would put the cursor on what was written since.
    if !GIVEN_BACK.swap(true, Ordering::Relaxed) {
        ratatui::restore();
    }
    terminal::mute(false);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use rustix::termios::tcgetattr;
    use std::fs::File;
    use std::io::Read;
    use std::os::fd::OwnedFd;
    use std::process::{Child, Command};

    const CHILD: &str = "STILLROOM_SCREEN_TEST";

    /// A test of this file, started again on a terminal of its own: both sides of the terminal, and its modes before.
    fn on_a_terminal(test: &str) -> (OwnedFd, File, String, Child) {
        let terminal = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&terminal).unwrap();
        unlockpt(&terminal).unwrap();
        let name = ptsname(&terminal, Vec::new()).unwrap().into_string().unwrap();
        let line = File::options().read(true).write(true).open(name).unwrap();
        let before = modes(&line);
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", &format!("tui::session::tests::{test}"), "--nocapture", "--test-threads=1"]);
        command.env(CHILD, "yes").env_remove("RUST_BACKTRACE");
        let copy = || line.try_clone().unwrap();
        let child = command.stdin(copy()).stdout(copy()).stderr(copy()).spawn().unwrap();
        (terminal, line, before, child)
    }

    fn modes(line: &File) -> String {
        format!("{:?}", tcgetattr(line).unwrap())
    }

    #[test]
    fn a_signal_ends_it_also_where_the_terminal_is_gone() {
        if std::env::var_os(CHILD).is_some() {
            let (sender, _inbox) = channel();
            leave_on_signals(sender).unwrap();
            let _screen = Screen::open().unwrap();
            loop {
                let _ = event::poll(WAIT);
            }
        }
        let (terminal, line, _, mut child) = on_a_terminal("a_signal_ends_it_also_where_the_terminal_is_gone");
        let (mut terminal, mut shown) = (File::from(terminal), String::new());
        while !shown.contains("\x1b[?1049h") {
            let mut bytes = [0; 64];
            let count = terminal.read(&mut bytes).unwrap();
            shown += &String::from_utf8_lossy(&bytes[..count]);
        }
        drop((terminal, line));
        rustix::process::kill_process(rustix::process::Pid::from_child(&child), rustix::process::Signal::TERM).unwrap();
        assert!(child.wait().unwrap().success());
    }

    /// The test takes over the terminal and panics.
    #[test]
    fn a_panic_gives_the_terminal_back_before_its_message() {
        if std::env::var_os(CHILD).is_some() {
            let _screen = Screen::open().unwrap();
            panic!("the drawing went wrong");
        }
        let (terminal, line, before, mut child) = on_a_terminal("a_panic_gives_the_terminal_back_before_its_message");
        assert!(!child.wait().unwrap().success());
        assert_eq!(modes(&line), before, "modes of the terminal");
        // Whoever holds a descriptor of its other side keeps a terminal from ending.
        drop(line);
        let mut bytes = Vec::new();
        // Without anybody on its other side a terminal ends with an error.
        let _ = File::from(terminal).read_to_end(&mut bytes);
        let text = String::from_utf8_lossy(&bytes);
        let at = |what: &str| text.find(what).unwrap_or_else(|| panic!("no {what:?} in {text:?}"));
        assert!(at("\x1b[?1049h") < at("\x1b[?1049l"), "{text:?}");
        assert!(at("\x1b[?1049l") < at("the drawing went wrong"), "{text:?}");
        assert_eq!(text.matches("\x1b[?1049l").count(), 1, "{text:?}");
    }
}
