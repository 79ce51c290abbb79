//! The reward, defined here only (`docs/method.md`, Reward; paper equations 1 and 2).
//!
//! Actors send [`RewardParts`]; the learner composes r or r′ from them with the stage in force, so a stage switch
//! never reaches the simulator.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Reward of every step.
const STEP: f32 = -0.01;
/// Added when the action failed.
const FAILED_ACTION: f32 = -0.03;
/// Added once, when the target is picked up.
pub const PICK_UP: f32 = 5.0;
/// Added when Done is declared with the target at its goal.
pub const GOAL_SUCCESS: f32 = 10.0;
/// Total displacement that rises by at least this in one step is a disturbance: threshold of the auxiliary label,
/// metres.
const DISTURBANCE_LABEL_THRESHOLD_M: f32 = 0.001;
/// An episode with less total displacement than this is "without disturbance" (`SRwoD`), metres.
pub const UNDISTURBED_THRESHOLD_M: f32 = 0.01;
/// Displacement of one object counts at most this much, metres.
pub const OBJECT_DISPLACEMENT_CAP_M: f32 = 10.0;

/// Which reward a stage optimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum RewardKind {
    /// r: reach, pick up, bring (paper equation 1).
    #[serde(rename = "r")]
    Task,
    /// r′ = r + `λ_disturb` (d_{t-1} - `d_t`) (paper equation 2).
    #[serde(rename = "r_prime")]
    DisturbanceFree,
    /// r + λ (d_{t-1} - `d_t`), λ the multiplier that PPO-Lagrangian raises while there is disturbance.
    #[serde(rename = "lagrangian")]
    Lagrangian,
}

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
    /// Label of the auxiliary task: this step disturbed something.
    pub fn disturbed(&self) -> bool {
        // Progress is the decrease of d: a negative progress is a disturbance.
        self.disturbance_progress_m <= -DISTURBANCE_LABEL_THRESHOLD_M
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

    /// The reward of this step under `kind`. `disturbance_weight` is the weight of one metre of displacement:
    /// `λ_disturb` in r′, the multiplier in PPO-Lagrangian's reward; r ignores it.
    pub fn compose(&self, kind: RewardKind, disturbance_weight: f32) -> f32 {
        let task = STEP
            + FAILED_ACTION * self.failed_action
            + PICK_UP * self.picked_up
            + GOAL_SUCCESS * self.goal_success
            + self.wrist_object_progress_m
            + self.object_goal_progress_m;
        match kind {
            RewardKind::Task => task,
            RewardKind::DisturbanceFree | RewardKind::Lagrangian => {
                task + disturbance_weight * self.disturbance_progress_m
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rises_by_the_threshold_is_a_disturbance() {
        let disturbed =
            |disturbance_progress_m| RewardParts { disturbance_progress_m, ..RewardParts::default() }.disturbed();
        assert!(disturbed(-DISTURBANCE_LABEL_THRESHOLD_M) && disturbed(-0.5));
        assert!(![-0.0009, 0.0, 0.5].into_iter().any(disturbed));
    }

    // ANCHOR: count
    /// The example of docs/own-parts.md: r less a price for each action that disturbs something.
    fn r_count(parts: &RewardParts, price: f32) -> f32 {
        parts.compose(RewardKind::Task, 0.0) - price * f32::from(u8::from(parts.disturbed()))
    }

    #[test]
    fn a_reward_by_count_takes_its_price_once_whatever_the_distance() {
        let after = |disturbance_progress_m| {
            let parts = RewardParts { disturbance_progress_m, ..RewardParts::default() };
            r_count(&parts, 0.5)
        };
        let undisturbed = after(0.0);
        assert_eq!([after(-0.002), after(-3.0)], [undisturbed - 0.5; 2]);
        // Putting something back earns nothing, and a tremble below the threshold costs nothing.
        assert_eq!([after(3.0), after(-0.0005)], [undisturbed; 2]);
    }
    // ANCHOR_END: count

    #[test]
    fn r_prime_and_the_lagrangian_add_only_the_disturbance_term() {
        let parts = RewardParts {
            wrist_object_progress_m: 0.2,
            object_goal_progress_m: -0.1,
            disturbance_progress_m: -0.02,
            failed_action: 1.0,
            picked_up: 0.0,
            goal_success: 0.0,
        };
        assert!((parts.compose(RewardKind::Task, 15.0) - 0.06).abs() < 1e-6);
        assert!((parts.compose(RewardKind::DisturbanceFree, 15.0) + 0.24).abs() < 1e-6);
        assert!((parts.compose(RewardKind::Lagrangian, 3.0)).abs() < 1e-6);
    }
}
