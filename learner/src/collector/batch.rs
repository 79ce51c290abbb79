//! What is inferred together.

use crate::agent::StepInput;
use proto::camera::DepthFrame;
use proto::episode::EnvironmentId;

/// The observations of some lanes, in batch order: columns ascend.
#[derive(Debug, Clone, PartialEq)]
pub struct Batch<'a> {
    pub(crate) columns: Vec<usize>,
    /// Row of the rollout that each column is at; as many as it has, after the last action.
    pub(crate) at: Vec<usize>,
    pub(crate) frames: Vec<DepthFrame<'a>>,
    pub(crate) goal_m: Vec<[f32; 3]>,
    pub(crate) previous_action: Vec<u8>,
    pub(crate) episode_start: Vec<bool>,
    pub(crate) gumbel: Vec<f32>,
}

impl Batch<'_> {
    /// Row of the rollout that each column is at.
    pub fn rows(&self) -> impl Iterator<Item = usize> {
        self.at.iter().copied()
    }

    /// The batch as the agent takes it.
    pub fn input(&self) -> StepInput<'_> {
        StepInput {
            columns: &self.columns,
            frames: &self.frames,
            goal_m: &self.goal_m,
            previous_action: &self.previous_action,
            episode_start: &self.episode_start,
            gumbel: &self.gumbel,
        }
    }
}

/// Whose action is about to be chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Column.
    pub column: usize,
    /// Its environment.
    pub environment: EnvironmentId,
    /// Episode number within the environment.
    pub episode: u32,
    /// Actions taken in it so far.
    pub step: u32,
}
