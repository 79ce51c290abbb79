//! The header of a record: what the engine knows of an environment's last action and of its state now, whatever the task.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// In place of an action with a name: the environment stands still for one exchange. No step is taken and none is counted.
/// [`crate::task::Actions::hold`] is that of actions of any kind.
///
/// The learner sends it to the environments that are left over when a stage's frame budget is not a multiple of the number
/// of environments. No task has so many named actions.
pub const HOLD: u8 = 254;

/// Bits of [`RecordHeader::flags`].
pub mod flag {
    /// An action was taken. Unset at step 0 of the first episode after a (re)start, and after a HOLD. (An actor that is
    /// rebuilt after a HOLD has no record of it and repeats the action before.)
    pub const ACTED: u32 = 1;
    /// The task ended the episode with that action. What is seen now is the next episode.
    pub const TERMINATED: u32 = 1 << 1;
    pub const TRUNCATED: u32 = 1 << 2;
    /// What is seen now is the first observation of its episode: beliefs are reset before it is used.
    pub const EPISODE_START: u32 = 1 << 3;
    /// The recorder should keep this episode's bulk channels.
    pub const RECORD_BULK: u32 = 1 << 4;
}

/// Bits that mean something.
const FLAGS: u32 = (flag::RECORD_BULK << 1) - 1;
/// Bits about the last action.
const OF_ACTION: u32 = flag::ACTED | flag::TERMINATED | flag::TRUNCATED;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// The task is over, well or not.
    Terminated,
    Truncated,
}

impl End {
    /// `terminated` or `truncated`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Terminated => "terminated",
            Self::Truncated => "truncated",
        }
    }
}

/// What the engine knows of an environment. The default is all zero: no action was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct RecordHeader {
    /// Hash of the simulator's state after the last action, before any reset.
    pub outcome_hash: u64,
    /// Hash of the simulator's state now; at an episode's start, of its first state.
    pub state_hash: u64,
    /// Index of the environment within the actor.
    pub environment: u32,
    /// Bits of [`flag`].
    pub flags: u32,
    /// Episode of the last action, as a number within the environment.
    pub acted_episode: u32,
    /// Index of the last action in its episode, from 0.
    pub acted_step: u32,
    pub episode: u32,
    /// Actions taken in this episode so far.
    pub step: u32,
    /// Which bulk channels are there, one bit each.
    pub bulk: u32,
    /// Padding up to a cache line, always 0.
    pub reserved: [u32; 5],
}

const _: () = assert!(size_of::<RecordHeader>() == 64);

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("its header's flags are {flags:#x} and its reserved words {reserved:?}, which cannot be")]
pub struct BadHeader {
    flags: u32,
    reserved: [u32; 5],
}

impl RecordHeader {
    /// The header of a record that begins on a cache line. Panics if the bytes are no record.
    pub fn of(record: &[u8]) -> &Self {
        bytemuck::from_bytes(&record[..size_of::<Self>()])
    }

    /// The same, to be written. Panics as [`Self::of`] does.
    pub fn of_mut(record: &mut [u8]) -> &mut Self {
        bytemuck::from_bytes_mut(&mut record[..size_of::<Self>()])
    }

    pub fn has(&self, flag: u32) -> bool {
        self.flags & flag != 0
    }

    /// How the last action ended its episode, if it did.
    pub fn end(&self) -> Option<End> {
        match (self.has(flag::TERMINATED), self.has(flag::TRUNCATED)) {
            (false, false) => None,
            (true, _) => Some(End::Terminated),
            (false, true) => Some(End::Truncated),
        }
    }

    pub fn check(&self) -> Result<(), BadHeader> {
        let Self { flags, reserved, .. } = *self;
        let has = |flag: u32| flags & flag != 0;
        let twice = has(flag::TERMINATED) && has(flag::TRUNCATED);
        let nothing = !has(flag::ACTED) && flags & OF_ACTION != 0;
        let sound = flags & !FLAGS == 0 && !twice && !nothing && reserved == [0; 5];
        if sound { Ok(()) } else { Err(BadHeader { flags, reserved }) }
    }

    pub fn begin(&mut self, episode: u32, state_hash: u64, record_bulk: bool) {
        (self.episode, self.step, self.state_hash) = (episode, 0, state_hash);
        let records = if record_bulk { flag::RECORD_BULK } else { 0 };
        self.flags = self.flags & OF_ACTION | flag::EPISODE_START | records;
    }

    /// An action led to this state.
    pub fn act(&mut self, state_hash: u64, end: Option<End>) {
        (self.acted_episode, self.acted_step) = (self.episode, self.step);
        (self.outcome_hash, self.state_hash) = (state_hash, state_hash);
        self.step += 1;
        let ended = match end {
            None => 0,
            Some(End::Terminated) => flag::TERMINATED,
            Some(End::Truncated) => flag::TRUNCATED,
        };
        self.flags = self.flags & flag::RECORD_BULK | flag::ACTED | ended;
    }

    /// Nothing was done: the environment stays as it is.
    pub fn hold(&mut self) {
        (self.outcome_hash, self.acted_episode, self.acted_step) = (0, 0, 0);
        self.flags &= !OF_ACTION;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episodes_end_is_said_with_the_start_of_the_next() {
        let mut header = RecordHeader { environment: 3, ..RecordHeader::default() };
        header.begin(7, 70, true);
        assert!(header.has(flag::EPISODE_START) && header.has(flag::RECORD_BULK) && !header.has(flag::ACTED));
        header.act(71, None);
        header.act(72, Some(End::Truncated));
        assert_eq!((header.acted_episode, header.acted_step, header.outcome_hash), (7, 1, 72));
        assert!(!header.has(flag::EPISODE_START) && header.has(flag::RECORD_BULK));
        header.begin(8, 80, false);
        assert_eq!((header.end(), header.episode, header.step, header.state_hash), (Some(End::Truncated), 8, 0, 80));
        assert_eq!((header.acted_episode, header.acted_step, header.outcome_hash), (7, 1, 72));
        assert!(header.has(flag::EPISODE_START) && !header.has(flag::RECORD_BULK));
        header.hold();
        assert_eq!((header.end(), header.outcome_hash, header.acted_episode, header.acted_step), (None, 0, 0, 0));
        assert!(header.has(flag::EPISODE_START) && !header.has(flag::ACTED) && header.episode == 8);
        assert_eq!(header.environment, 3);
    }

    #[test]
    fn a_header_that_contradicts_itself_is_found() {
        let wrong = |flags: u32| RecordHeader { flags, ..RecordHeader::default() }.check().is_err();
        assert!(wrong(flag::RECORD_BULK << 1) && wrong(flag::TERMINATED) && wrong(OF_ACTION));
        assert!(!wrong(0) && !wrong(flag::ACTED | flag::TERMINATED | flag::EPISODE_START | flag::RECORD_BULK));
        assert!(RecordHeader { reserved: [0, 0, 1, 0, 0], ..RecordHeader::default() }.check().is_err());
    }
}
