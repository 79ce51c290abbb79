//! Payloads in shared memory. All are `repr(C)`, hold no pointers, and have their sizes asserted at compile time.

use crate::reward::RewardParts;
use iceoryx2::prelude::ZeroCopySend;

/// Width and height of a depth frame in pixels.
pub const FRAME_SIDE: usize = 224;
/// Pixels of a depth frame.
pub const FRAME_PIXELS: usize = FRAME_SIDE * FRAME_SIDE;
/// Longest episode a configuration may ask for, steps. Bounds [`EnvironmentState`].
pub const MAX_EPISODE_STEPS: usize = 512;
/// Environments of one actor at most.
pub const MAX_ENVIRONMENTS_PER_ACTOR: usize = 256;

/// Bits of [`Transition::flags`].
pub mod transition_flag {
    /// The transition exists: an action was taken. Unset at step 0 of the first episode after a (re)start, and after
    /// a HOLD. (An actor that is rebuilt after a HOLD knows nothing of it and repeats the transition before.)
    pub const VALID: u32 = 1;
    /// The action failed (blocked, out of reach, or a `PickUp` that holds nothing).
    pub const ACTION_FAILED: u32 = 1 << 1;
    /// The target was held after this step.
    pub const HOLDING: u32 = 1 << 2;
    /// This step picked the target up.
    pub const PICKED_UP: u32 = 1 << 3;
    /// Done was declared; the episode ends.
    pub const DONE: u32 = 1 << 4;
    /// Done was declared with the target at its goal.
    pub const SUCCESS: u32 = 1 << 5;
    /// The episode ended by the step limit.
    pub const TIME_LIMIT: u32 = 1 << 6;
    /// The episode ended, by Done or by the limit; [`super::Current`] is already the next episode.
    pub const ENDED: u32 = 1 << 7;
}

/// Bits of [`Current::flags`].
pub mod current_flag {
    /// This is the first observation of its episode: beliefs are reset before it is used.
    pub const EPISODE_START: u32 = 1;
    /// The target is held: the policy's goal vector is between object and goal (`network.carried_goal`) instead of
    /// wrist→object.
    pub const HOLDING: u32 = 1 << 1;
    /// The recorder should keep this episode's depth frames.
    pub const RECORD_DEPTH: u32 = 1 << 2;
}

/// What the last action did. Speaks of the episode in which the action was taken, also when that has just ended. The
/// default says that no action was taken: it is not valid, and all zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("stillroom/Transition/2")]
#[repr(C)]
pub struct Transition {
    /// Hash of the simulator's state after the action, before any reset.
    pub state_hash: u64,
    /// Episode number within the environment.
    pub episode: u32,
    /// Index of this action in its episode, from 0.
    pub step: u32,
    /// Bits of [`transition_flag`].
    pub flags: u32,
    /// The action taken, an `A_large` index.
    pub action: u32,
    /// Reward parts of this step.
    pub reward: RewardParts,
    /// d: total displacement of all objects but the target from their places at step 0, metres.
    pub disturbance_m: f32,
    /// Largest d of this episode so far, metres.
    pub peak_disturbance_m: f32,
    /// Distance of wrist and target after the step, metres.
    pub wrist_object_m: f32,
    /// Distance of target and goal after the step, metres.
    pub object_goal_m: f32,
    /// Objects other than the target that lie more than 0.01 m from their place on some axis.
    pub disturbed_objects: u32,
    /// Objects other than the target that lay so after some step of this episode so far.
    pub ever_disturbed_objects: u32,
    /// Displacement of the object other than the target that is farthest from its place, metres.
    pub farthest_m: f32,
    /// Largest displacement of any one object after any step of this episode so far, metres.
    pub peak_farthest_m: f32,
    /// Target category, wire value of [`crate::kitchen::TargetCategory`].
    pub target: u32,
    /// Padding, always 0.
    pub reserved: u32,
}

/// What the agent sees now, without the frame. The default is all zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("stillroom/Current/1")]
#[repr(C)]
pub struct Current {
    /// Hash of the simulator's state now; at an episode's start, of its first state.
    pub state_hash: u64,
    /// Episode number within the environment.
    pub episode: u32,
    /// Actions taken in this episode so far.
    pub step: u32,
    /// Bits of [`current_flag`].
    pub flags: u32,
    /// Target category, wire value of [`crate::kitchen::TargetCategory`].
    pub target: u32,
    /// Action that led here, an `A_large` index, or `NO_ACTION` at an episode's start.
    pub previous_action: u32,
    /// From wrist to target, robot's frame (x right, y up, z ahead), metres.
    pub wrist_to_object_m: [f32; 3],
    /// From target to goal, robot's frame, metres.
    pub object_to_goal_m: [f32; 3],
    /// Position of the body's axis on the floor, world (x, z), metres.
    pub base_position_m: [f32; 2],
    /// Body's yaw, radians, positive to the right.
    pub base_yaw_rad: f32,
    /// Head camera's pitch, radians, positive downwards.
    pub camera_pitch_rad: f32,
    /// Wrist position, world, metres.
    pub wrist_position_m: [f32; 3],
    /// Target position, world, metres.
    pub target_position_m: [f32; 3],
    /// Goal position of the target, world, metres.
    pub goal_position_m: [f32; 3],
    /// Padding, always 0.
    pub reserved: u32,
}

