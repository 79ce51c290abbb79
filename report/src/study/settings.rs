use crate::format::{count, reward};
use proto::config::{self, Config, Difference, Lists, StageConfig};
use toml::{Table, Value};

/// Settings of a run's name, of where and how it computes, and of what it keeps; none changes what it learns.
const INCIDENTAL: [&str; 7] = ["preset", "seed", "learner", "checkpoint", "recording", "validation", "evaluation"];

/// What must be equal in all runs of a group. One experiment may go by the names of two presets.
pub(super) fn settings_of(config: &Config) -> Table {
    let mut table = config.to_table();
    for key in INCIDENTAL {
        table.remove(key);
    }
    // Each seed begins with weights of its own; how those were trained is what seeds have in common.
    if let Some(from) = table.get_mut("from").and_then(Value::as_table_mut) {
        from.retain(|key, _| key == "frames" || key == "stages");
    }
    table
}

pub(super) fn differences(config: &Config) -> Vec<String> {
    match Config::resolve(&config.preset, None) {
        Ok(preset) => differences_between(&preset, config),
        Err(_) => vec!["the preset is unknown to this version".into()],
    }
}

pub fn differences_between(first: &Config, second: &Config) -> Vec<String> {
    let [first, of_second] = [first, second].map(|config| Value::Table(settings_of(config)));
    let text = |Difference { path, now, .. }: Difference<'_>| match (path.as_str(), now, &second.environment) {
        // What only the kitchens' tasks have.
        (_, None, Some(_)) => None,
        (_, None, None) => Some(format!("{path} unset")),
        ("from", ..) => Some(from_text(second)),
        ("stages", ..) => Some(stages_text(second)),
        // Not its declaration, which is a page of text.
        ("environment", _, Some(environment)) => Some(format!("environment: {}", environment.command.join(" "))),
        (_, Some(value), _) => Some(format!("{path} = {value}")),
    };
    config::differences(&first, &of_second, Lists::Whole).into_iter().filter_map(text).collect()
}

fn from_text(config: &Config) -> String {
    let frames = config.from.as_ref().map_or(0, |from| from.frames);
    format!("begun with weights after {} frames", count(frames))
}

fn stages_text(config: &Config) -> String {
    let text = |stage: &StageConfig| format!("{} {}", reward(&stage.reward), count(stage.frames));
    format!("stages: {} frames", config.stages.iter().map(text).collect::<Vec<_>>().join(", then "))
}
