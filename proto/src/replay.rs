//! Re-simulation of recorded episodes: requests from `orchestrator replay` on the standard input of `actor replay`, and
//! results on its standard output, one JSON object per line.

use crate::episode::EnvironmentId;
use serde::{Deserialize, Serialize};

/// First line of the input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReplaySetup {
    /// The run's effective configuration, as TOML.
    pub config: String,
    /// The run folder, which the configuration's scenes are named relative to; none where it is not known.
    #[serde(default)]
    pub folder: Option<String>,
    /// How to draw the episodes; none = compare hashes only.
    pub images: Option<ReplayImages>,
}

/// How to draw the episodes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReplayImages {
    /// Folder, created if missing.
    pub folder: String,
    /// Still pictures or one moving picture an episode.
    pub format: ImageFormat,
    /// Width and height of a still, or of each of a moving picture's two views, pixels.
    pub side: u32,
}

/// Format of the pictures.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageFormat {
    /// Depth alone: a 16-bit PNG a frame, millimetres.
    Png,
    /// One animated PNG an episode, in colour: plays in any browser.
    Apng,
    /// One MP4 an episode, in colour.
    Mp4(Ffmpeg),
}

/// The program that encodes films.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ffmpeg {
    pub program: String,
    /// Its H.264 encoder, e.g. `libx264`.
    pub encoder: String,
}

/// Every further line of the input: one recorded episode, possibly cut off at its end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordedEpisode {
    /// Environment it ran in.
    pub environment: EnvironmentId,
    /// Episode number within the environment.
    pub episode: u32,
    /// Hash of its first state, if the recording holds it.
    pub start_hash: Option<u64>,
    /// The actions, `A_large` indices, from step 0.
    pub actions: Vec<u8>,
    /// State hash after each action; as many as `actions`.
    pub hashes: Vec<u64>,
    /// [`goal_digest`] of the goal vector before each action, 0 if the recording does not contain it; as many as
    /// `actions`, or none.
    #[serde(default)]
    pub goals: Vec<u32>,
    /// [`start_digest`] of the episode's beginning, if the recording holds it.
    #[serde(default)]
    pub start: Option<u32>,
    /// [`RecordedStep::digests`] of each action; as many as `actions`, or none.
    #[serde(default)]
    pub steps: Vec<[u32; STEP_ASPECTS.len()]>,
}

/// What a replay compares, in words that people read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Aspect {
    /// Hash of the simulator's state.
    State,
    /// Goal vector before an action.
    Goal,
    /// Target and distances at the start.
    Start,
    /// What an action did: failed, picked up, held, Done, success, time limit, end.
    Outcome,
    /// Parts of the reward, and the two rewards composed of them.
    Reward,
    /// Disturbance now and at most, and objects disturbed.
    Disturbance,
    /// Distances left.
    Distance,
    /// The episode ends where the recording goes on.
    Length,
}

/// The aspects that [`RecordedStep::digests`] covers, in its order.
pub const STEP_ASPECTS: [Aspect; 4] = [Aspect::Outcome, Aspect::Reward, Aspect::Disturbance, Aspect::Distance];

impl Aspect {
    pub fn word(self) -> &'static str {
        match self {
            Self::State => "state",
            Self::Goal => "goal vector",
            Self::Start => "target or distances at the start",
            Self::Outcome => "outcome",
            Self::Reward => "reward",
            Self::Disturbance => "disturbance",
            Self::Distance => "distances",
            Self::Length => "length",
        }
    }
}

/// What a recording holds of a step beside its state.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[expect(clippy::struct_excessive_bools, reason = "the message has them")]
pub struct RecordedStep {
    pub failed: bool,
    pub picked_up: bool,
    pub success: bool,
    pub holding: bool,
    /// Whether the task ended the episode, whether the limit did, and whether it ended.
    pub ends: [bool; 3],
    pub target: u32,
    /// Progress of wrist to object, of object to goal, and of disturbance, metres.
    pub progress_m: [f32; 3],
    /// r and r′.
    pub rewards: [f32; 2],
    /// Disturbance now and at most, metres.
    pub disturbance_m: [f32; 2],
    pub disturbed_objects: u32,
    /// From wrist to object, and from object to goal, metres.
    pub distances_m: [f32; 2],
}

