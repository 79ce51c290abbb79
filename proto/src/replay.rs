//! Re-simulation of recorded episodes: what `orchestrator replay` tells `actor replay` on its standard input and
//! what comes back on its standard output, one JSON object a line.

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
    /// Folder for depth images; none = compare hashes only.
    pub images: Option<ReplayImages>,
}

/// How to write depth images.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReplayImages {
    /// Folder, created if missing.
    pub folder: String,
    /// Still pictures or one moving picture an episode.
    pub format: ImageFormat,
    /// Width and height in pixels.
    pub side: u32,
}

/// Format of depth images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageFormat {
    /// 16-bit PNG a frame, millimetres.
    Png,
    /// One animated PNG an episode, 8-bit, near is bright: plays in any browser.
    Video,
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
    /// First step (0 = the start state) whose hash differs, if any.
    pub first_difference: Option<u64>,
    /// Images written.
    pub images: u64,
}
