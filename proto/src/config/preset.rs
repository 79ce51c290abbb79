//! What a preset is: a named overlay over the defaults.

use std::borrow::Cow;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Preset {
    pub name: String,
    /// What it is, one line.
    pub summary: String,
    /// What it lays over the defaults, or over the preset that it `extends`: TOML.
    pub(super) text: Cow<'static, str>,
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
