//! The state of a run, and how a session on it ended: the words of `run.toml`, of `orchestrator status` and of reports.

use serde::{Deserialize, Serialize, Serializer};
use std::fmt::{Display, Formatter};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// The budget is reached, or all episodes are played.
    Complete,
    Stopped,
    /// A stop was requested twice.
    Interrupted,
    Failed,
}

impl Display for Ending {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Complete => "complete",
            Self::Stopped => "stopped",
            Self::Interrupted => "interrupted",
            Self::Failed => "failed",
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunState {
    /// An orchestrator works on it.
    Running,
    Ended(Ending),
    /// No session has begun on it, as after `orchestrator import`.
    NotStarted,
    /// Its last session noted no end: it crashed, or was killed.
    CutOff,
}

impl Display for RunState {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Running => f.write_str("running"),
            Self::Ended(ending) => ending.fmt(f),
            Self::NotStarted => f.write_str("not started"),
            Self::CutOff => f.write_str("cut off"),
        }
    }
}

impl Serialize for RunState {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ending_is_one_word_in_files_and_on_the_terminal() {
        for ending in [Ending::Complete, Ending::Stopped, Ending::Interrupted, Ending::Failed] {
            let written = serde_json::to_value(ending).unwrap();
            assert_eq!(written, ending.to_string());
            assert_eq!(serde_json::from_value::<Ending>(written).unwrap(), ending);
            assert_eq!(serde_json::to_value(RunState::Ended(ending)).unwrap(), ending.to_string());
        }
        assert_eq!(RunState::Running.to_string(), "running");
        assert_eq!(RunState::CutOff.to_string(), "cut off");
    }
}
