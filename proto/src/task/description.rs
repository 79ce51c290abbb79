//! The declaration of a task whose environment describes itself by its spaces.

use super::actions::Actions;
use super::channel::{Channel, Dtype, Role};
use super::error::SpecError;
use super::restore::Restore;
use super::spec::Spec;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

/// The part of rewards that every such environment has.
pub const REWARD: &str = "reward";

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    pub name: String,
    pub actions: Actions,
    pub channels: Vec<Channel>,
    #[serde(default)]
    pub restore: Restore,
}

impl Description {
    /// The declaration as TOML. `more` is a declaration's text that adds to it: its channels, rewards and metrics join
    /// those of the same kind, or take the place of one of the same name; all else of it replaces what is there.
    pub fn declaration(&self, more: &str) -> Result<String, SpecError> {
        let toml = |cause: &dyn std::fmt::Display| SpecError::Toml(cause.to_string());
        let more: Table = toml::from_str(more).map_err(|cause| toml(&cause))?;
        let mut table = Table::try_from(self).map_err(|cause| toml(&cause))?;
        let common: Table = toml::from_str(COMMON).map_err(|cause| toml(&cause))?;
        // Policies are ranked by the user's first metric, then by the score.
        let first = more.get("metrics").and_then(|metrics| metrics.get(0)?.get("name")).cloned();
        table.extend(first.map(|name| ("headline".to_owned(), name)));
        for (key, value) in common.into_iter().chain(more) {
            match (table.get_mut(&key), value) {
                (Some(Value::Array(list)), Value::Array(added)) => added.into_iter().for_each(|one| join(list, one)),
                (_, value) => {
                    table.insert(key, value);
                }
            }
        }
        toml::to_string(&table).map_err(|cause| toml(&cause))
    }

    /// Refuses an environment that is not as the task is declared.
    pub fn check(&self, spec: &Spec) -> Result<(), SpecError> {
        let differs = |now: String, then: String| Err(SpecError::OtherSpaces { now, then });
        let observed = |channels: &[Channel]| -> Vec<(String, Dtype, Vec<usize>)> {
            let observations = channels.iter().filter(|channel| channel.role == Role::Observation);
            observations.map(|Channel { name, dtype, shape, .. }| (name.clone(), *dtype, shape.clone())).collect()
        };
        let (mut now, mut then) = (observed(&self.channels), observed(&spec.channels));
        now.sort_by(|a, b| a.0.cmp(&b.0));
        then.sort_by(|a, b| a.0.cmp(&b.0));
        if now != then {
            let text = |channels: Vec<(String, Dtype, Vec<usize>)>| {
                let one = |(name, dtype, shape)| format!("`{name}` {dtype} {shape:?}");
                channels.into_iter().map(one).collect::<Vec<_>>().join(", ")
            };
            return differs(format!("observations {}", text(now)), text(then));
        }
        let [now, then] = [&self.actions, &spec.actions].map(Actions::summary);
        if now != then {
            return differs(now, then);
        }
        // A declaration can do without snapshots that there are.
        match (self.restore, spec.restore) {
            (now, then @ Restore::Snapshot { .. }) if now != then => differs(format!("{now:?}"), format!("{then:?}")),
            _ => Ok(()),
        }
    }
}

/// Adds a table to a list of tables, in place of the one of its name. An observation stays where the environment has it.
fn join(list: &mut Vec<Value>, one: Value) {
    match list.iter_mut().find(|other| other.get("name").is_some() && other.get("name") == one.get("name")) {
        Some(same) => {
            let key = same.get("key").cloned();
            *same = one;
            if let (Some(key), Value::Table(table)) = (key, same) {
                table.entry("key").or_insert(key);
            }
        }
        None => list.push(one),
    }
}

/// What every such task has beside its spaces.
const COMMON: &str = r#"
[[channels]]
name = "reward"
role = "part"
dtype = "f32"
range = [-3.4028234663852886e38, 3.4028234663852886e38]
doc = "The environment's own reward."

[[rewards]]
name = "r"
terms = [["reward", 1.0]]

[[metrics]]
name = "score"
label = "score"
value = "reward"
over = "sum"
doc = "The sum of the environment's own rewards."
"#;

#[cfg(test)]
mod tests {
    use super::*;

    fn description() -> Description {
        serde_json::from_str(
            r#"{ "name": "cart_pole_v1", "actions": { "kind": "discrete", "names": ["a0", "a1"] }, "channels":
                [{ "name": "observation", "role": "observation", "dtype": "f32", "shape": [4], "range": [-9.0, 9.0],
                   "doc": "" }] }"#,
        )
        .unwrap()
    }

    #[test]
    fn spaces_and_what_the_user_adds_are_a_declaration() {
        let spec = Spec::parse(&description().declaration("").unwrap()).unwrap();
        assert_eq!((spec.name.as_str(), spec.actions.names().len(), spec.channels.len()), ("cart_pole_v1", 2, 2));
        let more = r#"
            channels = [
                { name = "reward", role = "part", dtype = "f32", range = [0.0, 1.0], doc = "Upright." },
                { name = "speed", role = "part", dtype = "f32", range = [0.0, 9.0], doc = "Of info." },
            ]
            rewards = [{ name = "slow", base = "r", terms = [["speed", -0.1]] }]
            cost = { part = "speed", weight = 1.0 }
            metrics = [
                { name = "fast", over = "last", all_of = [{ channel = "speed", at_least = 3.0 }], doc = "" },
            ]
        "#;
        let spec = Spec::parse(&description().declaration(more).unwrap()).unwrap();
        let names: Vec<&str> = spec.channels.iter().map(|channel| channel.name.as_str()).collect();
        assert_eq!(names, ["observation", "reward", "speed"]);
        assert_eq!(spec.channels[1].range, Some([0.0, 1.0]));
        assert!(spec.rewards.len() == 2 && spec.cost().is_some());
        let ranking: Vec<&str> = spec.ranking().iter().map(|metric| metric.name.as_str()).collect();
        assert_eq!(ranking, ["fast", "score"]);
        // A channel that the user declares anew stays where the environment has it.
        let mut keyed = description();
        keyed.channels[0].key = Some("state".to_owned());
        let narrow = "channels = [{ name = \"observation\", role = \"observation\", dtype = \"f32\", shape = [4], \
                      range = [-2.0, 2.0], doc = \"\" }]";
        let Channel { range, key, .. } = &Spec::parse(&keyed.declaration(narrow).unwrap()).unwrap().channels[0];
        assert_eq!((*range, key.as_deref()), (Some([-2.0, 2.0]), Some("state")));
        assert!(description().declaration("channels = 3").is_ok_and(|text| Spec::parse(&text).is_err()));
    }

    #[test]
    fn an_environment_with_other_spaces_is_refused() {
        let spec = Spec::parse(&description().declaration("").unwrap()).unwrap();
        description().check(&spec).unwrap();
        let mut other = description();
        other.channels[0].shape = vec![5];
        let problem = other.check(&spec).unwrap_err().to_string();
        assert!(
            problem.contains("`observation` float32 [5]") && problem.contains("`observation` float32 [4]"),
            "{problem}"
        );
        let Actions::Discrete { names, .. } = &mut other.actions else { panic!() };
        names.pop();
        other.channels[0].shape = vec![4];
        assert!(other.check(&spec).unwrap_err().to_string().contains("1 actions"));
    }
}
