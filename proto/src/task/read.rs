//! Reading declarations: those that are built in, and any text.

use super::actions::Actions;
use super::channel::Channel;
use super::error::SpecError;
use super::layout::Layout;
use super::metric::Metric;
use super::reward::{Cost, Label, Reward};
use super::spec::Spec;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

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
}
