//! Many runs: presets times seeds, each trained and evaluated by ordinary `orchestrator` processes in ordinary run
//! folders, as many at once as there are GPUs to give them ([`scheduler`]). It can be killed at any time: its processes
//! leave with it, and the next call goes on where the run folders stand.

mod file;
mod folder;
mod grid;
mod scheduler;
mod state;

pub use file::Suite;
pub use folder::{SuiteFolder, refuse};
pub use scheduler::{SuiteOutcome, lines, run};
