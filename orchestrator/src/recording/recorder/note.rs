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

/// How long the thread may take to create the first segment and its subscriber.
pub const START_DEADLINE: Duration = Duration::from_secs(30);

#[derive(Debug, Clone)]
pub struct RecorderSetup {
    /// Where the services of this incarnation are.
    pub address: WireAddress,
    pub shape: WireShape,
    /// The run: part of every file.
    pub run_id: String,
    /// This host, of those that the run has: part of every file.
    pub host: u32,
    /// The learners whose actors are recorded: those of this host.
    pub ranks: Range<u32>,
    /// Where recordings go.
    pub folder: RunFolder,
    /// Incarnation of the orchestrator: part of the file names.
    pub incarnation: u32,
    /// The run's configuration; goes into every segment.
    pub config: Config,
}

/// What was recorded in one incarnation.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordingSummary {
    /// Segments in order.
    pub files: Vec<PathBuf>,
    /// Messages on `/step`: in an uninterrupted run, the frames trained on.
    pub steps: u64,
    pub episodes: u64,
    pub depth_frames: u64,
    /// Size of all segments.
    pub bytes: u64,
    /// Frames of the run whose steps are all recorded, here or, before this incarnation began, in earlier ones. None
    /// if no learner has begun.
    pub frames: Option<u64>,
}

/// Why a recording is missing or incomplete.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// The services cannot be tapped.
    #[error("the recorder cannot read the observations: {0}")]
    Wire(#[from] WireError),
    /// A segment cannot be written.
    #[error(
        "{0}; see that the folder is writable and its disk has space, or set recording.enabled = false to run without"
    )]
    Segment(#[from] SegmentError),
    /// Steps are missing.
    #[error(transparent)]
    Gap(#[from] Gap),
    /// The thread could not be started.
    #[error("cannot start the recorder's thread: {0}")]
    Thread(std::io::Error),
    /// The thread did not come up.
    #[error("the recorder did not start within {} s", START_DEADLINE.as_secs())]
    Slow,
    /// The thread is gone.
    #[error("the recorder's thread ended unexpectedly; its last messages are in the log")]
    Died,
    /// The thread has stood still for too long.
    #[error(
        "the recording has not got on for {} s: its disk hangs. What is written of it can be read; `orchestrator \
         recover` completes the file", .0.as_secs()
    )]
    Hangs(Duration),
    /// Recording ended with a failure some time ago.
    #[error("{0}")]
    Failed(String),
}

/// Messages from the orchestrator to the thread.
pub enum Note {
    /// A learner goes on from this many frames.
    Began {
        learner_incarnation: u32,
        frames: u64,
    },
    /// A rollout is collected, with which there are this many frames.
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

/// Wall-clock time, nanoseconds since 1970.
pub fn now_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_nanos() as u64)
}
