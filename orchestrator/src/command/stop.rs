//! `orchestrator stop`: an orderly stop of a run that another process runs.

use crate::run::identity::{Identity, host_name, is_evaluation};
use crate::run::lock::{Held, holder};
use crate::run::signal::ask_to_stop;
use crate::showing::terminal;
use crate::suite;
use anyhow::{Result, bail};
use proto::run_folder::RunFolder;
use proto::run_state::Ending;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// How often to look whether it has stopped.
const LOOK: Duration = Duration::from_millis(50);

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
            Held::By(signed) if asked != Some(signed.pid) => {
                match ask_to_stop(signed.pid, &folder.orchestrator_lock()) {
                    Ok(()) => {
                        tracing::info!("asked pid {} to {asked_to}", signed.pid);
                        asked = Some(signed.pid);
                    }
                    Err(error) => {
                        // A holder that is just ending, or just starting, looks like a stranger for a moment.
                        std::thread::sleep(LOOK);
                        if holder(&folder)? == Held::By(signed) {
                            return Err(error);
                        }
                    }
                }
            }
            // It is just starting, or has been asked.
            Held::Unsigned | Held::By(_) => {}
        }
        if begin.elapsed() > Duration::from_secs(args.timeout) {
            bail!("{root} has not stopped within {} s; it still may", args.timeout);
        }
        // A released lock shows that it is over, and a lock wakes nobody who waits with a deadline.
        std::thread::sleep(LOOK);
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
        bail!("{what} {} failed: {}", identity.id, ended.reason.as_deref().unwrap_or("no reason is recorded"));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::lock::Holder;
    use std::process::Command;

    #[test]
    fn a_process_that_a_lock_names_falsely_is_not_signalled() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        Identity::new().unwrap().write(&folder).unwrap();
        let mut victim = Command::new("sleep").arg("60").spawn().unwrap();
        let planted = Holder { pid: victim.id(), host: host_name(), incarnation: 1 };
        std::fs::write(folder.orchestrator_lock(), toml::to_string(&planted).unwrap()).unwrap();
        let args = StopArgs { run: temporary.path().to_path_buf(), timeout: 5 };
        // Free, the lock names nobody.
        assert!(run(&args).unwrap_err().to_string().contains("cut off"));
        let held = std::fs::File::open(folder.orchestrator_lock()).unwrap();
        held.try_lock().unwrap();
        let message = format!("{:#}", run(&args).unwrap_err());
        assert!(message.contains("no orchestrator"), "{message}");
        assert!(victim.try_wait().unwrap().is_none(), "it was left alone");
        victim.kill().unwrap();
        victim.wait().unwrap();
    }
}
