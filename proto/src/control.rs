//! What a learner tells the orchestrator: one JSON object a line on its standard output.
//!
//! Logs go to standard error. The other direction is the stage service in shared memory; the learner's standard
//! input is only a lifeline: when it closes, the orchestrator is gone, and the learner saves and exits.
//!
//! Of several learners rank 0 speaks for all: it alone tells of rollouts, updates and checkpoints, and its figures are
//! those of the whole batch. The others tell of themselves only.

use crate::evaluation::EpisodeRecord;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Status with which a learner exits on a non-finite loss, gradient, observation or answer of the network.
pub const EXIT_NON_FINITE: i32 = 3;

/// Status with which a learner exits because another of the run's learners is gone or cannot go on: that one's end is the
/// reason, and on its way.
pub const EXIT_LOST_PEERS: i32 = 4;

/// The variable that says which CUDA devices a process sees: numbers or UUIDs, separated by commas. The orchestrator sets
/// it for its learners.
pub const VISIBLE_DEVICES: &str = "CUDA_VISIBLE_DEVICES";

/// What the machine calls device `index` of those that are `visible`; all are where nothing is said. Empty where there are
/// not so many: no device rather than another's.
pub fn device_name(index: usize, visible: Option<&str>) -> String {
    match visible {
        None => index.to_string(),
        Some(visible) => visible.split(',').nth(index).unwrap_or_default().trim().to_owned(),
    }
}

/// One line of a learner's standard output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum LearnerEvent {
    /// The network is built, the checkpoint (if any) loaded; the learner waits for the stage announcement of `rollout`.
    Ready {
        /// Rank in the process group.
        rank: u32,
        /// The rollout it will collect next.
        rollout: u64,
        /// Frames trained on so far.
        frames: u64,
        /// What it computes on, e.g. `cpu, 2 threads` or `cuda:0, bfloat16 encoder`; float32 where nothing is said.
        device: String,
        /// Trainable parameters.
        parameters: u64,
        /// Manifest of the checkpoint it came from, relative to the run folder; none on a fresh start. Of an evaluation:
        /// as its configuration names it.
        checkpoint: Option<String>,
    },
    /// All of this learner's actors have answered for the first time.
    ActorsConnected {
        /// Rank in the process group.
        rank: u32,
    },
    /// A rollout is collected; its update begins. The stage machine decides on rollout + 1 now.
    RolloutCollected {
        /// Rank in the process group.
        rank: u32,
        /// Number of the rollout, from 0.
        rollout: u64,
        /// Frames that will have been trained on when the update is through.
        frames: u64,
    },
    /// An update is through.
    RolloutTrained {
        /// Rank in the process group.
        rank: u32,
        /// Number of the rollout, from 0.
        rollout: u64,
        /// Frames trained on so far, this rollout included.
        frames: u64,
        /// Stage the rollout belonged to.
        stage: u32,
        /// Where the time went.
        timing: Timing,
        /// Named figures: see [`metric`].
        metrics: BTreeMap<String, f64>,
    },
    /// A checkpoint is complete on disk.
    CheckpointWritten {
        /// Rank in the process group.
        rank: u32,
        /// First rollout that is not in it.
        rollout: u64,
        /// Frames trained on in it.
        frames: u64,
        /// Folder-relative path of its manifest.
        path: String,
    },
    /// An episode of an evaluation has ended.
    EpisodePlayed {
        /// What came of it.
        record: EpisodeRecord,
        /// The actions taken, `A_large` indices.
        actions: Vec<u8>,
    },
    /// The learner waits for an actor that does not answer.
    WaitingForActor {
        /// Rank in the process group.
        rank: u32,
        /// Actor number.
        actor: u32,
        /// How long it has waited, seconds.
        waited_s: f64,
    },
    /// The budget is reached or a stop was asked for; the last checkpoint is written and the process exits with 0. Of
    /// an evaluation: all episodes are played.
    Finished {
        /// Rank in the process group.
        rank: u32,
        /// Frames trained on; 0 of an evaluation, which trains on none.
        frames: u64,
        /// SHA-256 over all weights, 64 hex digits (see the learner's `weights_digest`).
        weights: String,
        /// True when the budget is reached, false after a stop.
        complete: bool,
    },
}

