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
    /// Where it is.
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
}

/// Digest of a goal vector, and of which of its two kinds it is: FNV-1a over its bits. Never 0.
pub fn goal_digest(holding: bool, goal_m: [f32; 3]) -> u32 {
    let bytes = goal_m.into_iter().flat_map(f32::to_le_bytes).chain([u8::from(holding)]);
    bytes.fold(0x811C_9DC5_u32, |digest, byte| (digest ^ u32::from(byte)).wrapping_mul(0x0100_0193)).max(1)
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
    /// First step (0 = the start state) whose hash differs, or whose goal vector does, if any.
    pub first_difference: Option<u64>,
    /// Images written.
    pub images: u64,
}
