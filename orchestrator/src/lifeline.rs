//! A process that another `orchestrator` has started leaves with it: when a suite is killed, its runs save and stop.

use anyhow::{Context, Result, ensure};
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

/// From now on the kernel sends this process `signal` when `parent` dies.
pub fn follow(parent: u32, signal: Signal) -> Result<()> {
    set_parent_process_death_signal(Some(signal)).context("cannot follow the parent process")?;
    // It may have died before that: then its child is someone else's now.
    let now = getppid().map_or(0, Pid::as_raw_pid);
    ensure!(u32::try_from(now) == Ok(parent), "process {parent}, which started this one, is gone");
    Ok(())
}
