//! What a report is made from: runs as their folders tell of them, put together in groups that differ in the seed only.

mod field;
mod group;
mod run;
mod settings;

pub use field::{Field, Source};
pub use group::{Group, StudyError, groups};
pub use run::{ELAPSED_S, Evaluated, FRAMES_PER_S, Origin, Rollout, Run, RunState, UnknownState, Validated};
pub use settings::differences_between;

#[cfg(test)]
pub(crate) use group::tests;
