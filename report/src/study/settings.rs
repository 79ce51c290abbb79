//! In what two configurations differ.

use crate::format::count;
use proto::config::{Config, StageConfig};
use proto::reward::RewardKind;
use toml::{Table, Value};

/// Settings that say what a run is called, where and how it computes and what it keeps, not what it learns.
const INCIDENTAL: [&str; 7] = ["preset", "seed", "learner", "checkpoint", "recording", "validation", "evaluation"];

/// What must be equal in all runs of a group. One experiment may go by the names of two presets.
pub(super) fn settings_of(config: &Config) -> Table {
    let mut table = table_of(config);
    for key in INCIDENTAL {
        table.remove(key);
    }
    // Each seed begins with weights of its own; how long those were trained is what seeds have in common.
    if let Some(from) = table.get_mut("from").and_then(Value::as_table_mut) {
        from.retain(|key, _| key == "frames");
    }
    table
}

fn table_of(config: &Config) -> Table {
    Table::try_from(config).expect("a configuration is plain numbers, strings and tables")
}

/// Settings that the configuration's preset does not have, as `key = value`.
pub(super) fn differences(config: &Config) -> Vec<String> {
    match Config::resolve(&config.preset, None) {
        Ok(preset) => differences_between(&preset, config),
        Err(_) => vec!["the preset is unknown to this version".into()],
    }
}

/// The settings of the second configuration that change what is learned against the first, as `key = value`.
pub fn differences_between(first: &Config, second: &Config) -> Vec<String> {
    let mut found = Vec::new();
    compare("", &settings_of(first), &settings_of(second), second, &mut found);
    found
}

/// Adds what differs between two tables at `path` of a configuration. `config` is the configuration of `run`.
fn compare(path: &str, preset: &Table, run: &Table, config: &Config, found: &mut Vec<String>) {
    for (key, value) in run {
        let key_path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match (preset.get(key), value) {
            (Some(before), value) if before == value => {}
            (Some(Value::Table(before)), Value::Table(value)) => compare(&key_path, before, value, config, found),
            _ if key_path == "from" => found.push(from_text(config)),
            _ if key_path == "stages" => found.push(stages_text(config)),
            (_, value) => found.push(format!("{key_path} = {value}")),
        }
    }
    for key in preset.keys().filter(|key| !run.contains_key(*key)) {
        found.push(format!("{path}{}{key} unset", if path.is_empty() { "" } else { "." }));
    }
}

/// `begun with weights after 9 000 frames`
fn from_text(config: &Config) -> String {
    let frames = config.from.as_ref().map_or(0, |from| from.frames);
    format!("begun with weights after {} frames", count(frames))
}

/// `stages: r 5 000 000, then r_prime 5 000 000 frames`
fn stages_text(config: &Config) -> String {
    let text = |stage: &StageConfig| {
        let reward = match stage.reward {
            RewardKind::Task => "r",
            RewardKind::DisturbanceFree => "r_prime",
            RewardKind::Lagrangian => "lagrangian",
        };
        format!("{reward} {}", count(stage.frames))
    };
    format!("stages: {} frames", config.stages.iter().map(text).collect::<Vec<_>>().join(", then "))
}
