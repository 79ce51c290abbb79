//! Supervision: which processes run, which are restarted, which stage is in force, and when the run ends.
//!
//! [`machine`] decides; [`children`], [`gang`], [`restart`] and [`stage`] are its parts that stand on their own,
//! [`policy`] is its bounds and [`deadlines`] says which of them is exceeded, [`words`] what is said of deaths; all are
//! pure functions of events ([`event`]) and a clock. [`shell`] is where processes, signals, shared memory and files
//! are: it turns signals and messages into events, executes the machine's actions, and decides nothing.

pub mod children;
pub mod deadlines;
pub mod event;
pub mod gang;
pub mod machine;
pub mod placement;
pub mod policy;
pub mod process;
pub mod restart;
pub mod shell;
pub mod stage;
mod words;
