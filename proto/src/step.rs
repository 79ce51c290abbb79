//! What an environment reports of one step beside the [header](crate::record): what the action did, and what is seen
//! now.
//!
//! Both types lie in shared memory exactly as they are declared here. Therefore they are `repr(C)`, their sizes are
//! fixed, and every byte belongs to a field: `Pod` cannot be derived for a type with hidden padding.

use crate::config::CarriedGoal;
use crate::reward::RewardParts;
use bytemuck::{Pod, Zeroable};

/// What the last action did. It belongs to the episode in which the action was taken, also if that has just ended. The
/// default is all zero: no action was taken.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Transition {
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
    /// 1 if the target was held after the action, else 0.
    pub holding: u32,
}

/// What the agent sees now, without the frame. The default is all zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Current {
    /// 1 if the target is held, else 0: the policy's goal vector is between object and goal then
    /// (`network.carried_goal`) instead of wrist→object.
    pub holding: u32,
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
}

const _: () = assert!(size_of::<RewardParts>() == 24);
const _: () = assert!(size_of::<Transition>() == 68);
const _: () = assert!(size_of::<Current>() == 88);

impl Transition {
    /// Whether the action failed (blocked, out of reach, a `PickUp` that holds nothing, a Done away from the goal).
    pub fn failed(&self) -> bool {
        self.reward.failed_action != 0.0
    }

    /// Whether this action picked the target up.
    pub fn picked_up(&self) -> bool {
        self.reward.picked_up != 0.0
    }

    /// Whether Done was declared with the target at its goal.
    pub fn succeeded(&self) -> bool {
        self.reward.goal_success != 0.0
    }

    /// Whether the target was held after the action.
    pub fn holds(&self) -> bool {
        self.holding != 0
    }
}

impl Current {
    /// Whether the target is held.
    pub fn holds(&self) -> bool {
        self.holding != 0
    }

    /// The goal vector that the policy is given, robot's frame, metres: from the wrist to the object, and while the object
    /// is held between the object and the goal. Observations and recordings have that always from the object to the goal;
    /// the reference's sensor has it the other way round.
    pub fn goal_vector_m(&self, carried: CarriedGoal) -> [f32; 3] {
        if !self.holds() {
            return self.wrist_to_object_m;
        }
        match carried {
            CarriedGoal::ObjectToGoal => self.object_to_goal_m,
            // 0 − 0 is 0, but −(0) would be −0, which has another azimuth.
            CarriedGoal::GoalToObject => self.object_to_goal_m.map(|coordinate| 0.0 - coordinate),
        }
    }
}
