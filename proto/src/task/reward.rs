//! Rewards: a constant and an ordered list of weighted parts (paper equations 1 and 2).

use super::{Channel, Role, Spec, SpecError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the weight that PPO-Lagrangian sets while it trains.
pub const MULTIPLIER: &str = "multiplier";

/// A reward, as a task or a configuration declares it.
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

/// A number, or the name of one: of the task's weights, or [`MULTIPLIER`].
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
    pub name: String,
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

/// A threshold, resolved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition {
    /// Index of the part among the task's channels.
    part: usize,
    at_most: f32,
    at_least: f32,
}

impl Condition {
    /// Whether it holds of a step. `part`: a part's number by the index of its channel.
    pub fn holds(&self, part: impl Fn(usize) -> f32) -> bool {
        (self.at_least..=self.at_most).contains(&part(self.part))
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Factor {
    Part(usize),
    Threshold(Condition),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Scale {
    Number(f32),
    Multiplier,
}

/// A reward, resolved: it is composed of a step's parts without looking any name up.
#[derive(Debug, Clone, PartialEq)]
pub struct Composition {
    constant: f32,
    terms: Vec<(Factor, Scale)>,
}

impl Composition {
    /// The reward of a step. `part`: a part's number by the index of its channel. `multiplier` is PPO-Lagrangian's.
    pub fn of(&self, part: impl Fn(usize) -> f32, multiplier: f32) -> f32 {
        self.terms.iter().fold(self.constant, |sum, (factor, scale)| {
            let weight = match scale {
                Scale::Number(weight) => *weight,
                Scale::Multiplier => multiplier,
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
        self.terms.iter().any(|(_, scale)| *scale == Scale::Multiplier)
    }
}

impl Spec {
    /// The reward of this name: of `own`, a configuration's, before the task's. `weights`: those that a configuration sets.
    pub fn composition(
        &self,
        name: &str,
        own: &[Reward],
        weights: &BTreeMap<String, f32>,
    ) -> Result<Composition, SpecError> {
        self.compose(name, own, weights, 0)
    }

    fn compose(
        &self,
        name: &str,
        own: &[Reward],
        weights: &BTreeMap<String, f32>,
        depth: usize,
    ) -> Result<Composition, SpecError> {
        let unknown = || SpecError::UnknownReward { name: name.to_owned(), task: self.name.clone() };
        let mut found = own.iter().chain(&self.rewards).filter(|reward| reward.name == name);
        let reward = found.next().ok_or_else(unknown)?;
        let wrong = |problem: String| SpecError::Reward { name: name.to_owned(), problem };
        if depth > own.len() + self.rewards.len() {
            return Err(wrong("its base is itself".to_owned()));
        }
        let mut composition = match &reward.base {
            None => Composition { constant: reward.constant, terms: vec![] },
            Some(base) => {
                let mut base = self.compose(base, own, weights, depth + 1)?;
                base.constant += reward.constant;
                base
            }
        };
        for term in &reward.terms {
            let (factor, weight) = match term {
                Term::Part(part, weight) => (Factor::Part(self.part(part).map_err(wrong)?), weight),
                Term::Threshold { part, at_most, at_least, weight } => {
                    (Factor::Threshold(self.threshold(part, *at_most, *at_least).map_err(wrong)?), weight)
                }
            };
            let scale = match weight {
                Weight::Number(weight) => Scale::Number(*weight),
                Weight::Named(name) if name == MULTIPLIER => Scale::Multiplier,
                Weight::Named(name) => {
                    let default = || self.weights.get(name);
                    let weight = weights.get(name).or_else(default);
                    Scale::Number(*weight.ok_or_else(|| wrong(format!("there is no weight `{name}`")))?)
                }
            };
            if matches!(scale, Scale::Number(weight) if !weight.is_finite()) {
                return Err(wrong("a weight is not a finite number".to_owned()));
            }
            composition.terms.push((factor, scale));
        }
        Ok(composition)
    }

    /// The task's label, resolved.
    pub fn label(&self) -> Option<Condition> {
        let label = self.label.as_ref()?;
        Some(self.threshold(&label.part, label.at_most, label.at_least).expect("a task is checked when it is read"))
    }

    /// Index among the channels, and weight, of the part that is the task's cost.
    pub fn cost(&self) -> Option<(usize, f32)> {
        let cost = self.cost.as_ref()?;
        Some((self.part(&cost.part).expect("a task is checked when it is read"), cost.weight))
    }

    /// Index of a part of rewards among the channels.
    pub(super) fn part(&self, name: &str) -> Result<usize, String> {
        let is_part = |channel: &Channel| channel.role == Role::Part;
        let known = || {
            let parts = self.channels.iter().filter(|channel| is_part(channel));
            let names: Vec<_> = parts.map(|channel| channel.name.as_str()).collect();
            format!("there is no part `{name}`; this task has {}", names.join(", "))
        };
        self.channels.iter().position(|channel| channel.name == name && is_part(channel)).ok_or_else(known)
    }

    pub(super) fn threshold(
        &self,
        part: &str,
        at_most: Option<f32>,
        at_least: Option<f32>,
    ) -> Result<Condition, String> {
        let index = self.part(part)?;
        if at_most.is_some() == at_least.is_some() || [at_most, at_least].into_iter().flatten().any(f32::is_nan) {
            return Err(format!("the threshold of `{part}` is a number, either at_most or at_least"));
        }
        let (at_most, at_least) = (at_most.unwrap_or(f32::INFINITY), at_least.unwrap_or(f32::NEG_INFINITY));
        Ok(Condition { part: index, at_most, at_least })
    }
}
