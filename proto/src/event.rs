//! Events from a learner to the orchestrator: one JSON object per line on the learner's standard output.
//!
//! Logs go to standard error. The other direction is the stage service in shared memory; the learner's standard
//! input is only a lifeline: when it closes, the orchestrator is gone, and the learner saves and exits.
//!
//! With several learners only rank 0 reports rollouts, updates and checkpoints, with figures of the whole batch. The
//! others report only their own state, and the first of each host what its recorder must have of a rollout.

use crate::evaluation::EpisodeRecord;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One line of a learner's standard output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum LearnerEvent {
    /// The network is built, the checkpoint (if any) loaded; the learner waits for the stage announcement of `rollout`.
    Ready {
        rank: u32,
        /// The rollout it will collect next.
        rollout: u64,
        frames: u64,
        /// What it computes on, e.g. `cpu, 2 threads` or `cuda:0, bfloat16 encoder`; float32 unless it is named.
        device: String,
        parameters: u64,
        /// Manifest of the checkpoint it came from, relative to the run folder; none on a fresh start. Of an
        /// evaluation: as its configuration names it.
        checkpoint: Option<String>,
    },
    /// All of this learner's actors have answered for the first time.
    ActorsConnected { rank: u32 },
    /// A rollout is collected; its update begins, and with `ppo.overlap` the next rollout, too. The stage machine decides
    /// on rollout + 1 now.
    RolloutCollected {
        rank: u32,
        rollout: u64,
        /// Frames that will have been trained on when the update is through.
        frames: u64,
        /// Frames of this rollout from this learner's host: what the recorder there must have.
        here: u64,
    },
    RolloutTrained {
        rank: u32,
        rollout: u64,
        /// Frames trained on so far, this rollout included.
        frames: u64,
        stage: u32,
        timing: Timing,
        metrics: BTreeMap<String, f64>,
    },
    /// A checkpoint is being written. What follows is [`LearnerEvent::CheckpointWritten`], or nothing if it fails.
    CheckpointBegun { rank: u32 },
    CheckpointWritten {
        rank: u32,
        /// First rollout that is not in it.
        rollout: u64,
        frames: u64,
        /// Folder-relative path of its manifest.
        path: String,
    },
    EpisodePlayed {
        record: EpisodeRecord,
        /// The actions taken, indices of the task's.
        actions: Vec<u8>,
    },
    /// The learner waits for an actor that does not answer.
    WaitingForActor { rank: u32, actor: u32, waited_s: f64 },
    /// The learner waits for its host's recorder, which stands still: its disk hangs, or its orchestrator is stopped.
    /// Said every second.
    WaitingForRecorder { rank: u32, waited_s: f64 },
    /// The budget is reached or a stop was asked for; the last checkpoint is written and the process exits with 0. Of
    /// an evaluation: all episodes are played.
    Finished {
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
    /// Rank of the learner that sent the event. An evaluation has one learner.
    pub fn rank(&self) -> u32 {
        match *self {
            Self::Ready { rank, .. }
            | Self::ActorsConnected { rank }
            | Self::RolloutCollected { rank, .. }
            | Self::RolloutTrained { rank, .. }
            | Self::CheckpointBegun { rank }
            | Self::CheckpointWritten { rank, .. }
            | Self::WaitingForActor { rank, .. }
            | Self::WaitingForRecorder { rank, .. }
            | Self::Finished { rank, .. } => rank,
            Self::EpisodePlayed { .. } => 0,
        }
    }
}

/// Seconds that one rollout and its update took, by activity of the learner. With `ppo.overlap`: the seconds since the
/// last rollout's, in which the next one was collected.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Waiting for actors (simulation that inference did not hide), and for the recorder to have what they sent.
    pub simulate_s: f64,
    /// Policy inference, with copies and sampling.
    pub infer_s: f64,
    /// PPO epochs. With `ppo.overlap`: waiting for them when the next rollout was collected.
    pub update_s: f64,
    /// Of the update, whether or not a rollout was collected beside it: summing gradients over all learners. Waiting for
    /// the slowest of them is in it. 0 with one learner.
    #[serde(default)]
    pub exchange_s: f64,
    /// Everything else: waiting for announcements, other learners and the recording's file; checkpoints.
    pub other_s: f64,
}

impl Timing {
    /// All parts together, seconds. The exchange is a part of the update.
    pub fn total_s(&self) -> f64 {
        self.simulate_s + self.infer_s + self.update_s + self.other_s
    }
}
