//! Exit statuses with a meaning of their own: of learners, which the orchestrator acts on, and of the orchestrator, which
//! scripts act on; and how any process ended, in words.

use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

/// How a process ended, to stand behind its name: `was killed by signal 9 (SIGKILL)`, `ended with exit status: 1`.
pub fn how(status: ExitStatus) -> String {
    match status.signal() {
        Some(_) => format!("was killed by {}", status.to_string().replacen("signal: ", "signal ", 1)),
        None => format!("ended with {status}"),
    }
}

/// Status with which a learner exits on a non-finite loss, gradient, observation or answer of the network.
pub const EXIT_NON_FINITE: i32 = 3;

/// Status with which a learner exits because another of the run's learners is gone or cannot go on: that one's end is
/// the reason, and on its way.
pub const EXIT_LOST_PEERS: i32 = 4;

/// Status with which a learner exits because it cannot write the checkpoint without which it may not end, or not begin;
/// or because the recording has stood still for too long. A restart would meet the same disk.
pub const EXIT_UNSAVED: i32 = 5;

/// Status with which `orchestrator recover` and `orchestrator replay --check` exit if recordings are damaged or incomplete: what
/// is there was read, and what is not was named.
pub const EXIT_INCOMPLETE: i32 = 6;

/// Status with which `orchestrator up` and `resume` exit if the run ended because a host of it was lost, or did not come.
/// The last checkpoint stands: the same command on all hosts goes on from it.
pub const EXIT_HOST_LOST: i32 = 7;

/// Status with which they exit after SIGUSR1, or a launcher's SIGTERM: the run is saved and not complete, and wants to be
/// started again. (`EX_TEMPFAIL` of sysexits.h.)
pub const EXIT_REQUEUE: i32 = 75;
