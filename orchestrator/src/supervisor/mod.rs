//! Supervision: which processes run, which are restarted, which stage is in force, and when the run ends.
//!
//! [`machine`] decides. [`children`], [`gang`], [`pace`], [`restart`] and [`stage`] are its independent parts, [`clock`]
//! is its time, [`policy`] holds its bounds, [`deadlines`] finds the one that is exceeded, and [`words`] phrases reports
//! of starts and deaths. All are pure functions of events ([`event`]) and a clock. [`shell`] is where processes, signals,
//! shared memory and files are: it turns signals and messages into events, executes the machine's actions, and decides
//! nothing. [`company`] is what supervision keeps of the other hosts. [`session`] is one start of the orchestrator on a
//! run folder, with its services, its recorder and this supervision.

pub mod children;
pub mod clock;
pub mod company;
pub mod deadlines;
pub mod event;
pub mod gang;
pub mod machine;
pub mod pace;
pub mod policy;
pub mod process;
pub mod restart;
pub mod session;
pub mod shell;
pub mod stage;
mod words;
