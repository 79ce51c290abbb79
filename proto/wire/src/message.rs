//! Payloads in shared memory. All are `repr(C)` and have their sizes asserted at compile time.
//!
//! All are [`Pod`], too: the compiler thereby proves that they hold no pointers and no hidden padding. Equal messages
//! have equal bytes, but for images of a record that its header does not announce.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use proto::episode::MAX_EPISODE_STEPS;
use proto::task::LINE_BYTES;

/// A cache line of a record. An observation is a record: one environment's answer to one action. It consists of the
/// engine's [header](proto::record::RecordHeader) and the task's bytes, which lie as its
/// [layout](proto::task::Layout) says. Its images may be anything, unless [`proto::record::RecordHeader::bulk`] has the
/// bit of their place among [`proto::task::Layout::images`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable, ZeroCopySend)]
#[type_name("stillroom/Line/1")]
#[repr(C)]
#[repr(align(64))]
pub struct Line(pub [u8; LINE_BYTES]);

const _: () = assert!(align_of::<Line>() == LINE_BYTES);

impl Line {
    pub fn bytes(record: &[Self]) -> &[u8] {
        bytemuck::cast_slice(record)
    }

    pub fn bytes_mut(record: &mut [Self]) -> &mut [u8] {
        bytemuck::cast_slice_mut(record)
    }
}

pub mod observation_kind {
    /// The actor has just started and asks for its environments' states. The payload is zeroed.
    pub const HELLO: u32 = 1;
    /// Observations of one half of the actor's environments.
    pub const OBSERVATIONS: u32 = 2;
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("stillroom/ObservationHeader/1")]
#[repr(C)]
pub struct ObservationHeader {
    /// Exchange number: how many actions this half has been given since the run's first step.
    pub step: u64,
    /// Version of the stage announcement in force, echoed from the last action batch.
    pub stage_version: u64,
    /// Value of [`observation_kind`].
    pub kind: u32,
    pub actor: u32,
    /// How often this actor has been started in this run incarnation, from 1.
    pub actor_incarnation: u32,
    /// The learner incarnation whose `Restore` these environments come from; others ignore the sample.
    pub learner_incarnation: u32,
    /// Which half: 0 or 1.
    pub half: u32,
    /// Padding, always 0.
    pub reserved: u32,
}

/// Header of an action batch. The payload is one action an environment of the half, as many bytes as
/// [`proto::task::Actions::bytes`] says: an action of the task, or [`proto::task::Actions::hold`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("stillroom/ActionHeader/1")]
#[repr(C)]
pub struct ActionHeader {
    /// The `step` of the observations that these actions answer.
    pub step: u64,
    /// Version of the stage announcement in force.
    pub stage_version: u64,
    pub learner_incarnation: u32,
    pub half: u32,
}

/// Header of a restore: the payload is one [`EnvironmentState`] an environment, in order, as bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("stillroom/RestoreHeader/1")]
#[repr(C)]
pub struct RestoreHeader {
    /// Exchange number that each half continues from (`step` of the observation it sends next).
    pub step: [u64; 2],
    pub stage_version: u64,
    /// Incarnation of the sending learner; the actor adopts it.
    pub learner_incarnation: u32,
    /// Actor incarnation this is for; 0 = whichever listens.
    pub actor_incarnation: u32,
}

/// All that is needed to rebuild an environment: which episode, and the actions taken in it so far.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EnvironmentState {
    pub episode: u32,
    /// Actions taken so far, and their bytes.
    count: u32,
    actions: Vec<u8>,
    has_ended: bool,
    before: Option<Snapshot>,
}

/// An environment's state before the last action of an [`EnvironmentState`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Snapshot {
    pub state_hash: u64,
    /// As the environment makes of them what it will; none, if its task is not restored by such.
    pub bytes: Vec<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a restore of {bytes} bytes claims {claimed} actions in one episode")]
pub struct BadRestore {
    bytes: usize,
    claimed: u32,
}

impl EnvironmentState {
    /// Bytes of one before its actions: episode, number of actions, whether the episode has ended, and how many bytes a
    /// snapshot behind the actions has, 0 without one, [`Self::HASH_ALONE`] if only its hash is there: little-endian
    /// `u32`. A snapshot begins with its hash.
    const HEAD_BYTES: usize = 16;
    const HASH_ALONE: u32 = u32::MAX;

    /// After these actions of `bytes` bytes each. Panics if they are more than [`MAX_EPISODE_STEPS`], or one is cut
    /// off.
    pub fn after(episode: u32, actions: &[u8], bytes: usize) -> Self {
        assert!(actions.len().is_multiple_of(bytes), "actions are whole");
        let count = actions.len() / bytes;
        assert!(count <= MAX_EPISODE_STEPS, "an episode never exceeds MAX_EPISODE_STEPS");
        Self { count: count as u32, actions: actions.to_vec(), ..Self::start_of(episode) }
    }

