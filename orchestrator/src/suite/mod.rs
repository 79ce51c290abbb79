//! Many runs: presets times seeds, each trained and evaluated by ordinary `orchestrator` processes in ordinary run
//! folders, as many at once as there are GPUs to give them ([`scheduler`]). It can be killed at any time: its processes
//! end with it, and the next call continues from what is in the run folders.

mod by_name;
mod figures;
mod file;
mod folder;
mod grid;
mod in_words;
mod scheduler;
mod standing;
mod state;
#[cfg(test)]
mod tests;

pub use by_name::BUILT_IN;
pub use file::{Asked, Suite, SuiteEntry};
pub use folder::{SuiteFolder, is_suite, refuse};
pub use scheduler::{SuiteOutcome, run, standings};
pub use standing::{At, Standing, begun};
