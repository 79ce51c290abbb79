use super::message_writer::RolloutMetrics;
use crate::schema::foxglove::log::Level;
use crate::schema::stillroom::{StageSwitch, Validation};
use proto::config::Config;
use proto::run_folder::RunFolder;
use std::ops::Range;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use wire::{WireAddress, WireShape};

pub const START_DEADLINE: Duration = Duration::from_secs(30);

#[derive(Debug, Clone)]
pub struct RecorderSetup {
    pub address: WireAddress,
    pub shape: WireShape,
    pub run_id: String,
    pub host: u32,
    /// The learners whose actors are recorded: those of this host.
    pub ranks: Range<u32>,
    pub folder: RunFolder,
    pub incarnation: u32,
    pub config: Config,
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordingSummary {
    pub files: Vec<PathBuf>,
    /// Messages on `/step`: in an uninterrupted run, the frames trained on.
    pub steps: u64,
    pub episodes: u64,
    pub depth_frames: u64,
    pub bytes: u64,
    /// Frames of the run whose steps are all recorded, here or, before this incarnation began, in earlier ones. None
    /// if no learner has begun.
    pub frames: Option<u64>,
}

/// What is wrong where a part of shared memory fails.
pub const OBSERVATIONS: &str = "the recorder cannot read the observations";

pub enum Note {
    Began {
        learner_incarnation: u32,
        frames: u64,
    },
    Collected {
        learner_incarnation: u32,
        rollout: u64,
        frames: u64,
        /// Of this rollout, on this host.
        here: u64,
    },
    Trained(RolloutMetrics),
    Stage(StageSwitch),
    Validation(Validation),
    Log {
        level: Level,
        process: String,
        line: String,
    },
    Finish,
}

pub fn now_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_nanos() as u64)
}