/// One environment's answer to one action: what the action did, what is seen now, and the depth frame.
#[derive(Debug, Clone, Copy, ZeroCopySend)]
#[type_name("stillroom/Observation/2")]
#[repr(C)]
#[repr(align(64))]
pub struct Observation {
    /// What the last action did.
    pub transition: Transition,
    /// What is seen now.
    pub current: Current,
    /// Environment index within the actor.
    pub environment: u32,
    /// Padding up to the frame, always 0.
    pub reserved: [u32; 5],
    /// Depth along the camera's axis, millimetres, row-major from the top left; 0 where nothing was hit.
    pub depth_mm: [u16; FRAME_PIXELS],
}

/// Byte offset of the depth frame in an [`Observation`].
pub const DEPTH_OFFSET: usize = core::mem::offset_of!(Observation, depth_mm);

const _: () = assert!(size_of::<RewardParts>() == 24);
const _: () = assert!(size_of::<Transition>() == 88);
const _: () = assert!(size_of::<Current>() == 112);
const _: () = assert!(DEPTH_OFFSET == 224);
const _: () = assert!(size_of::<Observation>() == 100_608);
const _: () = assert!(size_of::<Observation>().is_multiple_of(64));

/// What a sample of the observation service carries.
pub mod observation_kind {
    /// The actor has just started and asks for its environments' states. The payload is zeroed.
    pub const HELLO: u32 = 1;
    /// Observations of one half of the actor's environments.
    pub const OBSERVATIONS: u32 = 2;
}

/// Header of an observation sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[type_name("stillroom/ObservationHeader/1")]
#[repr(C)]
pub struct ObservationHeader {
    /// Exchange number: how many actions this half has been given since the run's first step.
    pub step: u64,
    /// Version of the stage announcement in force, echoed from the last action batch.
    pub stage_version: u64,
    /// Value of [`observation_kind`].
    pub kind: u32,
    /// Actor number.
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

/// Header of an action batch. The payload is one byte an environment of the half: an `A_large` index or `HOLD`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[type_name("stillroom/ActionHeader/1")]
#[repr(C)]
pub struct ActionHeader {
    /// The `step` of the observations that these actions answer.
    pub step: u64,
    /// Version of the stage announcement in force.
    pub stage_version: u64,
    /// Incarnation of the learner that speaks.
    pub learner_incarnation: u32,
    /// Which half: 0 or 1.
    pub half: u32,
}

/// Header of a restore: the payload is one [`EnvironmentState`] an environment, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[type_name("stillroom/RestoreHeader/1")]
#[repr(C)]
pub struct RestoreHeader {
    /// Exchange number that each half goes on from (`step` of the observation it sends next).
    pub step: [u64; 2],
    /// Version of the stage announcement in force.
    pub stage_version: u64,
    /// Incarnation of the learner that speaks: the actor adopts it.
    pub learner_incarnation: u32,
    /// Actor incarnation this is for; 0 = whichever listens.
    pub actor_incarnation: u32,
}

/// All that is needed to rebuild an environment: which episode, and the actions taken in it so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ZeroCopySend)]
#[type_name("stillroom/EnvironmentState/1")]
#[repr(C)]
pub struct EnvironmentState {
    /// Episode number within the environment.
    pub episode: u32,
    /// Actions taken in it so far.
    pub action_count: u32,
    /// The actions, `A_large` indices; only the first `action_count` are meaningful, the rest are 0.
    pub actions: [u8; MAX_EPISODE_STEPS],
}

const _: () = assert!(size_of::<EnvironmentState>() == 520);

impl EnvironmentState {
    /// The state at the start of an episode.
    pub fn start_of(episode: u32) -> Self {
        Self { episode, action_count: 0, actions: [0; MAX_EPISODE_STEPS] }
    }

    /// The actions taken so far.
    ///
    /// # Panics
    /// If `action_count` exceeds the capacity: the state came from a corrupt source.
    pub fn actions(&self) -> &[u8] {
        &self.actions[..self.action_count as usize]
    }

    /// Notes one more action.
    ///
    /// # Panics
    /// If the episode already has [`MAX_EPISODE_STEPS`] actions.
    pub fn push(&mut self, action: u8) {
        assert!((self.action_count as usize) < MAX_EPISODE_STEPS, "an episode never exceeds MAX_EPISODE_STEPS");
        self.actions[self.action_count as usize] = action;
        self.action_count += 1;
    }
}

/// Values of [`StageAnnouncement::directive`].
pub mod directive {
    /// Collect and train on the announced rollout.
    pub const TRAIN: u32 = 1;
    /// Save the state as of the last rollout boundary and exit.
    pub const STOP: u32 = 2;
}

/// The orchestrator's word on what the learners do next. History 1, versions only grow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
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
    fn halves_cover_all_environments_once() {
        for n in 1..=9 {
            let halves = Halves::of(n);
            let all: Vec<usize> = (0..halves.count()).flat_map(|half| halves.range(half)).collect();
            assert_eq!(all, (0..n as usize).collect::<Vec<_>>());
            assert!((0..halves.count()).all(|half| !halves.range(half).is_empty()));
        }
    }
}
