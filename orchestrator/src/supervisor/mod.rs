//! Supervision: which processes run, which are restarted, which stage is in force, and when the run ends.
//!
//! [`machine`] decides. [`children`], [`learner_group`], [`pace`], [`restart`] and [`stage_machine`] are its
//! independent parts, [`clock`] is its time, [`deadlines`] holds its bounds, [`overdue`] finds the one that is
//! exceeded, and [`messages`] phrases reports of starts and deaths. All are pure functions of events ([`event`]) and a
//! clock. [`shell`] is where processes, signals, shared memory and files are: it turns signals and messages into
//! events, executes the machine's actions, and decides nothing. [`remote_hosts`] is what supervision keeps of the other
//! hosts. [`session`] is one start of the orchestrator on a run folder, with its services, its recorder and this
//! supervision.

pub mod children;
pub mod clock;
pub mod deadlines;
pub mod event;
pub mod learner_group;
pub mod machine;
mod messages;
pub mod overdue;
pub mod pace;
pub mod process;
pub mod remote_hosts;
pub mod restart;
pub mod session;
pub mod shell;
pub mod stage_machine;
