//! Observations and rewards normalised by running statistics, which all learners share.

use serde::{Deserialize, Serialize};

/// The statistics stay the same during a rollout. After the training on it they include it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NormalizeConfig {
    /// Give the network each number less its mean, divided by its deviation, over all observations so far. One-hot
    /// codes stay as they are.
    pub observations: bool,
    /// A normalised number is clipped at this, either way.
    pub observation_clip: f64,
    /// Divide rewards by the deviation of discounted returns so far.
    pub rewards: bool,
    /// A divided reward is clipped at this, either way.
    pub reward_clip: f64,
}

impl Default for NormalizeConfig {
    fn default() -> Self {
        Self { observations: false, observation_clip: 10.0, rewards: false, reward_clip: 10.0 }
    }
}
