use crate::peers::{PeerError, Peers};
use crate::shards::Shards;
use proto::metric;
use proto::task::Spec;
use std::collections::BTreeMap;

/// Figures of an episode in progress. Checkpoints save them, so that metrics continue after a resume.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunningEpisode {
    pub episode_return: f64,
    /// Σ `γ^t` cost so far.
    pub discounted_cost: f64,
    /// Sum of the rewards so far, each discounted by its age.
    pub discounted_return: f64,
    /// The task's metrics of rollouts so far, in its order; none at the start, where all are 0.
    pub metrics: Vec<f64>,
}

impl RunningEpisode {
    /// Adds step `step` with its reward and its cost; `gamma` is the discount.
    pub fn add(&mut self, step: u32, reward: f32, cost: f32, gamma: f64) {
        self.episode_return += f64::from(reward);
        self.discounted_return = self.discounted_return * gamma + f64::from(reward);
        self.discounted_cost += libm::pow(gamma, f64::from(step)) * f64::from(cost);
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Ended {
    /// Its steps.
    pub length: u32,
    pub running: RunningEpisode,
}

/// Sums over one rollout of a shard. Filled in the fixed order of the batch, so that the sums do not depend on timing.
#[derive(Debug, Clone, PartialEq)]
pub struct RolloutStatistics {
    task: &'static Spec,
    frames: u64,
    reward: f64,
    episodes: u64,
    episode_return: f64,
    length: f64,
    discounted_cost: f64,
    /// Of those that are figures of rollouts, in the task's order.
    metrics: Vec<f64>,
}

impl RolloutStatistics {
    pub fn of(task: &'static Spec) -> Self {
        Self::summed(task, &vec![0.0; Self::SUMS + task.rollout_metrics().count()])
    }

    pub(crate) fn add_step(&mut self, reward: f32) {
        self.frames += 1;
        self.reward += f64::from(reward);
    }

    pub fn add_episode(&mut self, Ended { length, running }: &Ended) {
        self.episodes += 1;
        self.episode_return += running.episode_return;
        self.length += f64::from(*length);
        self.discounted_cost += running.discounted_cost;
        for (sum, metric) in self.metrics.iter_mut().zip(&running.metrics) {
            *sum += metric;
        }
    }

    /// The same over all shards of the run. `own`: those of this learner's. Panics if `own` has not one for each of
    /// them.
    pub fn over(own: &[Self], shards: &Shards, peers: &Peers) -> Result<Self, PeerError> {
        let task = own.first().expect("a learner has a shard").task;
        let sums: Vec<Vec<f64>> = own.iter().map(Self::sums).collect();
        Ok(Self::summed(task, &shards.sum(&sums, peers)?))
    }

    /// Sums besides those of metrics.
    const SUMS: usize = 6;

    /// All of them, to be added up.
    fn sums(&self) -> Vec<f64> {
        let Self { frames, reward, episodes, episode_return, length, discounted_cost, .. } = *self;
        let sums: [f64; Self::SUMS] = [frames as f64, reward, episodes as f64, episode_return, length, discounted_cost];
        sums.into_iter().chain(self.metrics.iter().copied()).collect()
    }

    /// What [`Self::sums`] gave.
    fn summed(task: &'static Spec, sums: &[f64]) -> Self {
        let (&[frames, reward, episodes, episode_return, length, discounted_cost], metrics) =
            sums.split_first_chunk::<{ Self::SUMS }>().expect("as many as each shard gives");
        Self {
            task,
            frames: frames as u64,
            reward,
            episodes: episodes as u64,
            episode_return,
            length,
            discounted_cost,
            metrics: metrics.to_vec(),
        }
    }

    /// `J_C`: mean of Σ `γ^t` cost over the episodes that ended; none when none did.
    pub fn mean_discounted_cost(&self) -> Option<f64> {
        (self.episodes > 0).then(|| self.discounted_cost / self.episodes as f64)
    }

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
            let engines = [
                (metric::RETURN.to_owned(), self.episode_return),
                (metric::LENGTH.to_owned(), self.length),
                (metric::DISCOUNTED_COST.to_owned(), self.discounted_cost),
            ];
            let names = self.task.rollout_metrics().map(|(of_task, _)| metric::of_episode(&of_task.name));
            for (name, sum) in engines.into_iter().chain(names.zip(self.metrics.iter().copied())) {
                metrics.insert(name, sum / self.episodes as f64);
            }
        }
        metrics
    }
}
