//! Metrics of an episode, made of what its actions did.

use serde::{Deserialize, Serialize};

/// A metric, as a task declares it: a number of each episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metric {
    /// In files: `episode/NAME` among a run's figures, a column of tables.
    pub name: String,
    /// What tables and screens print; else the name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// SI unit of a value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Over which of an episode's steps.
    pub over: Over,
    /// The channel whose number it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<String>,
    /// Or 1 where all of these hold, else 0: its mean is a share of episodes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub all_of: Vec<Clause>,
    pub doc: String,
}

/// A metric as tables and screens show its mean.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ShownMetric {
    pub name: String,
    pub label: String,
    pub unit: Option<String>,
    /// Whether it is a share of episodes.
    pub share: bool,
}

impl Metric {
    /// As tables and screens show it.
    pub fn shown(&self) -> ShownMetric {
        let (name, unit) = (self.name.clone(), self.unit.clone());
        let label = self.label.clone().unwrap_or_else(|| name.clone());
        ShownMetric { name, label, unit, share: self.value.is_none() && self.over != Over::Sum }
    }
}

/// Over which steps of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Over {
    /// The last one.
    Last,
    /// Whether it is so at any of them.
    Any,
    /// Their sum.
    Sum,
    /// The greatest.
    Max,
}

/// A channel's number is within bounds; without any, it is not 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clause {
    pub channel: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub below: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_least: Option<f32>,
}

/// A metric, resolved.
#[derive(Debug, Clone, PartialEq)]
pub struct Measure {
    pub(super) over: Over,
    /// Index of a channel.
    pub(super) value: Option<usize>,
    /// Index of a channel, at least, below; a channel alone: not 0.
    pub(super) clauses: Vec<(usize, Option<f32>, Option<f32>)>,
}

impl Measure {
    /// The metric after a step, from what it was before; 0 at an episode's start. `number`: the number of an outcome or part
    /// by the index of its channel.
    pub fn after(&self, number: impl Fn(usize) -> f64, before: f64) -> f64 {
        let now = match self.value {
            Some(index) => number(index),
            None => f64::from(u8::from(self.clauses.iter().all(|&(index, at_least, below)| {
                let number = number(index);
                match (at_least, below) {
                    (None, None) => number != 0.0,
                    _ => {
                        at_least.is_none_or(|least| number >= f64::from(least))
                            && below.is_none_or(|limit| number < f64::from(limit))
                    }
                }
            }))),
        };
        match self.over {
            Over::Last => now,
            Over::Any | Over::Max => before.max(now),
            Over::Sum => before + now,
        }
    }
}
