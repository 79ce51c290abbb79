//! What a preset is: a named overlay over the defaults.

use std::borrow::Cow;

/// One preset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Preset {
    /// Its name on the command line.
    pub name: String,
    /// What it is, one line.
    pub summary: String,
    /// What it lays over the defaults, or over the preset that it `extends`: TOML.
    pub(super) text: Cow<'static, str>,
}

/// Key of a preset's file, not of a configuration: lengths of a rollout that its method leaves open.
pub(super) const OPEN_STEPS: &str = "open_rollout_steps";

impl Preset {
    /// Lengths of a rollout that `orchestrator tune` may choose from; empty where the length is part of what the preset
    /// is, as in those with the paper's shape.
    pub fn open_rollout_steps(&self) -> Vec<u32> {
        let table: toml::Table = self.text.parse().unwrap_or_default();
        let steps = table.get(OPEN_STEPS).and_then(|steps| steps.as_array()).cloned().unwrap_or_default();
        steps.iter().filter_map(|steps| u32::try_from(steps.as_integer()?).ok()).collect()
    }
}

/// Lays `top` over `bottom`: tables merge, everything else (arrays too) replaces.
pub fn overlay(bottom: &mut toml::Table, top: toml::Table) {
    for (key, value) in top {
        match (bottom.get_mut(&key), value) {
            (Some(toml::Value::Table(below)), toml::Value::Table(above)) => overlay(below, above),
            (_, value) => {
                bottom.insert(key, value);
            }
        }
    }
}
