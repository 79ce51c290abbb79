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

    /// The same, to be written.
    pub fn bytes_mut(record: &mut [Self]) -> &mut [u8] {
        bytemuck::cast_slice_mut(record)
    }
}

/// What a sample of the observation service carries.
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

/// Header of an action batch. The payload is one byte an environment of the half: the index of an
/// action of the task, or [`proto::record::HOLD`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("stillroom/ActionHeader/1")]
#[repr(C)]
pub struct ActionHeader {
    /// The `step` of the observations that these actions answer.
    pub step: u64,
    /// Version of the stage announcement in force.
    pub stage_version: u64,
    pub learner_incarnation: u32,
    /// Which half: 0 or 1.
    pub half: u32,
}

/// Header of a restore: the payload is one [`EnvironmentState`] an environment, in order, as bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("stillroom/RestoreHeader/1")]
#[repr(C)]
pub struct RestoreHeader {
    /// Exchange number that each half continues from (`step` of the observation it sends next).
    pub step: [u64; 2],
    /// Version of the stage announcement in force.
    pub stage_version: u64,
    /// Incarnation of the sending learner; the actor adopts it.
    pub learner_incarnation: u32,
    /// Actor incarnation this is for; 0 = whichever listens.
    pub actor_incarnation: u32,
}

/// All that is needed to rebuild an environment: which episode, and the actions taken in it so far.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EnvironmentState {
    /// Episode number within the environment.
    pub episode: u32,
    actions: Vec<u8>,
}

/// A restore that no learner of ours sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a restore of {bytes} bytes claims {claimed} actions in one episode")]
pub struct BadRestore {
    bytes: usize,
    claimed: u32,
}

impl EnvironmentState {
    /// Bytes of one before its actions: episode and number of actions, both little-endian `u32`.
    const HEAD_BYTES: usize = 8;

    /// After these actions, by their indices.
    ///
    /// # Panics
    /// If they are more than [`MAX_EPISODE_STEPS`].
    pub fn after(episode: u32, actions: &[u8]) -> Self {
        assert!(actions.len() <= MAX_EPISODE_STEPS, "an episode never exceeds MAX_EPISODE_STEPS");
        Self { episode, actions: actions.to_vec() }
    }

    pub fn start_of(episode: u32) -> Self {
        Self::after(episode, &[])
    }

    /// The actions taken so far, by their indices.
    pub fn actions(&self) -> &[u8] {
        &self.actions
    }

    pub fn action_count(&self) -> u32 {
        self.actions.len() as u32
    }

    /// Bytes of a state with so many actions.
    pub(crate) const fn bytes(actions: usize) -> usize {
        Self::HEAD_BYTES + actions
    }

    /// States as the payload of a restore.
    pub fn encode(states: &[Self]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(states.iter().map(|state| Self::bytes(state.actions.len())).sum());
        for state in states {
            bytes.extend(state.episode.to_le_bytes());
            bytes.extend(state.action_count().to_le_bytes());
            bytes.extend(&state.actions);
        }
        bytes
    }

    /// What [`Self::encode`] made.
    pub fn decode(payload: &[u8]) -> Result<Vec<Self>, BadRestore> {
        let (mut states, mut rest) = (vec![], payload);
        while !rest.is_empty() {
            let mut word = || Some(u32::from_le_bytes(*rest.split_off(..4)?.first_chunk()?));
            let head = [word(), word()];
            let claimed = head[1].unwrap_or_default();
            let actions = rest.split_off(..claimed as usize).filter(|actions| actions.len() <= MAX_EPISODE_STEPS);
            match (head, actions) {
                ([Some(episode), Some(_)], Some(actions)) => states.push(Self::after(episode, actions)),
                _ => return Err(BadRestore { bytes: payload.len(), claimed }),
            }
        }
        Ok(states)
    }

    /// Notes one more action.
    ///
    /// # Panics
    /// If the episode already has [`MAX_EPISODE_STEPS`] actions.
    pub fn push(&mut self, action: u8) {
        assert!(self.actions.len() < MAX_EPISODE_STEPS, "an episode never exceeds MAX_EPISODE_STEPS");
        self.actions.push(action);
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

/// Values of [`StageAnnouncement::directive`].
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
    /// The halves of `environments` environments.
    ///
    /// # Panics
    /// If `environments` is 0.
    pub fn of(environments: u32) -> Self {
        assert!(environments > 0, "an actor has at least one environment");
        Self { environments }
    }

    /// 1 or 2.
    pub fn count(self) -> u32 {
        self.environments.min(2)
    }

    /// Environment indices of a half.
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
        let mut states = vec![EnvironmentState::start_of(3), EnvironmentState::after(9, &long)];
        states[0].push(5);
        let bytes = EnvironmentState::encode(&states);
        assert_eq!(bytes.len(), EnvironmentState::bytes(1) + EnvironmentState::bytes(MAX_EPISODE_STEPS));
        assert_eq!(EnvironmentState::decode(&bytes), Ok(states));
        for cut in [1, 4, 7, 8, 12, bytes.len() - 1] {
            assert!(EnvironmentState::decode(&bytes[..cut]).is_err(), "{cut}");
        }
        let claims = [0, 0, 0, 0, 255, 255, 255, 255, 1];
        let refused = EnvironmentState::decode(&claims).unwrap_err().to_string();
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
