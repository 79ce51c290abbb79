//! How a run stands, from its folder.

use super::identity::Identity;
use super::lock::LockState;
use proto::run_state::{Ending, RunState};

/// The state of a run with this lock. `complete`: its result is there, whatever its last session noted.
pub fn state_of(identity: &Identity, held: &LockState, complete: bool) -> RunState {
    match (held, identity.incarnations.last()) {
        (LockState::By(_) | LockState::Unsigned, _) => RunState::Running,
        (LockState::Free, _) if complete => RunState::Ended(Ending::Complete),
        (LockState::Free, None) => RunState::NotStarted,
        (LockState::Free, Some(last)) => {
            last.ended.as_ref().map_or(RunState::CutOff, |ended| RunState::Ended(ended.how))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::identity::Ended;
    use super::*;

    #[test]
    fn who_holds_a_run_comes_first_then_its_result_then_its_last_word() {
        let mut identity = Identity::new().unwrap();
        let state = |identity: &Identity, held, complete| state_of(identity, &held, complete).to_string();
        assert_eq!(state(&identity, LockState::Free, false), "not started");
        identity.begin_incarnation();
        assert_eq!(state(&identity, LockState::Unsigned, false), "running");
        assert_eq!(state(&identity, LockState::Free, false), "cut off");
        for (how, word) in [
            (Ending::Complete, "complete"),
            (Ending::Stopped, "stopped"),
            (Ending::Interrupted, "interrupted"),
            (Ending::Failed, "failed"),
        ] {
            identity.end_incarnation(Ended {
                how,
                at_unix_s: 1,
                wall_s: None,
                frames: None,
                weights: None,
                reason: None,
            });
            assert_eq!(state(&identity, LockState::Free, false), word);
        }
        assert_eq!(state(&identity, LockState::Free, true), "complete");
    }
}
