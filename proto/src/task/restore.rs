//! How an environment is brought back to where it was.

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(tag = "way", rename_all = "snake_case", deny_unknown_fields)]
pub enum Restore {
    /// Its episode begins with the same seed, and the same actions are taken.
    #[default]
    Replay,
    /// Its state is bytes, at most so many. A record holds those of what is seen now, and the learner keeps them.
    Snapshot { bytes: u32 },
    /// It cannot be. What it was doing ends as a truncation without a reward, and it begins its next episode: such a run is
    /// the same in distribution only.
    None,
}

impl Restore {
    /// The most bytes of a snapshot. Each environment's lies in every record.
    pub(super) const SNAPSHOT_BYTES_MOST: u32 = 1 << 20;

    pub fn is_exact(self) -> bool {
        self != Self::None
    }

    /// As people read it.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Replay => {
                "replay: after a kill its seed and actions bring it back, and the run ends in the same bits"
            }
            Self::Snapshot { .. } => {
                "snapshot: after a kill its bytes bring it back, and the run ends in the same bits"
            }
            Self::None => "none: after a kill it begins another episode, and the run is the same in distribution only",
        }
    }
}
