//! What an environment reports of one step: what the action did, and what is seen now.
//!
//! Both types lie in shared memory exactly as they are declared here. Therefore they are `repr(C)`, their sizes are
//! fixed, and every byte belongs to a field: `Pod` cannot be derived for a type with hidden padding.

use crate::config::CarriedGoal;
use crate::reward::RewardParts;
use bytemuck::{Pod, Zeroable};

/// Bits of [`Transition::flags`].
pub mod transition_flag {
    /// The transition exists: an action was taken. Unset at step 0 of the first episode after a (re)start, and after a
    /// HOLD. (An actor that is rebuilt after a HOLD has no record of it and repeats the transition before.)
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

/// What the last action did. It belongs to the episode in which the action was taken, also if that has just ended. The
/// default is all zero and not valid: no action was taken.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
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
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
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
    pub reserved: [u32; 2],
}

const _: () = assert!(size_of::<RewardParts>() == 24);
const _: () = assert!(size_of::<Transition>() == 88);
const _: () = assert!(size_of::<Current>() == 112);

impl Current {
    /// The goal vector that the policy is given, robot's frame, metres: from the wrist to the object, and while the object
    /// is held between the object and the goal. Observations and recordings have that always from the object to the goal;
    /// the reference's sensor has it the other way round.
    pub fn goal_vector_m(&self, carried: CarriedGoal) -> [f32; 3] {
        if self.flags & current_flag::HOLDING == 0 {
            return self.wrist_to_object_m;
        }
        match carried {
            CarriedGoal::ObjectToGoal => self.object_to_goal_m,
            // 0 − 0 is 0, but −(0) would be −0, which has another azimuth.
            CarriedGoal::GoalToObject => self.object_to_goal_m.map(|coordinate| 0.0 - coordinate),
        }
    }
}
