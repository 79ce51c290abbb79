//! An `orchestrator` that another `orchestrator` started: a suite starts runs and evaluations, a run starts
//! validations. The child ends with its parent: when a suite is killed, its runs save and stop.

use anyhow::{Context, Result, ensure};
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};
use std::os::unix::process::CommandExt;
use std::process::Command;

/// A command that starts this very program, also when its file has been replaced since it began: suites take days, and
/// in days people compile.
pub fn this_program() -> Command {
    let mut command = Command::new("/proc/self/exe");
    // What people find in a list of processes.
    if let Ok(path) = std::env::current_exe() {
        command.arg0(path);
    }
    command
}

pub fn follow(parent: u32, signal: Signal) -> Result<()> {
    set_parent_process_death_signal(Some(signal)).context("cannot follow the parent process")?;
    // It may have died before that: then its child is someone else's now.
    let now = getppid().map_or(0, Pid::as_raw_pid);
    ensure!(u32::try_from(now) == Ok(parent), "process {parent}, which started this one, is gone");
    Ok(())
}
