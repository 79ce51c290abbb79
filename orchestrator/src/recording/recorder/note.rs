//! Messages between the orchestrator and the recorder's thread.

use super::message_writer::RolloutMetrics;
use super::segment::SegmentError;
use super::tally::Gap;
use crate::recording::schema::foxglove::log::Level;
use crate::recording::schema::stillroom::{StageSwitch, Validation};
use proto::config::Config;
use proto::run_folder::RunFolder;
use std::ops::Range;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use wire::{WireAddress, WireError, WireShape};

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

#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    #[error("the recorder cannot read the observations: {0}")]
    Wire(#[from] WireError),
    #[error(
        "{0}; see that the folder is writable and its disk has space, or set recording.enabled = false to run without"
    )]
    Segment(#[from] SegmentError),
    #[error(transparent)]
    Gap(#[from] Gap),
    #[error("cannot start the recorder's thread: {0}")]
    Thread(std::io::Error),
    #[error("the recorder did not start within {} s", START_DEADLINE.as_secs())]
    Slow,
    #[error("the recorder's thread ended unexpectedly; its last messages are in the log")]
    Died,
    #[error(
        "the recording has not got on for {} s: its disk hangs. What is written of it can be read; `orchestrator \
         recover` completes the file", .0.as_secs()
    )]
    Hangs(Duration),
    #[error("{0}")]
    Failed(String),
}

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
