//! `orchestrator clean`: frees the shared memory of dead runs.

use crate::run::remains::{processes_of, survey, sweep};
use crate::showing::format::{self, counted};
use crate::showing::terminal;
use anyhow::Result;
use std::time::Duration;

/// Free the shared memory that dead runs left
///
/// Living runs are not touched. Processes that have outlived their orchestrator are given time to save, then ended.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator clean --dry-run
  orchestrator clean --patience 0")]
pub struct CleanArgs {
    /// Only say what would be done
    #[arg(long)]
    dry_run: bool,
    /// Seconds to wait for processes that have outlived their orchestrator
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    patience: u64,
}

/// Runs the command.
pub fn run(args: &CleanArgs) -> Result<()> {
    let (mut freed, mut dead, mut living) = (0, 0, 0);
    for remains in survey()? {
        let of = remains.run.as_ref().map_or_else(String::new, |run| format!(" of {}", run.display()));
        let prefix = remains.address.prefix().trim_end_matches('_');
        if remains.alive {
            living += 1;
            tracing::debug!("{prefix}{of} is alive");
            continue;
        }
        dead += 1;
        freed += remains.bytes;
        let names = counted(remains.names as u64, "name");
        let what = format!("{prefix}{of}: {names}, {}", format::bytes(remains.bytes));
        let left = processes_of(&remains.address);
        if args.dry_run {
            terminal::out(&format!("would remove {what}; processes that still run: {}", left.len()));
            continue;
        }
        if !left.is_empty() {
            let processes = counted(left.len() as u64, "process");
            terminal::note(&format!("{prefix}: waiting up to {} s for {processes}", args.patience));
        }
        let swept = sweep(&remains.address, Duration::from_secs(args.patience))?;
        let killed = match swept.killed {
            0 => String::new(),
            killed => format!("; {} ended", counted(killed as u64, "process")),
        };
        terminal::out(&format!("removed {what}{killed}"));
    }
    let verb = if args.dry_run { "would be freed" } else { "freed" };
    let (dead, living) = (counted(dead, "dead run"), counted(living, "living run"));
    terminal::out(&format!("{} of {dead} {verb}, {living} left alone", format::bytes(freed)));
    Ok(())
}
