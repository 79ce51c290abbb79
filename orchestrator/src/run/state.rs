//! How a run stands.

use super::identity::{Ending, Identity};
use super::lock::Held;
use serde::{Serialize, Serializer};
use std::fmt::{Display, Formatter};

/// How a run stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunState {
    /// An orchestrator works on it.
    Running,
    /// Its last start ended so.
    Ended(Ending),
    /// Its last start left no word: it crashed, or was killed. A run that was never started, too.
    CutOff,
}

impl RunState {
    /// The state of a run that is `held` so. `complete`: whether its result is there, whatever its last start noted.
    pub fn of(identity: &Identity, held: &Held, complete: bool) -> Self {
        match (held, identity.incarnations.last().and_then(|last| last.ended.as_ref())) {
            (Held::By(_) | Held::Unsigned, _) => Self::Running,
            (Held::Free, _) if complete => Self::Ended(Ending::Complete),
            (Held::Free, Some(ended)) => Self::Ended(ended.how),
            (Held::Free, None) => Self::CutOff,
        }
    }
}

impl Display for RunState {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Running => f.write_str("running"),
            Self::Ended(ending) => ending.fmt(f),
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
    use super::super::identity::Ended;
    use super::*;

    #[test]
    fn who_holds_a_run_comes_first_then_its_result_then_its_last_word() {
        let mut identity = Identity::new().unwrap();
        let state = |identity: &Identity, held, complete| RunState::of(identity, &held, complete).to_string();
        assert_eq!(state(&identity, Held::Free, false), "cut off");
        identity.begin_incarnation();
        assert_eq!(state(&identity, Held::Unsigned, false), "running");
        assert_eq!(state(&identity, Held::Free, false), "cut off");
        for (how, word) in [
            (Ending::Complete, "complete"),
            (Ending::Stopped, "stopped"),
            (Ending::Interrupted, "interrupted"),
            (Ending::Failed, "failed"),
        ] {
            identity.end_incarnation(Ended { how, at_unix_s: 1, frames: None, weights: None, reason: None });
            assert_eq!(state(&identity, Held::Free, false), word);
        }
        assert_eq!(state(&identity, Held::Free, true), "complete");
    }
}
