use crate::output::terminal;
use crate::run::identity::Identity;
use crate::run::lock::{LockState, holder};
use crate::suite;
use crate::viewer::logbook::{Entry, Logbook, logs_of};
use crate::wrong::reject;
use anyhow::{Context, Result, ensure};
use proto::run_folder::RunFolder;
use std::path::PathBuf;
use std::time::Duration;

/// Show what the processes of a run or an evaluation have logged, by time
///
/// Lines of several processes come with the name of theirs before them. It only reads, while the run goes on and after
/// its end.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # all of it
  orchestrator logs runs/a
  # the last 20 lines, then what comes, until the run has ended
  orchestrator logs runs/a -f -n 20
  # all learners
  orchestrator logs runs/a --process learner
  orchestrator logs runs/a --process orchestrator --process actor-03")]
pub struct LogsArgs {
    /// Run folder, or that of an evaluation
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Go on with what is logged from now on, until the run has ended; Ctrl-C leaves it
    #[arg(short, long)]
    follow: bool,
    /// Only of this process, such as orchestrator or actor-03, or of all actors or learners; repeat it for more
    #[arg(long, value_name = "NAME")]
    process: Vec<String>,
    /// Only the last N of the lines that are there
    #[arg(short = 'n', long, value_name = "N")]
    lines: Option<usize>,
}

const LOOK_EVERY: Duration = Duration::from_millis(200);

pub fn run(args: &LogsArgs) -> Result<()> {
    let folder = RunFolder::new(&args.run);
    suite::refuse(folder.root())?;
    Identity::read(&folder)?;
    let mut book = Logbook::of(folder.clone(), args.process.clone());
    let running = || holder(&folder).map(|held| held != LockState::Free);
    // A process that is yet to be started has no log yet.
    let unknown = book.unknown()?;
    if !(unknown.is_empty() || args.follow && running()?) {
        let known: Vec<String> = logs_of(&folder)?.into_iter().map(|log| log.name).collect();
        ensure!(!known.is_empty(), "{} holds no log yet: it was never started", folder.root().display());
        reject!(
            "{} holds no log of {}: there are those of {}",
            folder.root().display(),
            unknown.join(", "),
            known.join(", ")
        );
    }
    // They are read twice where only the last are wanted: so a few lines are in memory, however many there are.
    let mut skipped = args.lines.map_or(0, |lines| count(&folder, args).saturating_sub(lines));
    let mut told = false;
    loop {
        // First whether it runs: what is written until then is read after it.
        let goes_on = args.follow && running()?;
        let read = book.read(|entry, of_many| {
            if is_head(entry, of_many) {
                return Ok(true);
            }
            if skipped > 0 {
                skipped -= 1;
                return Ok(true);
            }
            show(entry, of_many)
        });
        if let Some(note) = book.note.as_ref().filter(|_| !std::mem::replace(&mut told, true)) {
            terminal::note(note);
        }
        if !read.with_context(|| folder.root().display().to_string())? || !goes_on {
            return Ok(());
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

fn count(folder: &RunFolder, args: &LogsArgs) -> usize {
    let mut lines = 0;
    // What cannot be read is told when it is shown.
    let _ = Logbook::of(folder.clone(), args.process.clone()).read(|entry, of_many| {
        lines += usize::from(!is_head(entry, of_many));
        Ok(true)
    });
    lines
}

/// Every child's log begins with such a line, without a time. Of many these came before all text.
fn is_head(Entry { line, .. }: &Entry, of_many: bool) -> bool {
    of_many && line.starts_with("--- ") && line.contains(", start 1 of ")
}

/// False if nobody reads any more.
fn show(Entry { process, line, .. }: &Entry, of_many: bool) -> Result<bool> {
    let line = if of_many { format!("{process:12}  {line}") } else { line.clone() };
    match terminal::offer(&line) {
        Ok(()) => Ok(true),
        Err(error) if terminal::is_unread(&error) => Ok(false),
        Err(error) => Err(error).context("standard output"),
    }
}
