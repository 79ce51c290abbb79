//! Recorded episodes as a data set: requests from `orchestrator export` on the standard input of `actor dataset`, and
//! answers on its standard output, one JSON object per line.

use crate::replay::{RecordedEpisode, ReplayVerdict};
use serde::{Deserialize, Serialize};

/// First line of the input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DatasetSetup {
    /// The configurations that the episodes were recorded under, as TOML.
    pub configs: Vec<String>,
    /// The run folder, which the configurations' scenes are named relative to; none where it is not known.
    pub folder: Option<String>,
    /// Folder to be made. It does not exist.
    pub out: String,
    /// Pictures in colour, besides the robot's depth frames.
    pub pictures: Vec<PictureKind>,
    /// Width and height of these pictures.
    pub side_px: u32,
    /// The metric that is 1 of the episodes that are kept; none: all. Those that the recording ends in the middle of never
    /// are.
    pub keep: Option<String>,
    pub limit: Option<u64>,
    /// How many episodes follow: an input that ends before makes no data set.
    pub episodes: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PictureKind {
    /// What the robot's camera would see.
    Robot,
    /// The room from outside, from one place during an episode.
    Outside,
}

impl PictureKind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Robot => "robot",
            Self::Outside => "outside",
        }
    }
}

/// Every further line of the input.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DatasetRequest {
    pub config: usize,
    pub recorded: RecordedEpisode,
}

/// Every line of the output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DatasetAnswer {
    /// An episode was simulated again. If it differs from the recording nothing is written, and this is the last line.
    Simulated {
        verdict: ReplayVerdict,
        kept: bool,
        /// The recording ends before the episode does.
        unfinished: bool,
    },
    /// All is written, and the folder is there.
    Written { episodes: u64, steps: u64, bytes: u64 },
    /// No episode was to be kept: there is no folder.
    Nothing,
}