impl LearnerEvent {
    /// Rank of the learner that speaks. An evaluation has one.
    pub fn rank(&self) -> u32 {
        match *self {
            Self::Ready { rank, .. }
            | Self::ActorsConnected { rank }
            | Self::RolloutCollected { rank, .. }
            | Self::RolloutTrained { rank, .. }
            | Self::CheckpointWritten { rank, .. }
            | Self::WaitingForActor { rank, .. }
            | Self::Finished { rank, .. } => rank,
            Self::EpisodePlayed { .. } => 0,
        }
    }
}

/// Seconds that one rollout and its update took, by what the learner was doing.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Waiting for actors (simulation that inference did not hide).
    pub simulate_s: f64,
    /// Policy inference, with copies and sampling.
    pub infer_s: f64,
    /// PPO epochs.
    pub update_s: f64,
    /// Everything else: waiting for announcements and other learners, checkpoints.
    pub other_s: f64,
}

/// Names of the metrics in [`LearnerEvent::RolloutTrained`]. Episode figures are means over the episodes that ended
/// in the rollout and are absent when none did.
pub mod metric {
    /// Episodes that ended in this rollout.
    pub const EPISODES: &str = "episode/count";
    /// Undiscounted return under the stage's reward.
    pub const RETURN: &str = "episode/return";
    /// Length in steps.
    pub const LENGTH: &str = "episode/length";
    /// Success rate, 0..1.
    pub const SUCCESS: &str = "episode/success";
    /// Rate of success without disturbance (d < 0.01 m), 0..1.
    pub const SUCCESS_UNDISTURBED: &str = "episode/success_without_disturbance";
    /// Rate of episodes in which the target was picked up, 0..1.
    pub const PICKED_UP: &str = "episode/picked_up";
    /// Total displacement at the end, metres.
    pub const DISTURBANCE: &str = "episode/disturbance_m";
    /// Σ `γ^t` (`d_t` - d_{t-1}) of an episode, metres: what PPO-Lagrangian constrains.
    pub const DISCOUNTED_DISTURBANCE: &str = "episode/discounted_disturbance_m";
    /// Learners that ended this rollout early, because most others had finished (DD-PPO); absent where there is one
    /// learner, or nobody is ever hurried.
    pub const PREEMPTED: &str = "rollout/preempted_learners";
    /// Mean reward a step over the rollout.
    pub const REWARD: &str = "rollout/reward";
    /// Clipped policy loss.
    pub const POLICY_LOSS: &str = "loss/policy";
    /// Value loss (before its coefficient).
    pub const VALUE_LOSS: &str = "loss/value";
    /// Policy entropy, nats.
    pub const ENTROPY: &str = "policy/entropy";
    /// Share of samples whose ratio was clipped.
    pub const CLIP_FRACTION: &str = "policy/clip_fraction";
    /// Mean of (ratio - 1) - ln(ratio).
    pub const APPROXIMATE_KL: &str = "policy/approximate_kl";
    /// Global gradient norm before clipping, mean over epochs.
    pub const GRADIENT_NORM: &str = "optimizer/gradient_norm";
    /// Learning rate of the update.
    pub const LEARNING_RATE: &str = "optimizer/learning_rate";
    /// PPO-Lagrangian's multiplier after the update; only in its stages.
    pub const MULTIPLIER: &str = "lagrangian/multiplier";
    /// Auxiliary loss (before its weight); `auxiliary/…` holds the task's other figures.
    pub const AUXILIARY_LOSS: &str = "loss/auxiliary";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_those_that_are_given() {
        let names = |visible| [0, 1].map(|index| device_name(index, visible));
        assert_eq!(names(None), ["0", "1"]);
        assert_eq!(names(Some("3, 5,6")), ["3", "5"]);
        assert_eq!(names(Some("GPU-3cdeb329")), ["GPU-3cdeb329", ""]);
    }
}
