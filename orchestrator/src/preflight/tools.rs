//! The other two programs, and what the learner computes with.

use super::libtorch;
use super::programs::{self, Programs};
use anyhow::Result;
use proto::device::Torch;

#[derive(Debug, Clone)]
pub struct Tools {
    pub programs: Programs,
    pub torch: Torch,
}

impl Tools {
    pub fn find() -> Result<Self> {
        let learner = programs::find("learner")?;
        let actor = programs::find("actor")?;
        let learner_environment = libtorch::environment()?;
        let torch = libtorch::check(&learner, &learner_environment)?;
        Ok(Self { programs: Programs { learner, actor, learner_environment }, torch })
    }
}