    pub fn start_of(episode: u32) -> Self {
        Self { episode, count: 0, actions: vec![], has_ended: false, before: None }
    }

    pub fn actions(&self) -> &[u8] {
        &self.actions
    }

    pub fn action_count(&self) -> u32 {
        self.count
    }

    /// The last one; nothing at an episode's start.
    pub fn last_action(&self) -> &[u8] {
        let bytes = self.actions.len().checked_div(self.count as usize).unwrap_or(0);
        &self.actions[self.actions.len() - bytes..]
    }

    /// The last action has ended the episode.
    pub fn end(&mut self) {
        self.has_ended = true;
    }

    /// Whether the last action is known to have ended the episode.
    pub fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// The snapshot of the state before the last action, if there is one.
    pub fn snapshot(&self) -> Option<&Snapshot> {
        self.before.as_ref().filter(|before| !before.bytes.is_empty())
    }

    /// Hash of the state before the last action, if it is known.
    pub fn hash_before(&self) -> Option<u64> {
        self.before.as_ref().map(|before| before.state_hash)
    }

    /// The most bytes of a state with so many bytes of actions and a snapshot of so many.
    pub(crate) const fn bytes(actions: usize, snapshot: usize) -> usize {
        Self::HEAD_BYTES + actions + size_of::<u64>() + snapshot
    }

    /// States as the payload of a restore.
    pub fn encode(states: &[Self]) -> Vec<u8> {
        let snapshot_bytes = |state: &Self| state.snapshot().map_or(0, |snapshot| snapshot.bytes.len());
        let length = states.iter().map(|state| Self::bytes(state.actions.len(), snapshot_bytes(state))).sum();
        let mut bytes = Vec::with_capacity(length);
        for state in states {
            let count = match (&state.before, snapshot_bytes(state) as u32) {
                (Some(_), 0) => Self::HASH_ALONE,
                (_, count) => count,
            };
            for word in [state.episode, state.action_count(), state.has_ended.into(), count] {
                bytes.extend(word.to_le_bytes());
            }
            bytes.extend(&state.actions);
            if let Some(before) = &state.before {
                bytes.extend(before.state_hash.to_le_bytes());
                bytes.extend(&before.bytes);
            }
        }
        bytes
    }

    /// What [`Self::encode`] made of states whose actions have `bytes` bytes each.
    pub fn decode(payload: &[u8], bytes: usize) -> Result<Vec<Self>, BadRestore> {
        let (mut states, mut rest) = (vec![], payload);
        while !rest.is_empty() {
            let mut word = || Some(u32::from_le_bytes(*rest.split_off(..4)?.first_chunk()?));
            let head = [word(), word(), word(), word()];
            let claimed = head[1].unwrap_or_default();
            let claimed_bytes = (claimed as usize).checked_mul(bytes).filter(|_| claimed as usize <= MAX_EPISODE_STEPS);
            let actions = claimed_bytes.and_then(|claimed| rest.split_off(..claimed));
            let before = match head[3].unwrap_or_default() {
                0 => Some(None),
                _ if claimed == 0 => None,
                Self::HASH_ALONE => Self::decode_snapshot(&mut rest, 0).map(Some),
                count => Self::decode_snapshot(&mut rest, count as usize).map(Some),
            };
            match (head, actions, before) {
                ([Some(episode), _, Some(ended), Some(_)], Some(actions), Some(before)) => {
                    states.push(Self { has_ended: ended != 0, before, ..Self::after(episode, actions, bytes) });
                }
                _ => return Err(BadRestore { bytes: payload.len(), claimed }),
            }
        }
        Ok(states)
    }

    fn decode_snapshot(rest: &mut &[u8], count: usize) -> Option<Snapshot> {
        let state_hash = u64::from_le_bytes(*rest.split_off(..size_of::<u64>())?.first_chunk()?);
        Some(Snapshot { state_hash, bytes: rest.split_off(..count)?.to_vec() })
    }

    /// Notes one more action. Panics if the episode already has [`MAX_EPISODE_STEPS`] actions.
    pub fn push(&mut self, action: &[u8]) {
        assert!(self.action_count() < MAX_EPISODE_STEPS as u32, "an episode never exceeds MAX_EPISODE_STEPS");
        self.count += 1;
        self.actions.extend_from_slice(action);
        self.before = None;
    }

    /// Notes the state that the last action was taken in. Panics if there is no action.
    pub fn remember(&mut self, before: Snapshot) {
        assert!(!self.actions.is_empty(), "a snapshot is of a state that an action was taken in");
        self.before = Some(before);
    }
}

