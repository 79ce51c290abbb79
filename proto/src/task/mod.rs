//! A task, declared once, as data: what an environment reports at every step, the actions that it takes, the rewards and
//! metrics that are made of its reports.
//!
//! The record in shared memory and its check on arrival, the rewards that stages name, and the metrics of figures and
//! tables follow from this declaration. A task that is built in lies in a folder of its own, with its `task.toml`, beside
//! its environment in `actor/simulator/src/tasks/`.

mod actions;
mod channel;
mod check;
mod layout;
mod metric;
mod reward;
#[cfg(test)]
mod tests;

pub use actions::Actions;
pub use channel::{Channel, Dtype, Role};
pub use check::{Check, Implausible};
pub use layout::{Field, HEADER_BYTES, LINE_BYTES, Layout};
pub use metric::{Clause, Measure, Metric, Over};
pub use reward::{Composition, Condition, Cost, Label, MULTIPLIER, Reward, Term, Weight};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::sync::LazyLock;

/// What is wrong with a declaration.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    #[error("it is no task: {0}")]
    Toml(String),
    #[error("name `{0}`: a name has lower-case letters, digits and underscores, and begins with a letter")]
    Name(String),
    #[error("there are two of the name `{0}`")]
    Double(String),
    #[error("channel `{name}`: {problem}")]
    Channel { name: String, problem: &'static str },
    #[error("actions: {problem}")]
    Actions { problem: String },
    #[error("reward `{name}`: {problem}")]
    Reward { name: String, problem: String },
    #[error("metric `{name}`: {problem}")]
    Metric { name: String, problem: String },
    #[error("label: {0}")]
    Label(String),
    #[error("cost: {0}")]
    Cost(String),
    #[error("task `{task}` has no reward `{name}`, and neither has the configuration")]
    UnknownReward { name: String, task: String },
}

/// A task's declaration, as it is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Declaration {
    name: String,
    max_steps: u32,
    #[serde(default)]
    weights: BTreeMap<String, f32>,
    actions: Actions,
    channels: Vec<Channel>,
    #[serde(default)]
    rewards: Vec<Reward>,
    cost: Option<Cost>,
    label: Option<Label>,
    #[serde(default)]
    metrics: Vec<Metric>,
}

/// A task. It is sound: whatever it names is there.
#[derive(Debug, Clone, PartialEq)]
pub struct Spec {
    /// Lower-case, e.g. `arm_point_nav`.
    pub name: String,
    /// The most actions that an episode has, and a rebuild takes.
    pub max_steps: u32,
    pub actions: Actions,
    pub channels: Vec<Channel>,
    /// Rewards that stages can name, beside those of a configuration.
    pub rewards: Vec<Reward>,
    /// Weights that rewards name, and that a configuration can set.
    pub weights: BTreeMap<String, f32>,
    pub metrics: Vec<Metric>,
    cost: Option<Cost>,
    label: Option<Label>,
    layout: Layout,
    text: String,
}

/// Tasks that are built in.
static BUILT_IN: LazyLock<Vec<Spec>> = LazyLock::new(|| {
    let texts: &[&str] = include!(concat!(env!("OUT_DIR"), "/tasks.rs"));
    texts.iter().map(|text| Spec::parse(text).expect("a test reads every built-in task")).collect()
});

impl Spec {
    /// The tasks that are built in, by name.
    pub fn built_in() -> &'static [Self] {
        &BUILT_IN
    }

    /// Reads a declaration, and checks it.
    pub fn parse(text: &str) -> Result<Self, SpecError> {
        let declaration: Declaration = toml::from_str(text).map_err(|cause| SpecError::Toml(cause.to_string()))?;
        let Declaration { name, max_steps, weights, actions, channels, rewards, cost, label, metrics } = declaration;
        actions.check()?;
        channels.iter().try_for_each(Channel::check)?;
        let (layout, text) = (Layout::of(&actions, &channels), text.to_owned());
        let spec = Self { name, max_steps, actions, channels, rewards, weights, metrics, cost, label, layout, text };
        spec.check_names()?;
        for reward in &spec.rewards {
            spec.composition(&reward.name, &[], &BTreeMap::new())?;
        }
        for metric in &spec.metrics {
            spec.measure(metric)?;
        }
        if let Some(Label { part, at_most, at_least, .. }) = &spec.label {
            spec.threshold(part, *at_most, *at_least).map_err(SpecError::Label)?;
        }
        if let Some(Cost { part, weight }) = &spec.cost {
            spec.part(part).map_err(SpecError::Cost)?;
            if !weight.is_finite() {
                return Err(SpecError::Cost("its weight is not a finite number".to_owned()));
            }
        }
        Ok(spec)
    }

    fn check_names(&self) -> Result<(), SpecError> {
        let sound = |name: &str| {
            let letter = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_';
            name.len() <= 64 && name.starts_with(|first: char| first.is_ascii_lowercase()) && name.bytes().all(letter)
        };
        let groups: [Vec<&str>; 4] = [
            vec![&self.name],
            self.channels.iter().map(|channel| &*channel.name).collect(),
            self.rewards.iter().map(|reward| &*reward.name).collect(),
            self.metrics.iter().map(|metric| &*metric.name).collect(),
        ];
        for group in groups {
            let mut seen = BTreeSet::new();
            for name in group {
                if !sound(name) {
                    return Err(SpecError::Name(name.to_owned()));
                }
                if !seen.insert(name) {
                    return Err(SpecError::Double(name.to_owned()));
                }
            }
        }
        Ok(())
    }

    /// Where everything lies in a record.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The check of a record on arrival.
    pub fn check(&self) -> Check {
        Check::of(self)
    }

    /// A channel and its place.
    pub fn channel(&self, name: &str) -> Option<(&Channel, Field)> {
        let index = self.channels.iter().position(|channel| channel.name == name)?;
        Some((&self.channels[index], self.layout.fields[index]))
    }

    /// The declaration as it was written, for the run folder.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Whether two declarations say the same, but for their docs.
    pub fn means(&self, other: &Self) -> bool {
        let bare = |spec: &Self| {
            let mut spec = spec.clone();
            spec.text.clear();
            spec.channels.iter_mut().for_each(|channel| channel.doc.clear());
            spec.metrics.iter_mut().for_each(|metric| metric.doc.clear());
            spec
        };
        bare(self) == bare(other)
    }

    /// Hash of where everything lies in a record: processes of unlike layouts cannot talk.
    pub fn layout_hash(&self) -> u64 {
        let mut text = String::new();
        let (dtype, count) = self.actions.numbers();
        let _ = writeln!(text, "header {HEADER_BYTES}\naction {dtype:?} {count}");
        for (channel, field) in self.channels.iter().zip(&self.layout.fields) {
            let Channel { name, dtype, shape, sums, .. } = channel;
            let _ = writeln!(text, "{name} {dtype:?} {shape:?} {sums:?} {}", field.offset);
        }
        let digest = Sha256::digest(text);
        u64::from_le_bytes(digest[..8].try_into().expect("a digest has 32 bytes"))
    }
}
