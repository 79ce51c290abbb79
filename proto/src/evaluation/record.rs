//! What came of one episode.

use super::asked::ObjectSet;
use super::confusion::Confusion;
use crate::kitchen::{KitchenId, TargetCategory};
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeEnd {
    /// The policy declared Done.
    Done,
    /// At the step limit.
    TimeLimit,
}

/// The record of one episode. "At the end" is after its last action. Displacements are of everything movable but the
/// target, from where it stood at step 0, measured after each action.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    pub kitchen: KitchenId,
    /// Its number within the kitchen.
    pub episode: u32,
    pub category: TargetCategory,
    pub end: EpisodeEnd,
    /// Done was declared with the target at its goal.
    pub success: bool,
    /// The target was picked up.
    pub picked_up: bool,
    /// The action that picked it up, counted from 1; none if it was not, and in records of older versions.
    pub pickup_step: Option<u32>,
    /// Actions taken.
    pub length: u32,
    pub failed_actions: u32,
    /// Undiscounted return under r.
    pub return_r: f64,
    /// Undiscounted return under r′, with the run's `λ_disturb`.
    pub return_r_prime: f64,
    /// `d_T`: total displacement at the end, metres.
    pub disturbance_m: f32,
    /// Largest total displacement after any action, metres.
    pub peak_disturbance_m: f32,
    /// Objects more than 0.01 m from their place on some axis at the end.
    pub disturbed_objects: u32,
    /// Objects that were so after some action.
    pub ever_disturbed_objects: u32,
    /// Displacement of the object that is farthest from its place at the end, metres.
    pub farthest_m: f32,
    /// Largest displacement of any one object after any action, metres.
    pub peak_farthest_m: f32,
    /// Steps that disturbed: the total displacement rose by τ or more; none in records of older versions.
    pub disturbing_steps: Option<u32>,
    /// Steps after which the total displacement was at least 0.01 m; none in records of older versions.
    pub displaced_steps: Option<u32>,
    /// Distance of wrist and target at the end, metres.
    pub wrist_object_m: f32,
    /// Distance of target and goal at the end, metres.
    pub object_goal_m: f32,
    /// Predictions of the disturbance head for the actions taken; none if the policy has no such head.
    pub disturb_prediction: Option<Confusion>,
    /// Hash of the simulator's state at the end.
    pub state_hash: u64,
}

impl EpisodeRecord {
    /// Successful with `d_T` below this threshold, metres.
    pub fn succeeded_within(&self, threshold_m: f32) -> bool {
        self.success && self.disturbance_m < threshold_m
    }

    /// Successful with no object disturbed at the end: moved more than 0.01 m on some axis.
    pub fn succeeded_undisturbed_per_axis(&self) -> bool {
        self.success && self.disturbed_objects == 0
    }

    /// Some object was away from its place during the episode and is back at its end.
    pub(super) fn displaced_temporarily(&self) -> bool {
        self.ever_disturbed_objects > self.disturbed_objects
    }

    /// Actions after the one that picked the target up, until the policy declared Done.
    pub(super) fn done_after_pickup(&self) -> Option<u32> {
        self.length.checked_sub(self.pickup_step?).filter(|_| self.end == EpisodeEnd::Done)
    }

    /// Novel or seen.
    pub(super) fn object_set(&self) -> ObjectSet {
        if ObjectSet::Novel.contains(self.category) { ObjectSet::Novel } else { ObjectSet::Seen }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Any record that an episode can leave behind.
    pub fn any_record() -> impl Strategy<Value = EpisodeRecord> {
        let metres = || 0.0f32..50.0;
        let task = (0..720u32, any::<bool>(), any::<bool>(), 1..=200u32, 0..200u32, any::<[bool; 2]>());
        let moved = (metres(), metres(), 0..90u32, 0..90u32, metres(), metres());
        let rest = (-100.0f64..100.0, -1e4f64..100.0, metres(), metres(), any::<u64>(), any::<[u16; 4]>());
        let steps = any::<[Option<u8>; 3]>();
        let test_kitchens = KitchenId::of_split(crate::kitchen::Split::Test);
        (prop::sample::select(test_kitchens), task, moved, rest, steps).prop_map(
            |(kitchen, task, moved, rest, steps)| {
                let (episode, done, success, length, failed_actions, [picked_up, head]) = task;
                let (disturbance_m, over_m, disturbed_objects, others, farthest_m, farther_m) = moved;
                let (return_r, return_r_prime, wrist_object_m, object_goal_m, state_hash, counts) = rest;
                let [pickup_step, disturbing_steps, displaced_steps] = steps.map(|steps| steps.map(u32::from));
                let [hits, misses, false_alarms, quiet] = counts.map(u64::from);
                EpisodeRecord {
                    kitchen,
                    episode,
                    category: super::super::category_of(episode),
                    end: if done { EpisodeEnd::Done } else { EpisodeEnd::TimeLimit },
                    success: done && success,
                    picked_up: picked_up || (done && success),
                    pickup_step,
                    length,
                    failed_actions,
                    return_r,
                    return_r_prime,
                    disturbance_m,
                    peak_disturbance_m: disturbance_m + over_m,
                    disturbed_objects,
                    ever_disturbed_objects: disturbed_objects + others,
                    farthest_m,
                    peak_farthest_m: farthest_m + farther_m,
                    disturbing_steps,
                    displaced_steps,
                    wrist_object_m,
                    object_goal_m,
                    disturb_prediction: head.then_some(Confusion { hits, misses, false_alarms, quiet }),
                    state_hash,
                }
            },
        )
    }
}
