//! Names in rewards and metrics become indices of channels, once.

use super::channel::{Channel, Dtype, Role};
use super::error::SpecError;
use super::metric::{Bound, Clause, Kind, Limit, Measure, Metric, Over, Test};
use super::reward::{Composition, Condition, Factor, MULTIPLIER, NEGATIVE_MULTIPLIER, Reward, Scale, Term, Weight};
use super::spec::Spec;
use crate::likeness::among;
use std::collections::BTreeMap;

impl Spec {
    /// The reward of this name: the task's, or of `own`, a configuration's. `weights`: those that a configuration sets.
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
        let all = || own.iter().chain(&self.rewards);
        let unknown = || {
            let known = among(name, "rewards", all().map(|reward| &*reward.name));
            SpecError::UnknownReward { name: name.to_owned(), task: self.name.clone(), known }
        };
        let reward = all().find(|reward| reward.name == name).ok_or_else(unknown)?;
        let wrong = |problem: String| SpecError::Reward { name: name.to_owned(), problem };
        if depth > own.len() + self.rewards.len() {
            return Err(wrong("its base is itself".to_owned()));
        }
        if !reward.constant.is_finite() {
            return Err(wrong("its constant is not a finite number".to_owned()));
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
                Weight::Named(name) if name == MULTIPLIER => Scale::Multiplier(1.0),
                Weight::Named(name) if name == NEGATIVE_MULTIPLIER => Scale::Multiplier(-1.0),
                Weight::Named(name) => {
                    let default = || self.weights.get(name);
                    let weight = weights.get(name).or_else(default);
                    let own = weights.keys().filter(|own| !self.weights.contains_key(*own));
                    let known = self.weights.keys().chain(own).map(String::as_str);
                    let known = known.chain([MULTIPLIER, NEGATIVE_MULTIPLIER]);
                    let unknown = || format!("there is no weight `{name}`{}", among(name, "a number or one of", known));
                    Scale::Number(*weight.ok_or_else(|| wrong(unknown()))?)
                }
            };
            if matches!(scale, Scale::Number(weight) if !weight.is_finite()) {
                return Err(wrong("a weight is not a finite number".to_owned()));
            }
            composition.terms.push((factor, scale));
        }
        Ok(composition)
    }

    pub fn label(&self) -> Option<Condition> {
        let label = self.label.as_ref()?;
        Some(self.threshold(&label.part, label.at_most, label.at_least).expect("a task is checked when it is read"))
    }

    /// Index among the channels, and weight, of the part that is the task's cost.
    pub fn cost(&self) -> Option<(usize, f32)> {
        let cost = self.cost.as_ref()?;
        Some((self.part(&cost.part).expect("a task is checked when it is read"), cost.weight))
    }

    pub(super) fn part(&self, name: &str) -> Result<usize, String> {
        let is_part = |channel: &Channel| channel.role == Role::Part;
        let known = || {
            let parts = self.channels.iter().filter(|channel| is_part(channel)).map(|channel| &*channel.name);
            format!("there is no part `{name}`{}", among(name, "parts of this task", parts))
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

impl Spec {
    pub fn measures(&self) -> Vec<Measure> {
        self.metrics.iter().map(|metric| self.resolved(metric)).collect()
    }

    /// The metrics that are figures of rollouts, too, resolved.
    pub fn rollout_metrics(&self) -> impl Iterator<Item = (&Metric, Measure)> {
        self.metrics.iter().filter(|metric| metric.curve).map(|metric| (metric, self.resolved(metric)))
    }

    pub(super) fn resolved(&self, metric: &Metric) -> Measure {
        self.measure(metric).expect("a task is checked when it is read")
    }

    pub(super) fn measure(&self, metric: &Metric) -> Result<Measure, SpecError> {
        let wrong = |problem: String| SpecError::Metric { name: metric.name.clone(), problem };
        let scalar = |channel: &Channel| channel.is_of_action() && channel.shape.is_empty();
        let index = |name: &str| {
            let found = self.channels.iter().position(|channel| channel.name == name && scalar(channel));
            let known = self.channels.iter().filter(|channel| scalar(channel)).map(|channel| &*channel.name);
            let why = || format!("`{name}` is no scalar that an action leads to{}", among(name, "those are", known));
            found.ok_or_else(|| wrong(why()))
        };
        if metric.value.is_some() != metric.all_of.is_empty() {
            return Err(wrong("it is either the value of a channel or all of some clauses".to_owned()));
        }
        let value = metric.value.as_deref().map(index).transpose()?;
        if value.is_some() && matches!(metric.over, Over::Any | Over::First) {
            return Err(wrong("`any` and `first` are of clauses, not of a value".to_owned()));
        }
        if metric.curve && metric.over == Over::First {
            return Err(wrong("not every episode has a first step: curve = false".to_owned()));
        }
        let bound = |limit: &Limit| match limit {
            Limit::Number(number) if number.is_nan() => Err(wrong("a limit is a number".to_owned())),
            Limit::Number(number) => Ok(Bound::Number(f64::from(*number))),
            Limit::Channel(name) => index(name).map(Bound::Channel),
        };
        let test = |clause: &Clause| {
            let limits = clause.limits.iter().map(|(&comparison, limit)| Ok((comparison, bound(limit)?)));
            Ok(Test { channel: index(&clause.channel)?, limits: limits.collect::<Result<_, SpecError>>()? })
        };
        let clauses = metric.all_of.iter().map(test).collect::<Result<_, SpecError>>()?;
        let kind = match (metric.over, value.map(|index| self.channels[index].dtype)) {
            (Over::Last | Over::Any | Over::Max, None) => Kind::Share,
            (Over::Sum, Some(Dtype::F32)) | (_, Some(Dtype::F64)) => Kind::F64,
            (_, Some(Dtype::F32)) => Kind::F32,
            (Over::First | Over::Sum, None) | (_, Some(_)) => Kind::Count,
        };
        Ok(Measure { over: metric.over, kind, value, clauses })
    }
}
