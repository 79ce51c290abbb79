//! Supervision: who runs, who is started again, which stage is in force, and when it is over.
//!
//! [`machine`] decides, [`restart`] and [`stage`] are its two parts that stand on their own; all three are pure
//! functions of events and a clock. [`shell`] is where processes, signals, shared memory and files are: it turns what
//! happens into events and the machine's actions into deeds, and decides nothing.

pub mod machine;
pub mod process;
pub mod restart;
pub mod shell;
pub mod stage;
