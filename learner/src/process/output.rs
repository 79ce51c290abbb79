//! Standard output: the orchestrator's alone, which reads events there.

use anyhow::{Context, Result};
use rustix::io::fcntl_dupfd_cloexec;
use rustix::stdio::{dup2_stdout, stderr, stdout};
use std::fs::File;
use std::io::LineWriter;

/// Takes standard output for events. What anything else in this process prints there from now on goes to standard error,
/// and so to the log: libraries do print, for example NCCL when `NCCL_DEBUG` is set, and each of their lines would stand
/// among the events.
pub(super) fn claim_stdout() -> Result<LineWriter<File>> {
    // Above the three that a program may expect to be what they are.
    let own = fcntl_dupfd_cloexec(stdout(), 3).map_err(std::io::Error::from);
    let own = own.and_then(|own| dup2_stdout(stderr()).map(|()| own).map_err(Into::into));
    Ok(LineWriter::new(own.context("cannot take standard output for events")?.into()))
}
