//! What an environment reports of a step. It lies in a record as it is declared here, and as `task.toml` declares it: the
//! first use compares the two.

use crate::robot::action::Action;
use bytemuck::{Pod, Zeroable};
use proto::config::CarriedGoal;
use proto::task::{Check, Implausible, LINE_BYTES, Layout, Spec};
use std::mem::offset_of;
use std::sync::LazyLock;

/// Its name in configurations.
const NAME: &str = "arm_point_nav";

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
}

/// What the last action did. It belongs to the episode in which the action was taken, also if that has just ended. The
/// default is all zero: no action was taken.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Transition {
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
    /// 1 if the target was held after the action, else 0.
    pub held: u32,
    /// Target category, index of [`proto::kitchen::TargetCategory`].
    pub target: u32,
}

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
        self.held != 0
    }
}

/// What the agent sees now, without the frame. The default is all zero.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Current {
    /// The goal vector that the policy is given ([`goal_m`]), robot's frame (x right, y up, z ahead), metres.
    pub goal_m: [f32; 3],
    /// From wrist to target, robot's frame, metres.
    pub wrist_to_object_m: [f32; 3],
    /// From target to goal, robot's frame, metres.
    pub object_to_goal_m: [f32; 3],
    /// 1 if the target is held, else 0.
    pub holding: u32,
    /// Target category, index of [`proto::kitchen::TargetCategory`].
    pub current_target: u32,
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

impl Current {
    /// Whether the target is held.
    pub fn holds(&self) -> bool {
        self.holding != 0
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

/// Fields of a structure, by their own names, with their places.
macro_rules! places {
    ($structure:ty, $($field:ident $(. $inner:ident)?),*) => {
        [$((innermost(&[$(stringify!($inner),)? stringify!($field)]), offset_of!($structure, $field $(. $inner)?))),*]
    };
}

fn innermost(names: &[&'static str]) -> &'static str {
    names[0]
}

struct Declared {
    layout: &'static Layout,
    check: Check,
}

/// The declaration, once it is known to be that of the structures.
static DECLARED: LazyLock<Declared> = LazyLock::new(|| {
    let spec = Spec::built_in().iter().find(|spec| spec.name == NAME).expect("the task is built in");
    let layout = spec.layout();
    let actions = Action::ALL.map(|action| format!("{action:?}"));
    assert_eq!(spec.actions.names(), actions, "task.toml declares other actions than the robot has");
    let done = places!(
        Transition,
        reward.wrist_object_progress_m,
        reward.object_goal_progress_m,
        reward.disturbance_progress_m,
        reward.failed_action,
        reward.picked_up,
        reward.goal_success,
        disturbance_m,
        peak_disturbance_m,
        wrist_object_m,
        object_goal_m,
        disturbed_objects,
        ever_disturbed_objects,
        farthest_m,
        peak_farthest_m,
        held,
        target
    );
    let seen = places!(
        Current,
        goal_m,
        wrist_to_object_m,
        object_to_goal_m,
        holding,
        current_target,
        base_position_m,
        base_yaw_rad,
        camera_pitch_rad,
        wrist_position_m,
        target_position_m,
        goal_position_m
    );
    let place = |name: &str| spec.channel(name).map(|(_, field)| field.offset);
    for (block, fields) in [(&layout.of_action, &done[..]), (&layout.seen, &seen)] {
        for &(name, offset) in fields {
            assert_eq!(place(name), Some(block.start + offset), "task.toml declares `{name}` elsewhere than the code");
        }
    }
    assert_eq!(done.len() + seen.len() + 1, spec.channels.len(), "task.toml declares other channels than the code");
    Declared { layout, check: Check::of(spec) }
});

/// Has the declaration compared with the structures, if it was not yet.
///
/// # Panics
/// If they differ.
pub fn assert_declared() {
    LazyLock::force(&DECLARED);
}

/// Writes what was done and is seen into a record, all but its header, its actions and its frame.
///
/// # Panics
/// If the record is shorter than the task's layout.
pub fn write(record: &mut [u8], transition: &Transition, current: &Current) {
    let layout = DECLARED.layout;
    record[layout.of_action.start..][..size_of::<Transition>()].copy_from_slice(bytemuck::bytes_of(transition));
    record[layout.seen.start..][..size_of::<Current>()].copy_from_slice(bytemuck::bytes_of(current));
}

/// Checks what an environment reports as a learner does.
pub fn check(transition: &Transition, current: &Current) -> Result<(), Implausible> {
    let mut record = vec![0; DECLARED.layout.small_bytes.next_multiple_of(LINE_BYTES)];
    write(&mut record, transition, current);
    DECLARED.check.record(&record, true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn while_it_is_held_the_goal_is_told_with_the_configured_sign() {
        let told = |carried, holding, to_goal| goal_m(carried, holding, [0.1, -0.2, 0.3], to_goal);
        for (carried, held) in
            [(CarriedGoal::GoalToObject, [1.0, 0.2, -2.0]), (CarriedGoal::ObjectToGoal, [-1.0, -0.2, 2.0])]
        {
            assert_eq!(told(carried, true, [-1.0, -0.2, 2.0]), held);
            assert_eq!(told(carried, false, [-1.0, -0.2, 2.0]), [0.1, -0.2, 0.3]);
        }
        // The azimuth of (-1, -0) were -π.
        let bits = told(CarriedGoal::GoalToObject, true, [1.0, 0.0, 0.0]).map(f32::to_bits);
        assert_eq!(bits, [-1.0_f32, 0.0, 0.0].map(f32::to_bits));
    }

    #[test]
    fn what_the_structures_hold_is_where_the_task_declares_it() {
        let transition = Transition { disturbance_m: 0.5, target: 3, ..Transition::default() };
        let current = Current { goal_position_m: [1.0, 2.0, 3.0], ..Current::default() };
        let mut record = vec![0; DECLARED.layout.small_bytes];
        write(&mut record, &transition, &current);
        let spec = Spec::built_in().iter().find(|spec| spec.name == NAME).unwrap();
        let numbers = |name: &str| spec.channel(name).unwrap().1.numbers(&record).collect::<Vec<_>>();
        assert_eq!((numbers("disturbance_m"), numbers("target")), (vec![0.5], vec![3.0]));
        assert_eq!(numbers("goal_position_m"), [1.0, 2.0, 3.0]);
        assert_eq!(check(&transition, &current), Ok(()));
        let far = Current { goal_position_m: [1e6, 0.0, 0.0], ..Current::default() };
        assert!(check(&transition, &far).unwrap_err().to_string().contains("goal_position_m is 1000000"));
    }
}
