//! In what a configuration differs from an older one of the same run.

use super::Config;
use toml::Value;

impl Config {
    /// What has changed since `older`, each as `ppo.clip = 0.2 instead of 0.1`; empty when nothing has.
    pub fn changes_since(&self, older: &Self) -> Vec<String> {
        let value =
            |config: &Self| Value::try_from(config).expect("plain numbers, strings and tables always serialise");
        let mut found = vec![];
        compare("", Some(&value(older)), Some(&value(self)), &mut found);
        found
    }
}

/// Adds what differs between two values at `path`.
fn compare(path: &str, then: Option<&Value>, now: Option<&Value>, found: &mut Vec<String>) {
    if then == now {
        return;
    }
    let (old, new) = (children(then), children(now));
    if then.is_some() && now.is_some() && !old.is_empty() && !new.is_empty() {
        let gone = old.iter().filter(|(key, _)| new.iter().all(|(other, _)| other != key));
        for (key, _) in new.iter().chain(gone) {
            let of = |children: &[(String, Value)]| {
                children.iter().find(|(other, _)| other == key).map(|(_, value)| value.clone())
            };
            let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
            compare(&path, of(&old).as_ref(), of(&new).as_ref(), found);
        }
        return;
    }
    let text = |value: Option<&Value>| value.map_or_else(|| "unset".to_owned(), Value::to_string);
    found.push(format!("{path} = {} instead of {}", text(now), text(then)));
}

/// What is in a table or a list, by key or number; of any other value nothing.
fn children(value: Option<&Value>) -> Vec<(String, Value)> {
    match value {
        Some(Value::Table(table)) => table.iter().map(|(key, value)| (key.clone(), value.clone())).collect(),
        Some(Value::Array(list)) => list.iter().enumerate().map(|(i, value)| (i.to_string(), value.clone())).collect(),
        _ => vec![],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_changed_key_is_named_with_both_values() {
        let older = Config::resolve("demo", None).unwrap();
        assert_eq!(older.changes_since(&older), Vec::<String>::new());
        let mut newer = older.clone();
        newer.seed = 9;
        newer.ppo.epochs += 1;
        newer.stages[1].frames = 77;
        newer.scenes = vec!["a.toml".into()];
        let epochs = older.ppo.epochs;
        let mut changes = newer.changes_since(&older);
        changes.sort();
        let expected = [
            format!("ppo.epochs = {} instead of {epochs}", epochs + 1),
            "scenes = [\"a.toml\"] instead of []".to_owned(),
            "seed = 9 instead of 1".to_owned(),
            format!("stages.1.frames = 77 instead of {}", older.stages[1].frames),
        ];
        assert_eq!(changes, expected);
        newer.stages.pop();
        assert!(newer.changes_since(&older).iter().any(|change| change.starts_with("stages.1 = unset instead of {")));
    }
}