/// Whether `next` can be the number of a process's start when `last` was the newest known, 0 if none was. A process
/// that dies 20 times without progress is given up, so a number far ahead is of no process of ours. To believe it would
/// mean to ignore all that the true one sends.
pub fn can_follow(last: u32, next: u32) -> bool {
    const FIRST_MOST: u32 = 1 << 16;
    const STEP_MOST: u32 = 64;
    next <= if last == 0 { FIRST_MOST } else { last.saturating_add(STEP_MOST) }
}

pub mod directive {
    /// Collect and train on the announced rollout.
    pub const TRAIN: u32 = 1;
    /// Save the state as of the last rollout boundary and exit.
    pub const STOP: u32 = 2;
}

/// The orchestrator's announcement of the next rollout to the learners. History 1, versions only grow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("stillroom/StageAnnouncement/1")]
#[repr(C)]
pub struct StageAnnouncement {
    /// Version, from 1.
    pub version: u64,
    /// The rollout this allows; a learner starts rollout k only under an announcement with `rollout` = k.
    pub rollout: u64,
    /// Index of the stage in the configuration.
    pub stage: u32,
    /// Value of [`directive`].
    pub directive: u32,
}

/// How an actor's environments are divided into halves: half 0 holds the first ceil(E / 2), half 1 the rest.
///
/// While the learner infers for one half, the actor simulates the other. With one environment there is one half.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Halves {
    environments: u32,
}

impl Halves {
    /// The halves of `environments` environments. Panics if `environments` is 0.
    pub fn of(environments: u32) -> Self {
        assert!(environments > 0, "an actor has at least one environment");
        Self { environments }
    }

    /// 1 or 2.
    pub fn count(self) -> u32 {
        self.environments.min(2)
    }

    pub fn range(self, half: u32) -> core::ops::Range<usize> {
        let middle = self.environments.div_ceil(2) as usize;
        match half {
            0 => 0..middle,
            1 => middle..self.environments as usize,
            _ => unreachable!("an actor has at most two halves"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_far_ahead_is_of_no_process_of_ours() {
        assert!(can_follow(0, 1) && can_follow(0, 300) && can_follow(7, 3) && can_follow(7, 7 + 64));
        assert!(!can_follow(0, u32::MAX) && !can_follow(7, 7 + 65) && can_follow(u32::MAX, u32::MAX));
    }

    #[test]
    fn states_of_any_length_cross_and_what_is_no_state_is_refused() {
        let long: Vec<u8> = (0..MAX_EPISODE_STEPS).map(|step| (step % 7) as u8).collect();
        for width in [1, 8] {
            let long = long.repeat(width);
            let mut states = vec![EnvironmentState::start_of(3), EnvironmentState::after(9, &long, width)];
            states.push(EnvironmentState::start_of(4));
            assert!(states[0].last_action().is_empty());
            states[0].push(&vec![5; width]);
            assert_eq!(
                (states[0].last_action(), states[1].last_action()),
                (&[5; 8][..width], &long[long.len() - width..])
            );
            for action in [1, 2] {
                states[2].push(&vec![action; width]);
                assert_eq!(states[2].snapshot(), None, "that of the action before");
                states[2].remember(Snapshot { state_hash: action.into(), bytes: vec![action, 11] });
            }
            states[2].end();
            states[0].remember(Snapshot { state_hash: 17, bytes: vec![] });
            assert_eq!((states[0].snapshot(), states[0].hash_before()), (None, Some(17)));
            let bytes = EnvironmentState::encode(&states);
            // The second one has no hash.
            let lengths = [(1, 0), (MAX_EPISODE_STEPS, 0), (2, 2)];
            let length = |(actions, snapshot)| EnvironmentState::bytes(actions * width, snapshot);
            assert_eq!(bytes.len() + 8, lengths.map(length).iter().sum::<usize>());
            assert_eq!(EnvironmentState::decode(&bytes, width), Ok(states));
            for cut in [1, 4, 7, 8, 12, bytes.len() - 1, bytes.len() - 9] {
                assert!(EnvironmentState::decode(&bytes[..cut], width).is_err(), "{cut}");
            }
        }
        let mut of_no_action = [0; 16 + 8 + 1];
        of_no_action[12] = 1;
        assert!(EnvironmentState::decode(&of_no_action, 1).is_err());
        let claims = [0, 0, 0, 0, 255, 255, 255, 255, 1];
        let refused = EnvironmentState::decode(&claims, 1).unwrap_err().to_string();
        assert_eq!(refused, "a restore of 9 bytes claims 4294967295 actions in one episode");
    }

    #[test]
    fn halves_cover_all_environments_once() {
        for n in 1..=9 {
            let halves = Halves::of(n);
            let all: Vec<usize> = (0..halves.count()).flat_map(|half| halves.range(half)).collect();
            assert_eq!(all, (0..n as usize).collect::<Vec<_>>());
            assert!((0..halves.count()).all(|half| !halves.range(half).is_empty()));
        }
    }
}
