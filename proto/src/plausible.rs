//! What an environment can report of a step: ranges, and flags that must go together.
//!
//! Observations come from another process through shared memory. One that is faulty, or not ours, can write anything
//! there. A number that no simulator of ours reports must not be trained on, and not be recorded as a fact. The checks
//! are a few dozen comparisons for each step, next to a frame of 100 kB.

use crate::action::Action;
use crate::kitchen::TargetCategory;
use crate::reward::{OBJECT_DISPLACEMENT_CAP_M, RewardParts};
use crate::step::{Current, Transition, current_flag, transition_flag};

/// Nothing is farther away, metres. A scene reaches 1 km, and what falls out of one falls for as long as an episode
/// lasts, at the speed that physics limits.
const DISTANCE_MOST_M: f32 = 1e5;
/// No kitchen has more movable things.
const OBJECTS_MOST: u32 = 65_535;
/// Bits of [`Transition::flags`] that mean something, up to the highest.
const TRANSITION_FLAGS: u32 = (transition_flag::ENDED << 1) - 1;
/// The same of [`Current::flags`].
const CURRENT_FLAGS: u32 = (current_flag::RECORD_DEPTH << 1) - 1;

/// A report that no simulator of ours makes.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Implausible {
    #[error("its {0} is not finite")]
    NotFinite(&'static str),
    #[error("its {what} is {value}, which cannot be")]
    Range { what: &'static str, value: f64 },
    /// What is said twice is not the same.
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
    let Some(transition) = transition else { return Ok(()) };
    check_transition(transition)?;
    let has = |flag| transition.flags & flag != 0;
    if !has(transition_flag::ENDED) {
        agree("target", transition.target == current.target, "target now")?;
        let holds = current.flags & current_flag::HOLDING != 0;
        agree("holding flag", has(transition_flag::HOLDING) == holds, "holding flag now")?;
    }
    Ok(())
}

fn check_transition(transition: &Transition) -> Result<(), Implausible> {
    let Transition { flags, action, target, reserved, .. } = *transition;
    let has = |flag: u32| flags & flag != 0;
    known_bits("transition flags", flags, TRANSITION_FLAGS)?;
    known_target(target)?;
    below("reserved word", reserved, 1)?;
    let ended = has(transition_flag::DONE) || has(transition_flag::TIME_LIMIT);
    agree("end flag", has(transition_flag::ENDED) == ended, "done and time-limit flags")?;
    agree("done flag", !(has(transition_flag::DONE) && has(transition_flag::TIME_LIMIT)), "time-limit flag")?;
    let is = |wanted: Action| action == u32::from(wanted.index());
    agree("done flag", has(transition_flag::DONE) == is(Action::DoneMidLevel), "action")?;
    if has(transition_flag::DONE) {
        agree(
            "success flag",
            has(transition_flag::SUCCESS) != has(transition_flag::ACTION_FAILED),
            "failed-action flag",
        )?;
    } else {
        agree("success flag", !has(transition_flag::SUCCESS), "done flag")?;
    }
    if has(transition_flag::SUCCESS) {
        agree("success flag", has(transition_flag::HOLDING), "holding flag")?;
    }
    if has(transition_flag::PICKED_UP) {
        agree("pick-up flag", has(transition_flag::HOLDING), "holding flag")?;
        agree("pick-up flag", is(Action::PickUpMidLevel), "action")?;
    }
    check_reward(&transition.reward, has)?;
    check_figures(transition)
}

/// Reward parts that are 0 or 1 repeat a flag.
fn check_reward(parts: &RewardParts, has: impl Fn(u32) -> bool) -> Result<(), Implausible> {
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
    for (what, part, flag, other) in [
        ("reward for a failed action", failed_action, transition_flag::ACTION_FAILED, "failed-action flag"),
        ("reward for picking up", picked_up, transition_flag::PICKED_UP, "pick-up flag"),
        ("reward for success", goal_success, transition_flag::SUCCESS, "success flag"),
    ] {
        finite(what, part)?;
        agree(what, part == f32::from(u8::from(has(flag))), other)?;
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
    known_bits("flags", current.flags, CURRENT_FLAGS)?;
    known_target(current.target)?;
    below("reserved word", current.reserved[0] | current.reserved[1], 1)?;
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

fn known_bits(what: &'static str, flags: u32, known: u32) -> Result<(), Implausible> {
    if flags & !known == 0 { Ok(()) } else { Err(Implausible::Range { what, value: flags.into() }) }
}

fn known_target(target: u32) -> Result<(), Implausible> {
    below("target", target, TargetCategory::ALL.len() as u32)
}

fn agree(one: &'static str, agrees: bool, other: &'static str) -> Result<(), Implausible> {
    if agrees { Ok(()) } else { Err(Implausible::Contradiction { one, other }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step in the middle of an episode, the target in hand.
    fn sound() -> (Transition, Current) {
        let transition = Transition {
            flags: transition_flag::VALID | transition_flag::HOLDING,
            action: Action::LookUp.index().into(),
            disturbance_m: 0.1,
            peak_disturbance_m: 0.2,
            farthest_m: 0.1,
            peak_farthest_m: 0.1,
            disturbed_objects: 1,
            ever_disturbed_objects: 2,
            target: 3,
            ..Transition::default()
        };
        (transition, Current { flags: current_flag::HOLDING, target: 3, ..Current::default() })
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
        let done = transition_flag::VALID | transition_flag::DONE | transition_flag::ENDED;
        // The end of an episode: what is seen now belongs to the next.
        let at_the_end = |flags: u32, goal_success: f32, failed_action: f32| {
            wrong(|transition, current| {
                transition.flags = done | flags;
                transition.action = Action::DoneMidLevel.index().into();
                transition.reward.goal_success = goal_success;
                transition.reward.failed_action = failed_action;
                *current = Current { flags: current_flag::EPISODE_START, target: 1, ..Current::default() };
            })
        };
        assert_eq!(at_the_end(transition_flag::SUCCESS | transition_flag::HOLDING, 1.0, 0.0), "nothing");
        assert_eq!(at_the_end(transition_flag::ACTION_FAILED, 0.0, 1.0), "nothing");
        assert!(at_the_end(transition_flag::SUCCESS, 1.0, 0.0).contains("holding"));
        assert!(at_the_end(0, 0.0, 0.0).contains("success flag"));
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
        assert!(wrong(|transition, _| transition.flags |= 1 << 8).contains("transition flags"));
        assert!(wrong(|_, current| current.flags |= 1 << 3).contains("flags is 10"));
        assert!(wrong(|_, current| current.reserved[1] = 1).contains("reserved"));
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(20_000))]

        /// Whatever bytes come: what passes has a reward that training can bear.
        #[test]
        fn what_passes_can_be_trained_on(
            words in proptest::collection::vec((0usize..50, proptest::prelude::any::<u32>()), 0..4),
        ) {
            let (mut transition, mut current) = sound();
            for (place, word) in words {
                let bytes = word.to_ne_bytes();
                match place.checked_sub(22) {
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
    fn what_is_said_twice_must_be_the_same() {
        assert!(wrong(|transition, _| transition.reward.picked_up = 1.0).contains("pick-up flag"));
        assert!(wrong(|transition, _| transition.flags |= transition_flag::ACTION_FAILED).contains("failed action"));
        assert!(wrong(|transition, _| transition.flags |= transition_flag::ENDED).contains("end flag"));
        assert!(wrong(|transition, _| transition.flags |= transition_flag::SUCCESS).contains("success flag"));
        assert!(wrong(|transition, _| transition.action = Action::DoneMidLevel.index().into()).contains("done flag"));
        assert!(wrong(|transition, _| transition.peak_disturbance_m = 0.0).contains("greatest disturbance"));
        assert!(wrong(|transition, _| transition.disturbed_objects = 3).contains("ever disturbed"));
        assert!(wrong(|_, current| current.target = 4).contains("target now"));
        assert!(wrong(|_, current| current.flags = 0).contains("holding flag now"));
        let pick = |flags: u32, action: Action| {
            wrong(|transition, _| {
                transition.flags = flags;
                transition.action = action.index().into();
                transition.reward.picked_up = 1.0;
            })
        };
        let flags = transition_flag::VALID | transition_flag::PICKED_UP;
        assert_eq!(pick(flags | transition_flag::HOLDING, Action::PickUpMidLevel), "nothing");
        assert!(pick(flags, Action::PickUpMidLevel).contains("holding"));
        assert!(pick(flags | transition_flag::HOLDING, Action::LookUp).contains("action"));
    }
}
