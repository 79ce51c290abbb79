//! Supervision: which processes run, which are restarted, which stage is in force, and when the run ends.
//!
//! [`machine`] decides, with its parts: all are pure functions of events ([`event`]) and a clock. [`shell`] is where
//! processes, signals, shared memory and files are: it turns signals and messages into events, executes the machine's
//! actions, and decides nothing. [`session`] is one start of the orchestrator on a run folder.

pub mod children;
pub mod clock;
pub mod deadlines;
pub mod event;
pub mod learner_group;
pub mod machine;
pub mod messages;
pub mod overdue;
pub mod pace;
pub mod process;
pub mod remote_hosts;
pub mod restart;
pub mod session;
pub mod shell;
pub mod stage_machine;
