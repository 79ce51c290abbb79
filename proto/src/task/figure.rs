//! Figures over episodes, made of the numbers of each.

use super::metric::Kind;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A figure over episodes beside the mean of each metric, as a task declares it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figure {
    pub name: String,
    /// Its name in printed tables; they leave out a figure without one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub label: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Of which number of an episode: a metric, `return_REWARD`, `length` or `terminated`.
    pub of: String,
    #[serde(default)]
    pub take: Take,
    /// The sum of the one divided by the sum of this other one, instead of the mean.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub per: Option<String>,
    /// Over the episodes in which all of these are 1; else over all.
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub among: Vec<String>,
    pub doc: String,
}

/// What of a number over episodes. Quartiles are the values at ranks (n − 1)/4, (n − 1)/2, 3(n − 1)/4, rounded down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Take {
    #[default]
    Mean,
    Max,
    LowerQuartile,
    Median,
    UpperQuartile,
}

/// The share of all episodes in which all of some numbers are 1 and another one is within a limit, for several limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Curve {
    pub name: String,
    /// What charts print.
    pub label: String,
    /// Limits at which the curve is a metric, by what charts print of them.
    #[serde(default)]
    pub marks: BTreeMap<String, f32>,
    /// The number that is limited.
    pub of: String,
    #[serde(default, rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub among: Vec<String>,
    /// It is below each of these,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub below: Vec<f32>,
    /// or at most each of these.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub at_most: Vec<f32>,
    pub doc: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Column {
    /// 1 where the task ended it, 0 where the limit of steps did.
    Terminated,
    /// Its actions.
    Length,
    /// Of the returns and metrics, by index ([`crate::task::Spec::columns`]).
    Number(usize),
}

/// A number of an episode, or over episodes, in words: for readers that do not know the task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Described {
    pub name: String,
    /// Empty where printed tables leave it out.
    pub label: String,
    pub unit: String,
    pub kind: Kind,
    pub doc: String,
    /// Of a quotient of two means: the metrics whose means are divided, the one by the other.
    #[serde(skip)]
    pub quotient: Option<[String; 2]>,
}

impl Described {
    pub(super) fn new(name: &str, label: &str, unit: &str, kind: Kind, doc: &str) -> Self {
        let [name, label, unit, doc] = [name, label, unit, doc].map(str::to_owned);
        Self { name, label, unit, kind, doc, quotient: None }
    }

    /// Its mean, from the means of metrics.
    pub fn mean(&self, means: &BTreeMap<String, f64>) -> Option<f64> {
        let known = |name: &String| means.get(name).copied();
        let quotient = || {
            let [of, per] = self.quotient.as_ref()?;
            Some(known(of)? / known(per)?).filter(|quotient| quotient.is_finite())
        };
        known(&self.name).or_else(quotient)
    }

    /// Whether it is 1 or 0 of an episode: over episodes it is a share of them.
    pub fn is_share(&self) -> bool {
        self.kind == Kind::Share
    }
}

impl Figure {
    /// As tables and screens of a run show it, if it follows from the means of two metrics.
    pub(super) fn shown(&self) -> Option<Described> {
        let quotient = self.per.as_ref().filter(|_| self.take == Take::Mean && self.among.is_empty());
        let label = if self.label.is_empty() { &self.name } else { &self.label };
        let described = Described::new(&self.name, label, &self.unit, Kind::F64, &self.doc);
        Some(Described { quotient: Some([self.of.clone(), quotient?.clone()]), ..described })
    }
}

impl Curve {
    /// Its limits, and whether the limit itself is within.
    pub fn limits(&self) -> (&[f32], bool) {
        if self.below.is_empty() { (&self.at_most, true) } else { (&self.below, false) }
    }
}
