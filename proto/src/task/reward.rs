//! Rewards: a constant and an ordered list of weighted parts (paper equations 1 and 2).

use serde::{Deserialize, Serialize};

/// Name of the weight that PPO-Lagrangian sets while it trains.
pub const MULTIPLIER: &str = "multiplier";
/// The multiplier, negated: for a part that is a cost.
pub const NEGATIVE_MULTIPLIER: &str = "-multiplier";

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reward {
    /// A stage names it.
    pub name: String,
    /// The reward that this one adds to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base: Option<String>,
    /// Of every step.
    #[serde(default)]
    pub constant: f32,
    /// Added in this order, in 32 bits.
    #[serde(default)]
    pub terms: Vec<Term>,
}

/// A weighted part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(
    untagged,
    deny_unknown_fields,
    expecting = "expected a part with its weight, [\"picked_up\", 5.0], or { part = \"…\", at_most = -0.001, weight = -0.5 }"
)]
pub enum Term {
    Part(String, Weight),
    /// The weight alone, in every step whose part is at most, or at least, so much.
    Threshold {
        part: String,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        at_most: Option<f32>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        at_least: Option<f32>,
        weight: Weight,
    },
}

/// A number, or the name of one: of the task's weights, [`MULTIPLIER`] or [`NEGATIVE_MULTIPLIER`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number, or the name of a weight")]
pub enum Weight {
    Number(f32),
    Named(String),
}

/// A yes or no of each step, which the auxiliary task predicts: a part that is at most, or at least, so much.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Label {
    pub part: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_most: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_least: Option<f32>,
}

/// What PPO-Lagrangian holds down: a part times a weight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cost {
    pub part: String,
    pub weight: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition {
    /// Index of the part among the task's channels.
    pub(super) part: usize,
    pub(super) at_most: f32,
    pub(super) at_least: f32,
}

impl Condition {
    /// Whether it holds of a step. `part`: a part's number by the index of its channel.
    pub fn holds(&self, part: impl Fn(usize) -> f32) -> bool {
        (self.at_least..=self.at_most).contains(&part(self.part))
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Factor {
    Part(usize),
    Threshold(Condition),
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Scale {
    Number(f32),
    /// Times this, 1 or -1.
    Multiplier(f32),
}

/// A reward, resolved: it is composed of a step's parts without looking any name up.
#[derive(Debug, Clone, PartialEq)]
pub struct Composition {
    pub(super) constant: f32,
    pub(super) terms: Vec<(Factor, Scale)>,
}

impl Composition {
    /// The reward of a step. `part`: a part's number by the index of its channel. `multiplier` is PPO-Lagrangian's.
    pub fn of(&self, part: impl Fn(usize) -> f32, multiplier: f32) -> f32 {
        self.terms.iter().fold(self.constant, |sum, (factor, scale)| {
            let weight = match scale {
                Scale::Number(weight) => *weight,
                Scale::Multiplier(sign) => sign * multiplier,
            };
            sum + match factor {
                Factor::Part(index) => weight * part(*index),
                Factor::Threshold(condition) => {
                    if condition.holds(&part) {
                        weight
                    } else {
                        0.0
                    }
                }
            }
        })
    }

    /// Whether PPO-Lagrangian sets one of its weights.
    pub fn has_multiplier(&self) -> bool {
        self.terms.iter().any(|(_, scale)| matches!(scale, Scale::Multiplier(_)))
    }

    /// Whether a greater multiplier makes it pay what costs. `cost`: index of the part, and its weight.
    pub fn pays_cost(&self, (part, weight): (usize, f32)) -> bool {
        self.terms.iter().any(|(factor, scale)| {
            let (index, direction) = match factor {
                Factor::Part(index) => (*index, 1.0),
                // It holds for great numbers, or for small ones.
                Factor::Threshold(one) => (one.part, if one.at_most == f32::INFINITY { 1.0 } else { -1.0 }),
            };
            matches!(scale, Scale::Multiplier(sign) if index == part && sign * direction * weight > 0.0)
        })
    }
}
