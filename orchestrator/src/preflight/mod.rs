//! Checks before any process starts, so that a run that cannot work fails at once, with one message that contains the
//! figures and a remedy. `up` and `resume` stop at the first problem; `doctor` prints all of it.

pub mod all;
pub mod descriptors;
pub mod device;
pub mod disk;
pub mod libtorch;
pub mod memory;
pub mod placement;
pub mod processor;
pub mod programs;
pub mod services;
pub mod shared_memory;
pub mod temporary;

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Finding {
    Good(String),
    Warning(String),
    Problem(String),
}

impl Finding {
    pub fn demand(self) -> anyhow::Result<()> {
        match self {
            Self::Good(text) => tracing::debug!("{text}"),
            Self::Warning(text) => tracing::warn!("{text}"),
            Self::Problem(text) => anyhow::bail!(text),
        }
        Ok(())
    }
}
