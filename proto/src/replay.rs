//! Re-simulation of recorded episodes: requests from `orchestrator replay` on the standard input of `actor replay`, and
//! results on its standard output, one JSON object per line.

use crate::episode::EnvironmentId;
use crate::step::Transition;
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
    /// [`step_digests`] of each action; as many as `actions`, or none.
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

/// The aspects that [`step_digests`] covers, in its order.
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

/// Digests of what a recording holds of a step beside its state, one for each of [`STEP_ASPECTS`]. `ends`: whether the
/// task ended the episode, whether the limit did, and whether it ended. `rewards`: r and r′.
pub fn step_digests(transition: &Transition, ends: [bool; 3], rewards: [f32; 2]) -> [u32; STEP_ASPECTS.len()] {
    let Transition { holding, target, reward, disturbance_m, peak_disturbance_m, disturbed_objects, .. } = transition;
    let parts = [reward.wrist_object_progress_m, reward.object_goal_progress_m, reward.disturbance_progress_m];
    let [terminated, truncated, ended] = ends;
    let outcome = [transition.failed(), transition.picked_up(), transition.succeeded(), terminated, truncated, ended];
    [
        digest(outcome.into_iter().map(u32::from).chain([*holding, *target])),
        digest(parts.into_iter().chain(rewards).map(bits)),
        digest([bits(*disturbance_m), bits(*peak_disturbance_m), *disturbed_objects]),
        digest([transition.wrist_object_m, transition.object_goal_m].map(bits)),
    ]
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
    use crate::reward::RewardParts;

    /// Alters one field of a transition.
    type Alter = fn(&mut Transition);

    #[test]
    fn every_recorded_field_of_a_step_is_in_its_aspect_s_digest() {
        let base = Transition::default();
        let digests = |step: &Transition| step_digests(step, [false; 3], [1.0, 2.0]);
        let before = digests(&base);
        let cases: [(usize, Alter); 13] = [
            (0, |step| step.reward.failed_action = 1.0),
            (0, |step| step.reward.picked_up = 1.0),
            (0, |step| step.reward.goal_success = 1.0),
            (0, |step| step.holding = 1),
            (0, |step| step.target = 3),
            (1, |step| step.reward.wrist_object_progress_m = 0.1),
            (1, |step| step.reward.object_goal_progress_m = 0.1),
            (1, |step| step.reward.disturbance_progress_m = 0.1),
            (2, |step| step.disturbance_m = 0.1),
            (2, |step| step.peak_disturbance_m = 0.1),
            (2, |step| step.disturbed_objects = 1),
            (3, |step| step.wrist_object_m = 0.1),
            (3, |step| step.object_goal_m = 0.1),
        ];
        for (number, (aspect, alter)) in cases.into_iter().enumerate() {
            let mut step = base;
            alter(&mut step);
            let after = digests(&step);
            let differing: Vec<_> = (0..4).filter(|&index| before[index] != after[index]).collect();
            assert_eq!(differing, [aspect], "case {number}");
        }
        for rewards in [[1.5, 2.0], [1.0, 2.5]] {
            assert_ne!(step_digests(&base, [false; 3], rewards)[1], before[1]);
        }
        for end in 0..3 {
            let ends = std::array::from_fn(|index| index == end);
            assert_ne!(step_digests(&base, ends, [1.0, 2.0])[0], before[0]);
        }
        let negative = RewardParts { wrist_object_progress_m: -0.0, ..RewardParts::default() };
        assert_eq!(digests(&Transition { reward: negative, ..base }), before, "zero has no sign");
        let starts = [start_digest(1, 0.5, 0.7), start_digest(2, 0.5, 0.7), start_digest(1, 0.6, 0.7)];
        assert!(!starts.contains(&start_digest(1, 0.5, 0.8)) && starts[0] != starts[1] && starts[0] != starts[2]);
    }
}
