//! Input of a report: runs as they are read from their folders, in groups that differ only in the seed.

mod field;
mod group;
mod pair;
mod run;
mod settings;

pub use field::{Field, Source};
pub use group::{Group, StudyError, groups};
pub use pair::{EvaluatedPair, pair_of};
pub use run::{Evaluated, Origin, Rollout, Run, Validated};
pub use settings::differences_between;

#[cfg(test)]
pub(crate) use group::tests;
