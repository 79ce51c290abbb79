use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A metric, as a task declares it: a number of each episode, a column of tables. Its mean is a figure of the same name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metric {
    pub name: String,
    /// Its name in printed tables and on screens; they leave out a metric without one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub label: String,
    /// SI unit, or what it counts; empty: a pure number.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    pub over: Over,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<String>,
    /// Or 1 where all of these hold, else 0: its mean is a share of episodes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub all_of: Vec<Clause>,
    /// Whether its mean is also among the figures of a rollout, as `episode/NAME`.
    #[serde(default = "yes")]
    pub curve: bool,
    pub doc: String,
}

fn yes() -> bool {
    true
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Over {
    Last,
    /// Whether it is so at any of them.
    Any,
    /// The number of the first action after which it is so, from 1; none if it never is.
    First,
    /// Their sum; of clauses, how many steps.
    Sum,
    Max,
}

/// A channel's number is within limits, such as `{ channel = "pushed_m", below = 0.01 }`; without any, it is not 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Clause {
    pub channel: String,
    #[serde(flatten)]
    pub limits: BTreeMap<Comparison, Limit>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Comparison {
    Below,
    AtMost,
    AtLeast,
    Above,
}

/// A number, or the channel whose number it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number, or the name of a channel")]
pub enum Limit {
    Number(f32),
    Channel(String),
}

/// What a number is, for those who print or store it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Of an episode 0 or 1; over episodes a share.
    Share,
    Count,
    F32,
    F64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Measure {
    pub(super) over: Over,
    pub(super) kind: Kind,
    /// Index of a channel.
    pub(super) value: Option<usize>,
    pub(super) clauses: Vec<Test>,
}

/// A clause, resolved. Channels are indices.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Test {
    pub channel: usize,
    pub limits: Vec<(Comparison, Bound)>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Bound {
    Number(f64),
    Channel(usize),
}

impl Test {
    fn holds(&self, number: &impl Fn(usize) -> f64) -> bool {
        let value = number(self.channel);
        let within = |(comparison, bound): &(Comparison, Bound)| {
            let bound = match *bound {
                Bound::Number(bound) => bound,
                Bound::Channel(index) => number(index),
            };
            match comparison {
                Comparison::Below => value < bound,
                Comparison::AtMost => value <= bound,
                Comparison::AtLeast => value >= bound,
                Comparison::Above => value > bound,
            }
        };
        if self.limits.is_empty() { value != 0.0 } else { self.limits.iter().all(within) }
    }
}

impl Measure {
    /// What is known of the metric after a step, from what was before; 0 at an episode's start. `number`: the number of an
    /// outcome or part by the index of its channel.
    pub fn after(&self, number: impl Fn(usize) -> f64, before: f64) -> f64 {
        let now = match self.value {
            Some(index) => number(index),
            None => f64::from(u8::from(self.clauses.iter().all(|clause| clause.holds(&number)))),
        };
        match self.over {
            Over::Last => now,
            Over::Any | Over::Max => before.max(now),
            Over::Sum => before + now,
            // Below 0: so many steps until now, and none of them.
            Over::First if before > 0.0 => before,
            Over::First if now == 0.0 => before - 1.0,
            Over::First => 1.0 - before,
        }
    }

    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The metric of an episode that has ended, from what is known after its last step.
    pub fn of_episode(&self, known: f64) -> Option<f64> {
        (self.over != Over::First || known > 0.0).then_some(known)
    }
}
