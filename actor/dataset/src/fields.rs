//! What data sets hold of every step beside pictures and observations: one table from which arrays and page follow.

use crate::episode::Step;
use proto::record::End;

/// A figure of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// Yes or no.
    Bool(bool),
    /// A number or a count.
    Int(i64),
    /// A measure.
    Real(f32),
}

/// A column.
pub struct Field {
    /// Its name in tables and arrays, with the unit of measures.
    pub name: &'static str,
    pub about: &'static str,
    pub of: fn(&Step) -> Value,
}

/// Those of every step, in their order. Where nothing else is said they are of the moment after the action.
pub const FIELDS: [Field; 20] = [
    field("action", "number of the action", |step| Value::Int(i64::from(step.action))),
    field("reward_r", "r, the reward of stage I", |step| Value::Real(step.rewards[0])),
    field("reward_r_prime", "r′, the reward of stage II", |step| Value::Real(step.rewards[1])),
    field("wrist_object_progress_m", "part of r: how much nearer the wrist came to the target, metres", |step| {
        Value::Real(step.transition.reward.wrist_object_progress_m)
    }),
    field("object_goal_progress_m", "part of r: how much nearer the target came to its goal, metres", |step| {
        Value::Real(step.transition.reward.object_goal_progress_m)
    }),
    field("disturbance_progress_m", "part of r′: displacement before less that after, metres", |step| {
        Value::Real(step.transition.reward.disturbance_progress_m)
    }),
    field("action_failed", "part of r: the action failed", |step| Value::Bool(step.transition.failed())),
    field("picked_up", "part of r: the target was picked up by this action", |step| {
        Value::Bool(step.transition.picked_up())
    }),
    field("success", "part of r: Done was declared with the target at its goal", |step| {
        Value::Bool(step.transition.succeeded())
    }),
    field("terminated", "Done was declared", |step| Value::Bool(step.end == Some(End::Terminated))),
    field("truncated", "this was the last action that there may be", |step| {
        Value::Bool(step.end == Some(End::Truncated))
    }),
    field("ended", "the episode ended, by Done or by the limit", |step| Value::Bool(step.end.is_some())),
    field("holding", "the target is held", |step| Value::Bool(step.transition.holds())),
    field("disturbance_m", "displacement of all objects but the target, metres", |step| {
        Value::Real(step.transition.disturbance_m)
    }),
    field("peak_disturbance_m", "its largest value so far, metres", |step| {
        Value::Real(step.transition.peak_disturbance_m)
    }),
    field("farthest_m", "displacement of the object that was moved farthest, metres", |step| {
        Value::Real(step.transition.farthest_m)
    }),
    field("disturbed_objects", "objects other than the target that are not at their places", |step| {
        Value::Int(i64::from(step.transition.disturbed_objects))
    }),
    field("ever_disturbed_objects", "objects that were so after some step", |step| {
        Value::Int(i64::from(step.transition.ever_disturbed_objects))
    }),
    field("wrist_object_m", "distance of wrist and target, metres", |step| Value::Real(step.transition.wrist_object_m)),
    field("object_goal_m", "distance of target and goal, metres", |step| Value::Real(step.transition.object_goal_m)),
];

const fn field(name: &'static str, about: &'static str, of: fn(&Step) -> Value) -> Field {
    Field { name, about, of }
}
