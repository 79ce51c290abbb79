use crate::output::format::{self, counted};
use crate::output::terminal;
use crate::run::remains::{Remains, processes_of, survey, sweep};
use anyhow::{Result, bail};
use std::time::Duration;

/// Processes that have outlived their orchestrator have this long to save.
const PATIENCE: Duration = Duration::from_mins(1);

/// Free the shared memory that dead runs left
///
/// Living runs are not touched. Processes that have outlived their orchestrator are given time to save, then ended.
#[derive(Debug, clap::Args)]
pub struct CleanArgs {
    /// Only print what would be done
    #[arg(long)]
    dry_run: bool,
}

pub fn run(args: &CleanArgs) -> Result<()> {
    free(&survey()?, args.dry_run, PATIENCE)
}

/// Removes what is dead of all this. What cannot be removed does not keep the rest from it.
fn free(found: &[Remains], dry_run: bool, patience: Duration) -> Result<()> {
    let (mut freed, mut dead, mut living, mut failed) = (0, 0, 0, 0);
    for remains in found {
        let of = remains.run.as_ref().map_or_else(String::new, |run| format!(" of {}", run.display()));
        let prefix = remains.address.prefix().trim_end_matches('_');
        if remains.alive {
            living += 1;
            tracing::debug!("{prefix}{of} is alive");
            continue;
        }
        let names = counted(remains.names as u64, "name");
        let what = format!("{prefix}{of}: {names}, {}", format::bytes(remains.bytes));
        let left = processes_of(&remains.address);
        if dry_run {
            (dead, freed) = (dead + 1, freed + remains.bytes);
            terminal::out(&format!("would remove {what}; processes that still run: {}", left.len()));
            continue;
        }
        if !left.is_empty() {
            let processes = counted(left.len() as u64, "process");
            terminal::note(&format!("{prefix}: waiting up to {} s for {processes}", patience.as_secs()));
        }
        let swept = match sweep(&remains.address, patience) {
            Ok(swept) => swept,
            Err(error) => {
                failed += 1;
                terminal::note(&format!("{prefix} is not removed: {error:#}"));
                continue;
            }
        };
        (dead, freed) = (dead + 1, freed + remains.bytes);
        let killed = match swept.killed {
            0 => String::new(),
            killed => format!("; {} ended", counted(killed as u64, "process")),
        };
        terminal::out(&format!("removed {what}{killed}"));
    }
    let verb = if dry_run { "would be freed" } else { "freed" };
    let (dead, living) = (counted(dead, "dead run"), counted(living, "living run"));
    terminal::out(&format!("{} of {dead} {verb}, {living} left alone", format::bytes(freed)));
    if failed > 0 {
        bail!("{} could not be removed: the reasons stand above", counted(failed, "dead run"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::remains::claim;
    use std::path::Path;
    use wire::WireAddress;

    #[test]
    fn what_cannot_be_removed_does_not_stop_the_rest() {
        let address = |test: &str| WireAddress::new(&format!("test{test}{}", std::process::id()), 1);
        let (held, dead) = (address("held"), address("dead"));
        let claimed = claim(&held, Path::new("/r")).unwrap();
        std::fs::create_dir(dead.root()).unwrap();
        let found =
            [&held, &dead].map(|at| Remains { address: at.clone(), run: None, names: 1, bytes: 1, alive: false });
        let message = free(&found, false, Duration::ZERO).unwrap_err().to_string();
        assert!(message.contains("1 dead run could not"), "{message}");
        assert!(!dead.root().exists());
        drop(claimed);
        held.sweep().unwrap();
    }
}
