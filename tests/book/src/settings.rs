//! The page of all settings, from the types of the configuration: names, documentation and types from the sources,
//! defaults and ranges from the configuration itself. A range is what the configuration answers when it is given values
//! out of it.

use crate::types::Field;
use crate::{BookError, Types};
use proto::config::{Config, ConfigError, Setting};
use proto::task::ActionSpace;
use std::fmt::Write;
use toml::{Table, Value};

const HEAD: &str = "\
# All settings

These keys are changed most; the others can stay as the preset has them:

| key | determines |
|---|---|
| [`seed`](#at-the-top) | all that is random |
| [`stages`](#stages) | each stage's reward and frames; `--frames` scales them |
| [`reward.lambda_disturb`](#reward) | how much a displacement costs in r′ |
| [`actors.count`, `actors.environments_per_actor`](#actors) | processes, and environments in each |
| [`learner.count`](#learner) | how many GPUs train |
| [`ppo.rollout_steps`, `ppo.minibatches`](#ppo) | the batch: actors × environments × rollout steps / minibatches |
| [`ppo.learning_rate`](#ppo) | size of an optimiser's step |
| [`network.memory`](#network) | GRU or LSTM; `none` turns it off |
| [`kitchens.source`](#kitchens) | nineteen kitchens, or procedural ones |
| [`learner.actor_deadline_s`](#learner) | how long a step of a simulator may take before its actor is restarted |
| [`recording.enabled`](#recording) | whether steps are recorded: `false` is faster, and leaves nothing to replay |
| [`recording.depth_share`](#recording) | disk space |
| [`validation.every_frames`](#validation) | how often checkpoints are evaluated |

A key is given in a file as in `[ppo]`, `clip = 0.2`, or on the command line as `--set ppo.clip=0.2`. A line has the
key, its default in preset `paper` (`stillroom config PRESET` prints another's) and, in parentheses, the allowed
values. The end of a name is its unit: `_s` seconds, `_m` metres, `_steps`, `_frames`, `_bytes`. `stillroom up --env`,
`up --from` and `eval` write `[environment]`, `[from]` and `[evaluation]`.

Not settings: the robot's and the camera's dimensions, such as the camera's height of 1.58 m (`docs/method.md`).

This page is made from the sources: `cargo test --release --workspace --test pages` compares it.

";

/// Tables that programs write.
const WRITTEN: [&str; 3] = ["environment", "from", "evaluation"];

/// The page. `types` has those of the configuration.
pub fn settings_page(types: &Types) -> Result<String, BookError> {
    let default: Table = Config::default().to_toml().parse().unwrap_or_default();
    let mut page = HEAD.to_owned();
    let mut pending = vec![(String::new(), "Config".to_owned())];
    while let Some((path, name)) = pending.pop() {
        let heading = if path.is_empty() { "At the top".to_owned() } else { format!("`[{path}]`") };
        let heading = if path == "stages" { "`[[stages]]`".to_owned() } else { heading };
        let _ = write!(page, "## {heading}\n\n{}\n\n", sentence(&types.doc_of(&name)?));
        let mut rows = String::new();
        let mut inner = vec![];
        for field in types.fields(&name)? {
            if field.kind == "BTreeMap<String,f32>" {
                for weight in Config::default().reward.weights.into_keys() {
                    let field = Field { name: weight.clone(), kind: "f32".to_owned(), doc: field.doc.clone() };
                    rows += &row(types, &default, &format!("{path}.{weight}"), &field);
                }
                continue;
            }
            let key = if path.is_empty() { field.name.clone() } else { format!("{path}.{}", field.name) };
            if WRITTEN.contains(&key.as_str()) {
                continue;
            }
            if types.is_struct(within(&field.kind)) && within(&field.kind) != "Reward" {
                inner.push((key, within(&field.kind).to_owned()));
            } else {
                rows += &row(types, &default, &key, &field);
            }
        }
        if !rows.is_empty() {
            page += &rows;
            page.push('\n');
        }
        pending.extend(inner.into_iter().rev());
    }
    page.truncate(page.trim_end().len());
    page.push('\n');
    Ok(page)
}

/// What is inside of an `Option` or a `Vec`.
fn within(kind: &str) -> &str {
    let inner = ["Option<", "Vec<"].iter().find_map(|outer| kind.strip_prefix(outer)?.strip_suffix('>'));
    inner.map_or(kind, within)
}

fn row(types: &Types, default: &Table, key: &str, field: &Field) -> String {
    let variants = types.variants(within(&field.kind)).filter(|_| !field.kind.starts_with("Vec<Vec"));
    let mut what = sentence(&field.doc);
    let allowed = if let Some(variants) = &variants {
        for (name, doc) in variants.iter().filter(|(_, doc)| !doc.is_empty()) {
            let _ = write!(what, " `{name}`: {}", sentence(doc));
        }
        let bare = variants.iter().filter(|(_, doc)| doc.is_empty()).map(|(name, _)| format!("`{name}`"));
        bare.collect::<Vec<_>>().join(", ")
    } else {
        for meaning in types.meanings(within(&field.kind)) {
            let _ = write!(what, " {}", sentence(&meaning));
        }
        allowed(key, within(&field.kind), &field.kind)
    };
    let name = key.rsplit('.').next().unwrap_or_default();
    let default = shown(default, key, &field.kind);
    let default = if default.is_empty() { default } else { format!(" = {default}") };
    let allowed = if allowed.is_empty() { allowed } else { format!(" ({allowed})") };
    format!("* `{name}`{default}{allowed}: {what}\n")
}

/// A text that ends in a full stop.
fn sentence(text: &str) -> String {
    let text = text.trim();
    if text.is_empty() || text.ends_with(['.', ':']) { text.to_owned() } else { format!("{text}.") }
}

/// The default as TOML.
fn shown(default: &Table, key: &str, kind: &str) -> String {
    let mut value = Some(&Value::Table(default.clone())).cloned();
    for name in key.split('.') {
        value = match value {
            Some(Value::Table(table)) => table.get(name).cloned(),
            Some(Value::Array(list)) => {
                let each = list.iter().filter_map(|item| item.get(name).cloned());
                return each.map(|value| format!("`{value}`")).collect::<Vec<_>>().join(", then ");
            }
            _ => None,
        };
    }
    match value {
        None => String::new(),
        // The digits that the type has, and no more.
        Some(Value::Float(number)) if kind == "f32" => format!("`{:?}`", number as f32),
        Some(value) => format!("`{value}`"),
    }
}

/// What the configuration answers to values that are out of range.
fn allowed(key: &str, kind: &str, whole_kind: &str) -> String {
    let mut answers: Vec<String> = vec![];
    for value in attempts(kind, whole_kind) {
        let (key_set, value) = match key.strip_prefix("stages.") {
            None => (key, value),
            Some(name) => {
                let mut stage: Table = "name = \"I\"\nreward = \"r\"\nframes = 10".parse().unwrap_or_default();
                stage.insert(name.to_owned(), value);
                ("stages", Value::Array(vec![Value::Table(stage)]))
            }
        };
        let Ok(setting) = Setting::new(key_set, value) else { continue };
        let Err(ConfigError::OutOfRange { key: named, problem, .. }) = Config::resolve_set("paper", None, &[setting])
        else {
            continue;
        };
        // A reason follows the values.
        let values = problem.split(": ").next().unwrap_or(problem);
        let answer = values.strip_prefix("must be ").unwrap_or(values).to_owned();
        if named == key && !answers.contains(&answer) {
            answers.push(answer);
        }
    }
    if !answers.is_empty() {
        return answers.join("; ");
    }
    if kind == "ActionSpace" {
        return ActionSpace::all().map(|space| format!("`{space}`")).collect::<Vec<_>>().join(", ");
    }
    String::new()
}

/// Values that are out of most ranges.
fn attempts(kind: &str, whole_kind: &str) -> Vec<Value> {
    let numbers = |list: &[i64]| list.iter().copied().map(Value::Integer).collect::<Vec<_>>();
    match kind {
        "u32" if whole_kind.starts_with("Vec") => vec![Value::Array(vec![])],
        "u32" | "u64" => numbers(&[0, 1, 3, 7, 600, 5000, 100_000, 2_000_000, i64::from(u32::MAX), 1 << 60, i64::MAX]),
        "f32" | "f64" => [-1.0, 0.0, 0.3, 1.5, 1e9, f64::NAN, f64::INFINITY].map(Value::Float).to_vec(),
        "bool" => vec![Value::Boolean(false), Value::Boolean(true)],
        "String" if whole_kind.starts_with("Vec") => vec![Value::Array(vec![Value::String("a".into()); 200])],
        _ => vec![],
    }
}
