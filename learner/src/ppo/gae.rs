//! Generalised advantage estimation (Schulman et al. 2016).
//!
//! ```text
//! δ_t = r_t + γ·V(s_{t+1}) − V(s_t)
//! A_t = δ_t + γλ·A_{t+1}
//! R_t = A_t + V(s_t)
//! ```
//! At an episode's end both `V(s_{t+1})` and `A_{t+1}` are 0, since row t+1 belongs to the next episode.
//!
//! An end by the step limit counts as an end, as in the reference. With `bootstrap_time_limits` it is a truncation
//! instead: `V(s_{t+1})` is that of the episode's last observation. Records of tasks with images do not have it; there
//! `V(s_t)`, one step earlier, is used instead.

use super::moments::RewardScale;
use crate::device::upload;
use crate::peers::{PeerError, Peers};
use crate::rollout::Rollout;
use crate::shards::Shards;
use proto::config::PpoConfig;
use std::ops::Range;
use tch::{Device, Tensor};

/// Advantages and returns of a rollout, \[T, N\].
#[derive(Debug, Clone, PartialEq)]
pub struct Targets {
    columns: usize,
    /// Row-major in (step, column); 0 where the rollout is not valid.
    advantages: Vec<f32>,
    returns: Vec<f32>,
}

impl Targets {
    /// `A_t` of all columns and `R_t`, one row for each (step, column) of the rollout, on a device: f32 \[rows\].
    pub(crate) fn to_device(&self, device: Device) -> [Tensor; 2] {
        [&self.advantages, &self.returns].map(|numbers| upload(numbers, device))
    }

    /// `A_t` of a column.
    pub fn advantage(&self, (t, column): (usize, usize)) -> f32 {
        self.advantages[t * self.columns + column]
    }

    /// `R_t` of a column, the target of its value.
    pub fn value_target(&self, (t, column): (usize, usize)) -> f32 {
        self.returns[t * self.columns + column]
    }
}

/// Estimates advantages and returns, and normalises the advantages if the configuration asks for it: over the frames of
/// all learners.
pub fn estimate(
    rollout: &Rollout,
    config: &PpoConfig,
    scale: RewardScale,
    shards: &Shards,
    peers: &Peers,
) -> Result<Targets, PeerError> {
    let columns = rollout.columns();
    let rows = rollout.shape().steps * columns;
    let mut targets = Targets { columns, advantages: vec![0.0; rows], returns: vec![0.0; rows] };
    let (gamma, lambda) = (config.gamma, config.gae_lambda);

    for column in 0..columns {
        let mut next_value = f64::from(rollout.bootstrap_value(column));
        let mut next_advantage = 0.0;
        for t in (0..rollout.steps_of(column)).rev() {
            let step = rollout.step(t, column);
            let value = f64::from(step.value);
            if step.ended {
                let truncated = config.bootstrap_time_limits && step.time_limit;
                let last_value = step.last_value.map_or(value, f64::from);
                next_value = if truncated { last_value } else { 0.0 };
                next_advantage = 0.0;
            }
            let delta = scale.apply(step.reward) + gamma * next_value - value;
            let advantage = delta + gamma * lambda * next_advantage;
            targets.advantages[t * columns + column] = advantage as f32;
            targets.returns[t * columns + column] = (advantage + value) as f32;
            (next_value, next_advantage) = (value, advantage);
        }
    }
    if config.normalize_advantages && !config.normalize_by_minibatch {
        normalize(rollout, &mut targets, shards, peers)?;
    }
    Ok(targets)
}

/// Mean 0 and deviation 1 over the batch's frames. 1e-5 is added to the deviation, as in the reference.
fn normalize(rollout: &Rollout, targets: &mut Targets, shards: &Shards, peers: &Peers) -> Result<(), PeerError> {
    let columns = targets.columns;
    let valid = (0..targets.advantages.len()).filter(|index| rollout.is_valid(index / columns, index % columns));
    let valid: Vec<usize> = valid.collect();
    let of = |shard: &Range<usize>| {
        let own = |index: &&usize| shard.contains(&(**index % columns));
        valid.iter().filter(own).map(|&index| f64::from(targets.advantages[index])).collect::<Vec<f64>>()
    };
    let advantages: Vec<Vec<f64>> = shards.columns().iter().map(of).collect();
    let (mean, deviation) = moments(&advantages, shards, peers)?;
    for index in valid {
        targets.advantages[index] = ((f64::from(targets.advantages[index]) - mean) / (deviation + 1e-5)) as f32;
    }
    Ok(())
}

/// Mean and unbiased deviation of the numbers of all learners, given by shard.
pub(super) fn moments(numbers: &[Vec<f64>], shards: &Shards, peers: &Peers) -> Result<(f64, f64), PeerError> {
    let sums: Vec<Vec<f64>> =
        numbers.iter().map(|of_shard| vec![of_shard.len() as f64, of_shard.iter().sum()]).collect();
    let whole = shards.sum(&sums, peers)?;
    let (count, mean) = (whole[0], whole[1] / whole[0]);
    let squares: Vec<Vec<f64>> =
        numbers.iter().map(|of_shard| vec![of_shard.iter().map(|a| (a - mean).powi(2)).sum()]).collect();
    let squares = shards.sum(&squares, peers)?;
    // One frame has no spread to divide by.
    Ok((mean, (squares[0] / (count - 1.0).max(1.0)).sqrt()))
}
