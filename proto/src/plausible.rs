//! What an environment can report of a step: the ranges of its numbers.
//!
//! Observations come from another process through shared memory. One that is faulty, or not ours, can write anything
//! there. A number that no simulator of ours reports must not be trained on, and not be recorded as a fact. The checks
//! are a few dozen comparisons for each step, next to a frame of 100 kB.

use crate::action::{ACTION_COUNT, NO_ACTION};
use crate::kitchen::TargetCategory;
use crate::reward::{OBJECT_DISPLACEMENT_CAP_M, RewardParts};
use crate::step::{Current, Transition};

/// Nothing is farther away, metres. A scene reaches 1 km, and what falls out of one falls for as long as an episode
/// lasts, at the speed that physics limits.
const DISTANCE_MOST_M: f32 = 1e5;
/// No kitchen has more movable things.
const OBJECTS_MOST: u32 = 65_535;

/// A report that no simulator of ours makes.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Implausible {
    #[error("its {0} is not finite")]
    NotFinite(&'static str),
    #[error("its {what} is {value}, which cannot be")]
    Range { what: &'static str, value: f64 },
    /// Two figures cannot both be true.
    #[error("its {one} contradicts its {other}")]
    Contradiction {
        /// One figure.
        one: &'static str,
        other: &'static str,
    },
}

/// Checks what an environment reports: what its last action did, if there was one, and what is seen now.
pub fn check(transition: Option<&Transition>, current: &Current) -> Result<(), Implausible> {
    check_current(current)?;
    transition.map_or(Ok(()), check_transition)
}

fn check_transition(transition: &Transition) -> Result<(), Implausible> {
    below("action", transition.action, ACTION_COUNT as u32)?;
    below("target", transition.target, TargetCategory::ALL.len() as u32)?;
    below("holding", transition.holding, 2)?;
    check_reward(&transition.reward)?;
    check_figures(transition)
}

fn check_reward(parts: &RewardParts) -> Result<(), Implausible> {
    // Named one by one, so that a new part cannot be left out.
    let RewardParts {
        wrist_object_progress_m,
        object_goal_progress_m,
        disturbance_progress_m,
        failed_action,
        picked_up,
        goal_success,
    } = *parts;
    distance("wrist-object progress", wrist_object_progress_m)?;
    distance("object-goal progress", object_goal_progress_m)?;
    distance("disturbance progress", disturbance_progress_m)?;
    for (what, part) in [
        ("reward for a failed action", failed_action),
        ("reward for picking up", picked_up),
        ("reward for success", goal_success),
    ] {
        finite(what, part)?;
        if part != 0.0 && part != 1.0 {
            return Err(Implausible::Range { what, value: part.into() });
        }
    }
    Ok(())
}

fn check_figures(transition: &Transition) -> Result<(), Implausible> {
    let Transition { disturbance_m, peak_disturbance_m, farthest_m, peak_farthest_m, .. } = *transition;
    for (what, value, most) in [
        ("disturbance", disturbance_m, DISTANCE_MOST_M),
        ("greatest disturbance", peak_disturbance_m, DISTANCE_MOST_M),
        ("distance of wrist and object", transition.wrist_object_m, DISTANCE_MOST_M),
        ("distance of object and goal", transition.object_goal_m, DISTANCE_MOST_M),
        ("farthest displacement", farthest_m, OBJECT_DISPLACEMENT_CAP_M),
        ("greatest farthest displacement", peak_farthest_m, OBJECT_DISPLACEMENT_CAP_M),
    ] {
        finite(what, value)?;
        if !(0.0..=most).contains(&value) {
            return Err(Implausible::Range { what, value: value.into() });
        }
    }
    agree("disturbance", disturbance_m <= peak_disturbance_m, "greatest disturbance")?;
    agree("farthest displacement", farthest_m <= peak_farthest_m, "greatest farthest displacement")?;
    let (now, ever) = (transition.disturbed_objects, transition.ever_disturbed_objects);
    below("number of disturbed objects", ever, OBJECTS_MOST + 1)?;
    agree("number of disturbed objects", now <= ever, "number of objects ever disturbed")
}

fn check_current(current: &Current) -> Result<(), Implausible> {
    let Current { wrist_to_object_m, object_to_goal_m, base_position_m, base_yaw_rad, camera_pitch_rad, .. } = *current;
    below("target", current.target, TargetCategory::ALL.len() as u32)?;
    below("holding", current.holding, 2)?;
    if current.previous_action != u32::from(NO_ACTION) {
        below("previous action", current.previous_action, ACTION_COUNT as u32)?;
    }
    for (what, values) in [
        ("vector from wrist to object", &wrist_to_object_m[..]),
        ("vector from object to goal", &object_to_goal_m),
        ("place on the floor", &base_position_m),
        ("yaw and pitch", &[base_yaw_rad, camera_pitch_rad]),
        ("wrist's place", &current.wrist_position_m),
        ("target's place", &current.target_position_m),
        ("goal's place", &current.goal_position_m),
    ] {
        values.iter().try_for_each(|&value| distance(what, value))?;
    }
    Ok(())
}

fn finite(what: &'static str, value: f32) -> Result<(), Implausible> {
    if value.is_finite() { Ok(()) } else { Err(Implausible::NotFinite(what)) }
}

fn distance(what: &'static str, value: f32) -> Result<(), Implausible> {
    finite(what, value)?;
    if value.abs() <= DISTANCE_MOST_M { Ok(()) } else { Err(Implausible::Range { what, value: value.into() }) }
}

fn below(what: &'static str, value: u32, limit: u32) -> Result<(), Implausible> {
    if value < limit { Ok(()) } else { Err(Implausible::Range { what, value: value.into() }) }
}

fn agree(one: &'static str, agrees: bool, other: &'static str) -> Result<(), Implausible> {
    if agrees { Ok(()) } else { Err(Implausible::Contradiction { one, other }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::action::Action;

    /// A step in the middle of an episode, the target in hand.
    fn sound() -> (Transition, Current) {
        let transition = Transition {
            action: Action::LookUp.index().into(),
            disturbance_m: 0.1,
            peak_disturbance_m: 0.2,
            farthest_m: 0.1,
            peak_farthest_m: 0.1,
            disturbed_objects: 1,
            ever_disturbed_objects: 2,
            target: 3,
            holding: 1,
            ..Transition::default()
        };
        (transition, Current { holding: 1, target: 3, ..Current::default() })
    }

    /// What is found wrong after a change.
    fn wrong(change: impl Fn(&mut Transition, &mut Current)) -> String {
        let (mut transition, mut current) = sound();
        change(&mut transition, &mut current);
        check(Some(&transition), &current).map_or_else(|error| error.to_string(), |()| "nothing".to_owned())
    }

    #[test]
    fn a_sound_report_passes() {
        assert_eq!(wrong(|_, _| {}), "nothing");
        assert_eq!(wrong(|_, current| current.previous_action = u32::from(NO_ACTION)), "nothing");
        assert_eq!(wrong(|transition, _| transition.reward.goal_success = 1.0), "nothing");
    }

    #[test]
    fn numbers_that_cannot_be_are_found() {
        assert!(wrong(|transition, _| transition.reward.goal_success = 1000.0).contains("reward for success"));
        assert!(wrong(|transition, _| transition.disturbance_m = 3e38).contains("disturbance is 3"));
        assert!(wrong(|transition, _| transition.disturbance_m = -0.1).contains("disturbance is -0.1"));
        assert!(wrong(|_, current| current.object_to_goal_m[1] = 1e6).contains("object to goal is 1000000"));
        assert!(wrong(|_, current| current.goal_position_m[2] = -1e6).contains("goal's place"));
        assert_eq!(
            wrong(|transition, _| transition.wrist_object_m = f32::NAN),
            "its distance of wrist and object is not finite"
        );
        assert!(wrong(|_, current| current.camera_pitch_rad = f32::INFINITY).contains("not finite"));
        assert!(wrong(|transition, _| transition.target = 99).contains("target is 99"));
        assert!(wrong(|_, current| current.target = 99).contains("target is 99"));
        assert!(wrong(|transition, _| transition.ever_disturbed_objects = 70_000).contains("70000"));
        assert!(wrong(|transition, _| transition.holding = 2).contains("holding is 2"));
        assert!(wrong(|_, current| current.holding = 2).contains("holding is 2"));
        assert!(wrong(|transition, _| transition.action = 21).contains("action is 21"));
        assert!(wrong(|_, current| current.previous_action = 21).contains("previous action is 21"));
        assert!(wrong(|transition, _| transition.reward.picked_up = 0.5).contains("reward for picking up is 0.5"));
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(20_000))]

        /// Whatever bytes come: what passes has a reward that training can bear.
        #[test]
        fn what_passes_can_be_trained_on(
            words in proptest::collection::vec((0usize..39, proptest::prelude::any::<u32>()), 0..4),
        ) {
            let (mut transition, mut current) = sound();
            for (place, word) in words {
                let bytes = word.to_ne_bytes();
                match place.checked_sub(17) {
                    None => bytemuck::bytes_of_mut(&mut transition)[4 * place..][..4].copy_from_slice(&bytes),
                    Some(place) => bytemuck::bytes_of_mut(&mut current)[4 * place..][..4].copy_from_slice(&bytes),
                }
            }
            if check(Some(&transition), &current).is_ok() {
                proptest::prop_assert!(transition.reward.is_finite());
                proptest::prop_assert!(transition.disturbance_m >= 0.0 && transition.disturbance_m <= DISTANCE_MOST_M);
                proptest::prop_assert!((transition.target as usize) < TargetCategory::ALL.len());
                proptest::prop_assert!(current.goal_position_m.iter().all(|axis| axis.abs() <= DISTANCE_MOST_M));
            }
        }
    }

    #[test]
    fn the_greatest_so_far_is_no_less_than_what_is_now() {
        assert!(wrong(|transition, _| transition.peak_disturbance_m = 0.0).contains("greatest disturbance"));
        assert!(wrong(|transition, _| transition.peak_farthest_m = 0.0).contains("greatest farthest"));
        assert!(wrong(|transition, _| transition.disturbed_objects = 3).contains("ever disturbed"));
    }
}
