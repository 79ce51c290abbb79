//! `ArmPointNav`: fetch the target, bring it to its goal, and leave the rest as it was.

mod environment;
pub mod episode;
pub mod episodes;
mod step;

pub use environment::Environment;
pub use step::{Current, RewardParts, Transition, check};

use crate::kitchen::Kitchen;
use crate::tasks::run::{OpenError, Run};
use proto::episode::EnvironmentId;
use std::sync::Arc;

/// An environment of a run, at the start of its episode with this number.
pub(super) fn open(
    run: &Arc<Run>,
    kitchen: &Arc<Kitchen>,
    id: EnvironmentId,
    number: u32,
) -> Result<Box<dyn crate::environment::Environment>, OpenError> {
    step::assert_declared();
    Ok(Box::new(Environment::open(run, Arc::clone(kitchen), id, number)?))
}
