mod field;
mod group;
mod pair;
mod run;
mod settings;

pub use field::{Field, Source};
pub use group::{Group, StudyError, experiment, groups};
pub use pair::{EvaluatedPair, pair_of};
pub use run::{Evaluated, Origin, Rollout, Run, Validated};
pub use settings::differences_between;

#[cfg(test)]
pub(crate) use group::tests;
