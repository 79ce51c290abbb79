//! The parts that `ArmPointNav`'s rewards are composed of (`docs/method.md`, Reward).
//!
//! Actors send [`RewardParts`]; the learner composes the reward of the stage in force from them, so a stage switch never
//! reaches the simulator.

use bytemuck::{Pod, Zeroable};

/// An episode with less total displacement than this is "without disturbance" (`SRwoD`), metres.
pub const UNDISTURBED_THRESHOLD_M: f32 = 0.01;
/// Displacement of one object counts at most this much, metres.
pub const OBJECT_DISPLACEMENT_CAP_M: f32 = 10.0;

/// Parts of one step's reward, before any weighting.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct RewardParts {
    /// Previous minus current wrist-object distance, metres; 0 at an episode's first step.
    pub wrist_object_progress_m: f32,
    /// Previous minus current object-goal distance, metres; 0 at an episode's first step.
    pub object_goal_progress_m: f32,
    /// Previous minus current total displacement of all objects but the target, metres (negative: more disturbed).
    pub disturbance_progress_m: f32,
    /// 1 if the action failed, else 0.
    pub failed_action: f32,
    /// 1 if this step picked the target up, else 0.
    pub picked_up: f32,
    /// 1 if this step was a successful Done, else 0.
    pub goal_success: f32,
}

impl RewardParts {
    /// A part's number by the index of its channel: the task declares them first, in this order.
    pub fn part(&self, index: usize) -> f32 {
        bytemuck::cast_ref::<Self, [f32; 6]>(self)[index]
    }

    /// Whether all parts are finite numbers.
    pub fn is_finite(&self) -> bool {
        // Named one by one, so that a new part cannot be left out.
        let Self {
            wrist_object_progress_m,
            object_goal_progress_m,
            disturbance_progress_m,
            failed_action,
            picked_up,
            goal_success,
        } = *self;
        let progress_m = [wrist_object_progress_m, object_goal_progress_m, disturbance_progress_m];
        progress_m.into_iter().chain([failed_action, picked_up, goal_success]).all(f32::is_finite)
    }
}
