//! `orchestrator logs`: what the processes of a run have logged, by time.

use crate::run::identity::Identity;
use crate::run::lock::{Held, holder};
use crate::showing::terminal;
use crate::suite;
use crate::viewing::logbook::{Entry, Logbook, logs_of};
use anyhow::{Context, Result, bail, ensure};
use proto::run_folder::RunFolder;
use std::path::PathBuf;
use std::time::Duration;

/// Show what the processes of a run or an evaluation have logged, by time
///
/// Lines of several processes come with the name of theirs before them. It only reads, while the run goes on and after
/// its end.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator logs runs/a                         all of it
  orchestrator logs runs/a -f -n 20                the last 20 lines, then what comes, until the run has ended
  orchestrator logs runs/a --process learner       all learners
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

/// How often is looked for new lines.
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// Runs the command.
pub fn run(args: &LogsArgs) -> Result<()> {
    let folder = RunFolder::new(&args.run);
    suite::refuse(folder.root())?;
    Identity::read(&folder)?;
    let mut book = Logbook::of(folder.clone(), args.process.clone());
    let running = || holder(&folder).map(|held| held != Held::Free);
    // A process that is yet to be started has no log yet.
    let unknown = book.unknown();
    if !(unknown.is_empty() || args.follow && running()?) {
        let known: Vec<String> = logs_of(&folder).into_iter().map(|(name, _)| name).collect();
        ensure!(!known.is_empty(), "{} holds no log yet: it was never started", folder.root().display());
        bail!(
            "{} holds no log of {}: there are those of {}",
            folder.root().display(),
            unknown.join(", "),
            known.join(", ")
        );
    }
    let mut skip_to = args.lines;
    loop {
        // First whether it runs: what is written until then is read after it.
        let goes_on = args.follow && running()?;
        let entries = book.read().with_context(|| format!("the logs of {}", folder.root().display()))?;
        let skipped = skip_to.take().map_or(0, |lines| entries.len().saturating_sub(lines));
        if !show(&entries[skipped..], book.is_of_many())? || !goes_on {
            return Ok(());
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// False if nobody reads any more.
fn show(entries: &[Entry], of_many: bool) -> Result<bool> {
    for Entry { process, line, .. } in entries {
        let line = if of_many { format!("{process:12}  {line}") } else { line.clone() };
        match terminal::offer(&line) {
            Ok(()) => {}
            Err(error) if terminal::is_unread(&error) => return Ok(false),
            Err(error) => return Err(error).context("standard output"),
        }
    }
    Ok(true)
}
