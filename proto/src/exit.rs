//! Exit statuses with a meaning of their own: of learners, which the orchestrator acts on, and of the orchestrator, which
//! scripts act on.

/// Status with which a learner exits on a non-finite loss, gradient, observation or answer of the network.
pub const EXIT_NON_FINITE: i32 = 3;

/// Status with which a learner exits because another of the run's learners is gone or cannot go on: that one's end is
/// the reason, and on its way.
pub const EXIT_LOST_PEERS: i32 = 4;

/// Status with which a learner exits because it cannot write the checkpoint without which it may not end, or not begin.
/// A restart would train the same again and meet the same full disk.
pub const EXIT_UNSAVED: i32 = 5;

/// Status with which `orchestrator recover` and `orchestrator replay` exit if recordings are damaged or incomplete: what
/// is there was read, and what is not was named.
pub const EXIT_INCOMPLETE: i32 = 6;
