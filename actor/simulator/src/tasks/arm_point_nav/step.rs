//! What an environment reports of a step: records with the channels of `task.toml`, which the build script makes.

use proto::config::CarriedGoal;
use proto::task::{Check, Implausible, LINE_BYTES, Spec};

include!(concat!(env!("OUT_DIR"), "/arm_point_nav.rs"));

impl Transition {
    /// Whether the action failed (blocked, out of reach, a `PickUp` that holds nothing, a Done away from the goal).
    pub fn failed(&self) -> bool {
        self.failed_action != 0.0
    }

    pub fn picked_up(&self) -> bool {
        self.picked_up != 0.0
    }

    /// Whether Done was declared with the target at its goal.
    pub fn succeeded(&self) -> bool {
        self.goal_success != 0.0
    }

    /// Whether the target was held after the action.
    pub fn holds(&self) -> bool {
        self.held != 0
    }
}

/// The goal vector that the policy is given, metres: from the wrist to the object, and while that is held between object
/// and goal. The reference's sensor has that one from the goal to the object.
pub fn goal_m(
    carried: CarriedGoal,
    holding: bool,
    wrist_to_object_m: [f32; 3],
    object_to_goal_m: [f32; 3],
) -> [f32; 3] {
    match carried {
        _ if !holding => wrist_to_object_m,
        CarriedGoal::ObjectToGoal => object_to_goal_m,
        // 0 − 0 is 0, but −(0) would be −0, which has another azimuth.
        CarriedGoal::GoalToObject => object_to_goal_m.map(|coordinate| 0.0 - coordinate),
    }
}

/// A record of the task without its header, its actions and its frame.
pub fn record(spec: &Spec, transition: &Transition, current: &Current) -> Vec<u8> {
    let layout = spec.layout();
    let mut record = vec![0; layout.small_bytes.next_multiple_of(LINE_BYTES)];
    transition.write(&mut record[layout.of_action.clone()]);
    current.write(&mut record[layout.seen.clone()]);
    record
}

/// Checks what an environment reports as a learner does.
pub fn check(spec: &Spec, transition: &Transition, current: &Current) -> Result<(), Implausible> {
    Check::of(spec).record(&record(spec, transition, current), true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn while_it_is_held_the_goal_has_the_configured_sign() {
        let given = |carried, holding, to_goal| goal_m(carried, holding, [0.1, -0.2, 0.3], to_goal);
        for (carried, held) in
            [(CarriedGoal::GoalToObject, [1.0, 0.2, -2.0]), (CarriedGoal::ObjectToGoal, [-1.0, -0.2, 2.0])]
        {
            assert_eq!(given(carried, true, [-1.0, -0.2, 2.0]), held);
            assert_eq!(given(carried, false, [-1.0, -0.2, 2.0]), [0.1, -0.2, 0.3]);
        }
        // The azimuth of (-1, -0) were -π.
        let bits = given(CarriedGoal::GoalToObject, true, [1.0, 0.0, 0.0]).map(f32::to_bits);
        assert_eq!(bits, [-1.0_f32, 0.0, 0.0].map(f32::to_bits));
    }

    #[test]
    fn what_the_records_hold_is_where_the_task_declares_it() {
        let spec = Spec::named("arm_point_nav").unwrap();
        let transition = Transition { disturbance_m: 0.5, target: 3, ..Transition::default() };
        let current = Current { goal_position_m: [1.0, 2.0, 3.0], ..Current::default() };
        let record = record(spec, &transition, &current);
        let numbers = |name: &str| spec.channel(name).unwrap().1.numbers(&record).collect::<Vec<_>>();
        assert_eq!((numbers("disturbance_m"), numbers("target")), (vec![0.5], vec![3.0]));
        assert_eq!(numbers("goal_position_m"), [1.0, 2.0, 3.0]);
        assert_eq!(
            [size_of::<Transition>(), size_of::<Current>()],
            [spec.layout().of_action.len(), spec.layout().seen.len()]
        );
        assert_eq!(check(spec, &transition, &current), Ok(()));
        let far = Current { goal_position_m: [1e6, 0.0, 0.0], ..Current::default() };
        assert!(check(spec, &transition, &far).unwrap_err().to_string().contains("goal_position_m[0] is 1000000"));
    }
}
