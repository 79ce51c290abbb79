//! What data sets hold of every step beside pictures: one table from which all formats and their pages follow.

use crate::column::Values;
use crate::episode::{Episode, Seen, Step};
use proto::step::transition_flag;

/// A figure of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// Yes or no.
    Bool(bool),
    /// A number or a count.
    Int(i64),
    /// 64 bits.
    Hash(u64),
    /// A measure.
    Real(f32),
}

/// A column.
pub struct Field {
    /// Its name in tables and arrays, with the unit of measures.
    pub name: &'static str,
    /// Its name in `LeRobot`'s layout; none where that has no type for it.
    pub lerobot: Option<&'static str>,
    /// What it is.
    pub about: &'static str,
    /// Its value in a step: what was seen before, and what was done.
    pub of: fn(&Seen, &Step) -> Value,
}

/// Those of every step, in their order. Where nothing else is said they are of the moment after the action.
pub const FIELDS: [Field; 22] = [
    field(
        "previous_action",
        "observation.previous_action",
        "number of the action before, or how many actions there are",
        |seen, _| Value::Int(i64::from(seen.previous_action)),
    ),
    field("action", "action", "number of the action", |_, step| Value::Int(i64::from(step.action))),
    field("reward_r", "next.reward_r", "r, the reward of stage I", |_, step| Value::Real(step.rewards[0])),
    field("reward_r_prime", "next.reward", "r′, the reward of stage II", |_, step| Value::Real(step.rewards[1])),
    field(
        "wrist_object_progress_m",
        "next.wrist_object_progress_m",
        "part of r: how much nearer the wrist came to the target, metres",
        |_, step| Value::Real(step.transition.reward.wrist_object_progress_m),
    ),
    field(
        "object_goal_progress_m",
        "next.object_goal_progress_m",
        "part of r: how much nearer the target came to its goal, metres",
        |_, step| Value::Real(step.transition.reward.object_goal_progress_m),
    ),
    field(
        "disturbance_progress_m",
        "next.disturbance_progress_m",
        "part of r′: displacement before less that after, metres",
        |_, step| Value::Real(step.transition.reward.disturbance_progress_m),
    ),
    field("action_failed", "next.action_failed", "part of r: the action failed", |_, step| {
        flag(step, transition_flag::ACTION_FAILED)
    }),
    field("picked_up", "next.picked_up", "part of r: the target was picked up by this action", |_, step| {
        flag(step, transition_flag::PICKED_UP)
    }),
    field("success", "next.success", "part of r: Done was declared with the target at its goal", |_, step| {
        flag(step, transition_flag::SUCCESS)
    }),
    field("terminated", "next.terminated", "Done was declared", |_, step| flag(step, transition_flag::DONE)),
    field("truncated", "next.truncated", "this was the last action that there may be", |_, step| {
        flag(step, transition_flag::TIME_LIMIT)
    }),
    field("ended", "next.done", "the episode ended, by Done or by the limit", |_, step| {
        flag(step, transition_flag::ENDED)
    }),
    field("holding", "next.holding", "the target is held", |_, step| flag(step, transition_flag::HOLDING)),
    field("disturbance_m", "next.disturbance_m", "displacement of all objects but the target, metres", |_, step| {
        Value::Real(step.transition.disturbance_m)
    }),
    field("peak_disturbance_m", "next.peak_disturbance_m", "its largest value so far, metres", |_, step| {
        Value::Real(step.transition.peak_disturbance_m)
    }),
    field("farthest_m", "next.farthest_m", "displacement of the object that was moved farthest, metres", |_, step| {
        Value::Real(step.transition.farthest_m)
    }),
    field(
        "disturbed_objects",
        "next.disturbed_objects",
        "objects other than the target that are not at their places",
        |_, step| Value::Int(i64::from(step.transition.disturbed_objects)),
    ),
    field(
        "ever_disturbed_objects",
        "next.ever_disturbed_objects",
        "objects that were so after some step",
        |_, step| Value::Int(i64::from(step.transition.ever_disturbed_objects)),
    ),
    field("wrist_object_m", "next.wrist_object_m", "distance of wrist and target, metres", |_, step| {
        Value::Real(step.transition.wrist_object_m)
    }),
    field("object_goal_m", "next.object_goal_m", "distance of target and goal, metres", |_, step| {
        Value::Real(step.transition.object_goal_m)
    }),
    Field {
        name: "state_hash",
        lerobot: None,
        about: "hash of the state",
        of: |_, step| Value::Hash(step.transition.state_hash),
    },
];

const fn field(name: &'static str, lerobot: &'static str, about: &'static str, of: fn(&Seen, &Step) -> Value) -> Field {
    Field { name, lerobot: Some(lerobot), about, of }
}

fn flag(step: &Step, flag: u32) -> Value {
    Value::Bool(step.transition.flags & flag != 0)
}

impl Field {
    /// Its values in all steps of an episode.
    pub fn values(&self, episode: &Episode) -> Values {
        let all = || episode.seen.iter().zip(&episode.steps).map(|(seen, step)| (self.of)(seen, step));
        match all().next() {
            Some(Value::Bool(_)) => Values::Bool(all().map(|value| value == Value::Bool(true)).collect()),
            Some(Value::Hash(_)) => Values::Hash(all().map(Value::bits).collect()),
            Some(Value::Real(_)) => Values::Real(all().map(Value::real).collect()),
            Some(Value::Int(_)) | None => Values::Int(all().map(Value::bits).collect()),
        }
    }

    /// `NumPy`'s name of its type.
    pub fn kind(&self, episode: &Episode) -> &'static str {
        match self.values(episode) {
            Values::Bool(_) => "bool",
            Values::Hash(_) => "uint64",
            Values::Real(_) => "float32",
            _ => "int64",
        }
    }
}

impl Value {
    fn bits(self) -> i64 {
        match self {
            Self::Int(number) => number,
            Self::Hash(bits) => bits as i64,
            Self::Bool(_) | Self::Real(_) => unreachable!("a field keeps its type"),
        }
    }

    fn real(self) -> f32 {
        match self {
            Self::Real(number) => number,
            _ => unreachable!("a field keeps its type"),
        }
    }
}
