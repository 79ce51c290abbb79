//! Statistics of the episodes that ended in a rollout.

use super::environments::Ended;
use crate::peers::{PeerError, Peers};
use crate::shards::Shards;
use proto::metric;
use proto::reward::UNDISTURBED_THRESHOLD_M;
use std::collections::BTreeMap;

/// Figures of an episode in progress that its last transition does not contain. Checkpoints save them, so that metrics
/// continue after a resume.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RunningEpisode {
    /// Undiscounted return so far.
    pub episode_return: f64,
    /// Σ `γ^t` cost so far.
    pub discounted_cost: f64,
    /// The target was picked up at some step.
    pub picked_up: bool,
}

impl RunningEpisode {
    /// Adds step `step` with its reward and its cost; `gamma` is the discount of the constraint.
    pub fn add(&mut self, step: u32, reward: f32, cost: f32, gamma: f64) {
        self.episode_return += f64::from(reward);
        self.discounted_cost += libm::pow(gamma, f64::from(step)) * f64::from(cost);
    }
}

/// Sums over one rollout of a shard. Filled in the fixed order of the batch, so that the sums do not depend on timing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RolloutStatistics {
    frames: u64,
    reward: f64,
    episodes: u64,
    episode_return: f64,
    length: f64,
    success: f64,
    success_undisturbed: f64,
    picked_up: f64,
    disturbance_m: f64,
    discounted_cost: f64,
}

impl RolloutStatistics {
    pub(crate) fn add_step(&mut self, reward: f32) {
        self.frames += 1;
        self.reward += f64::from(reward);
    }

    /// Adds an episode that has ended.
    pub fn add_episode(&mut self, ended: &Ended) {
        let Ended { length, success, disturbance_m, running } = *ended;
        let share = |condition: bool| f64::from(u8::from(condition));
        self.episodes += 1;
        self.episode_return += running.episode_return;
        self.length += f64::from(length);
        self.success += share(success);
        self.success_undisturbed += share(success && disturbance_m < UNDISTURBED_THRESHOLD_M);
        self.picked_up += share(running.picked_up);
        self.disturbance_m += f64::from(disturbance_m);
        self.discounted_cost += running.discounted_cost;
    }

    /// The same over all shards of the run. `own`: those of this learner's.
    ///
    /// # Panics
    /// If `own` has not one for each of them.
    pub fn over(own: &[Self], shards: &Shards, peers: &Peers) -> Result<Self, PeerError> {
        let sums: Vec<Vec<f64>> = own.iter().map(|statistics| statistics.numbers().to_vec()).collect();
        let sums = shards.sum(&sums, peers)?;
        let sums: [f64; 10] = sums.try_into().expect("as many as each shard gives");
        let [frames, reward, episodes, episode_return, length, success, success_undisturbed, picked_up, ..] = sums;
        let [.., disturbance_m, discounted_cost] = sums;
        Ok(Self {
            frames: frames as u64,
            reward,
            episodes: episodes as u64,
            episode_return,
            length,
            success,
            success_undisturbed,
            picked_up,
            disturbance_m,
            discounted_cost,
        })
    }

    /// All of them, to be added up.
    fn numbers(&self) -> [f64; 10] {
        [
            self.frames as f64,
            self.reward,
            self.episodes as f64,
            self.episode_return,
            self.length,
            self.success,
            self.success_undisturbed,
            self.picked_up,
            self.disturbance_m,
            self.discounted_cost,
        ]
    }

    /// `J_C`: mean of Σ `γ^t` cost over the episodes that ended; none when none did.
    pub fn mean_discounted_cost(&self) -> Option<f64> {
        (self.episodes > 0).then(|| self.discounted_cost / self.episodes as f64)
    }

    /// Number of frames added.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// The figures by their names in [`metric`]. Episode means are absent when no episode ended.
    pub fn metrics(&self) -> BTreeMap<String, f64> {
        let mut metrics = BTreeMap::from([(metric::EPISODES.to_owned(), self.episodes as f64)]);
        if self.frames > 0 {
            metrics.insert(metric::REWARD.to_owned(), self.reward / self.frames as f64);
        }
        if self.episodes > 0 {
            for (name, sum) in [
                (metric::RETURN, self.episode_return),
                (metric::LENGTH, self.length),
                (metric::SUCCESS, self.success),
                (metric::SUCCESS_UNDISTURBED, self.success_undisturbed),
                (metric::PICKED_UP, self.picked_up),
                (metric::DISTURBANCE, self.disturbance_m),
                (metric::DISCOUNTED_DISTURBANCE, self.discounted_cost),
            ] {
                metrics.insert(name.to_owned(), sum / self.episodes as f64);
            }
        }
        metrics
    }
}
