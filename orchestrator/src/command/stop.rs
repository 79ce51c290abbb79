//! `orchestrator stop`: an orderly stop of a run that another process runs.

use crate::run::identity::{Ending, Identity, host_name, is_evaluation};
use crate::run::lock::{Held, holder};
use crate::showing::terminal;
use crate::suite;
use anyhow::{Result, bail};
use proto::run_folder::RunFolder;
use rustix::process::{Pid, Signal, kill_process};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Save and stop a run from another terminal
///
/// Does what Ctrl-C in its terminal does, and waits until it is done. `orchestrator resume RUN` goes on with it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  orchestrator stop runs/20261121-020423-demo-1")]
pub struct StopArgs {
    /// Run folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Give up waiting after this many seconds; the run goes on stopping
    #[arg(long, value_name = "SECONDS", default_value_t = 3600)]
    timeout: u64,
}

/// Runs the command.
pub fn run(args: &StopArgs) -> Result<()> {
    let folder = RunFolder::new(&args.run);
    suite::refuse(folder.root())?;
    Identity::read(&folder)?;
    let (what, asked_to) = if is_evaluation(&folder) { ("evaluation", "stop") } else { ("run", "save and stop") };
    let root = folder.root().display();
    let begin = Instant::now();
    let mut asked = None;
    loop {
        match holder(&folder)? {
            Held::Free => break,
            Held::By(holder) if holder.host != host_name() => {
                bail!("{root} is run on {}: stop it there", holder.host);
            }
            // The lock is held and its holder signed it: the process id is that of the orchestrator.
            Held::By(holder) if asked != Some(holder.pid) => {
                let Some(pid) = i32::try_from(holder.pid).ok().and_then(Pid::from_raw) else {
                    bail!("orchestrator.lock names no process");
                };
                match kill_process(pid, Signal::TERM) {
                    Ok(()) => tracing::info!("asked pid {} to {asked_to}", holder.pid),
                    // It has just gone by itself.
                    Err(rustix::io::Errno::SRCH) => {}
                    Err(error) => bail!("cannot ask pid {} to stop: {error}", holder.pid),
                }
                asked = Some(holder.pid);
            }
            // It is just starting, or has been asked.
            Held::Unsigned | Held::By(_) => {}
        }
        if begin.elapsed() > Duration::from_secs(args.timeout) {
            bail!("{root} has not stopped within {} s; it still may", args.timeout);
        }
        // The lock tells when it is over, and a lock wakes nobody who waits with a deadline.
        std::thread::sleep(Duration::from_millis(50));
    }
    if asked.is_none() {
        terminal::note(&format!("{root} does not run"));
    }
    let identity = Identity::read(&folder)?;
    let Some(ended) = identity.incarnations.last().and_then(|last| last.ended.as_ref()) else {
        if is_evaluation(&folder) {
            bail!("{root} was cut off: the evaluation has no result");
        }
        bail!("{root} was cut off; `orchestrator resume {root}` goes on from its last checkpoint");
    };
    if ended.how == Ending::Failed {
        bail!("{what} {} failed: {}", identity.id, ended.reason.as_deref().unwrap_or("no reason is written down"));
    }
    terminal::out(&format!("{what} {} {}", identity.id, ended.how));
    if let Some(weights) = &ended.weights {
        terminal::out(&format!("weights: {weights}"));
    }
    if let Some(frames) = ended.frames {
        terminal::out(&format!("frames: {frames}"));
    }
    Ok(())
}