impl RecordedStep {
    /// Its digests, one for each of [`STEP_ASPECTS`].
    pub fn digests(&self) -> [u32; STEP_ASPECTS.len()] {
        let Self { failed, picked_up, success, holding, ends: [terminated, truncated, ended], target, .. } = *self;
        let outcome = [failed, picked_up, success, holding, terminated, truncated, ended].map(u32::from);
        [
            digest(outcome.into_iter().chain([target])),
            digest(self.progress_m.into_iter().chain(self.rewards).map(bits)),
            digest(self.disturbance_m.map(bits).into_iter().chain([self.disturbed_objects])),
            digest(self.distances_m.map(bits)),
        ]
    }
}

/// Digest of an episode's beginning: target, and its distances from wrist and goal.
pub fn start_digest(target: u32, wrist_object_m: f32, object_goal_m: f32) -> u32 {
    digest([target, bits(wrist_object_m), bits(object_goal_m)])
}

/// Length of a vector, as recordings hold it.
pub fn length_m([x, y, z]: [f32; 3]) -> f32 {
    (x * x + y * y + z * z).sqrt()
}

/// Bits of a number as it comes out of a recording: protobuf does not store the sign of zero.
fn bits(number: f32) -> u32 {
    (number + 0.0).to_bits()
}

/// FNV-1a over the words' bytes.
fn digest(words: impl IntoIterator<Item = u32>) -> u32 {
    fnv_1a(words.into_iter().flat_map(u32::to_le_bytes))
}

fn fnv_1a(bytes: impl IntoIterator<Item = u8>) -> u32 {
    bytes.into_iter().fold(0x811C_9DC5, |digest, byte| (digest ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

/// Digest of a goal vector, and of which of its two kinds it is: FNV-1a over its bits. Never 0.
pub fn goal_digest(holding: bool, goal_m: [f32; 3]) -> u32 {
    fnv_1a(goal_m.into_iter().flat_map(f32::to_le_bytes).chain([u8::from(holding)])).max(1)
}

/// Every line of the output: the verdict on one episode, in input order.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReplayVerdict {
    /// Environment it ran in.
    pub environment: EnvironmentId,
    /// Episode number within the environment.
    pub episode: u32,
    /// States compared, the first one included.
    pub compared: u64,
    /// The first thing that differs, if any.
    pub first_difference: Option<Difference>,
    /// Images written.
    pub images: u64,
}

/// Something that the simulator does not give as it was recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Difference {
    /// Actions taken until then; for a goal vector, before the action that was chosen from it.
    pub step: u64,
    /// What differs.
    pub aspect: Aspect,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Alters one field of a step.
    type Alter = fn(&mut RecordedStep);

    #[test]
    fn every_recorded_field_of_a_step_is_in_its_aspect_s_digest() {
        let base = RecordedStep { rewards: [1.0, 2.0], ..RecordedStep::default() };
        let before = base.digests();
        let cases: [(usize, Alter); 18] = [
            (0, |step| step.failed = true),
            (0, |step| step.picked_up = true),
            (0, |step| step.success = true),
            (0, |step| step.holding = true),
            (0, |step| step.ends[0] = true),
            (0, |step| step.ends[1] = true),
            (0, |step| step.ends[2] = true),
            (0, |step| step.target = 3),
            (1, |step| step.progress_m[0] = 0.1),
            (1, |step| step.progress_m[1] = 0.1),
            (1, |step| step.progress_m[2] = 0.1),
            (1, |step| step.rewards[0] = 1.5),
            (1, |step| step.rewards[1] = 2.5),
            (2, |step| step.disturbance_m[0] = 0.1),
            (2, |step| step.disturbance_m[1] = 0.1),
            (2, |step| step.disturbed_objects = 1),
            (3, |step| step.distances_m[0] = 0.1),
            (3, |step| step.distances_m[1] = 0.1),
        ];
        for (number, (aspect, alter)) in cases.into_iter().enumerate() {
            let mut step = base;
            alter(&mut step);
            let after = step.digests();
            let differing: Vec<_> = (0..4).filter(|&index| before[index] != after[index]).collect();
            assert_eq!(differing, [aspect], "case {number}");
        }
        let negative = RecordedStep { progress_m: [-0.0, 0.0, 0.0], ..base };
        assert_eq!(negative.digests(), before, "zero has no sign");
        let starts = [start_digest(1, 0.5, 0.7), start_digest(2, 0.5, 0.7), start_digest(1, 0.6, 0.7)];
        assert!(!starts.contains(&start_digest(1, 0.5, 0.8)) && starts[0] != starts[1] && starts[0] != starts[2]);
    }
}
