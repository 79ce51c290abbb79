//! In what two configurations differ.

use super::Config;
use toml::{Table, Value};

/// A value that is not the same in two configurations.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference<'a> {
    /// Its key, as `ppo.clip`; in a list its number, as `stages.1.frames`.
    pub path: String,
    /// In the older one, or in the one compared with; none if it is unset there.
    pub then: Option<&'a Value>,
    /// In the newer one.
    pub now: Option<&'a Value>,
}

/// How lists are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lists {
    /// Each is one value.
    Whole,
    /// Element by element, if neither is empty.
    ByElement,
}

/// All differences between two configurations as plain data: at each level first the keys of `now`, then those that
/// only `then` has.
pub fn differences<'a>(then: &'a Value, now: &'a Value, lists: Lists) -> Vec<Difference<'a>> {
    let mut found = vec![];
    compare("", Some(then), Some(now), lists, &mut found);
    found
}

impl Config {
    /// As plain data. It goes by way of the text, so that a number of 32 bits keeps the digits that it was given.
    pub fn to_table(&self) -> Table {
        toml::from_str(&self.to_toml()).expect("what we write as TOML can be read")
    }

    /// What has changed since `older`, each as `ppo.clip = 0.2 instead of 0.1`; empty when nothing has.
    pub fn changes_since(&self, older: &Self) -> Vec<String> {
        let text = |value: Option<&Value>| value.map_or_else(|| "unset".to_owned(), Value::to_string);
        let (then, now) = (Value::Table(older.to_table()), Value::Table(self.to_table()));
        let found = differences(&then, &now, Lists::ByElement).into_iter();
        found
            .map(|Difference { path, then, now }| format!("{path} = {} instead of {}", text(now), text(then)))
            .collect()
    }
}

/// Adds what differs between two values at `path`.
fn compare<'a>(
    path: &str,
    then: Option<&'a Value>,
    now: Option<&'a Value>,
    lists: Lists,
    found: &mut Vec<Difference<'a>>,
) {
    if then == now {
        return;
    }
    let (old, new) = (children(then, lists), children(now, lists));
    if old.is_empty() || new.is_empty() {
        found.push(Difference { path: path.to_owned(), then, now });
        return;
    }
    let gone = old.iter().filter(|(key, _)| new.iter().all(|(other, _)| other != key));
    for (key, _) in new.iter().chain(gone) {
        let of =
            |children: &[(String, &'a Value)]| children.iter().find(|(other, _)| other == key).map(|(_, value)| *value);
        let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        compare(&path, of(&old), of(&new), lists, found);
    }
}

/// What is in a table or a list, by key or number; of any other value nothing.
fn children(value: Option<&Value>, lists: Lists) -> Vec<(String, &Value)> {
    match value {
        Some(Value::Table(table)) => table.iter().map(|(key, value)| (key.clone(), value)).collect(),
        Some(Value::Array(list)) if lists == Lists::ByElement => {
            list.iter().enumerate().map(|(number, value)| (number.to_string(), value)).collect()
        }
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
        newer.reward.weights.insert("lambda_disturb".to_owned(), 0.1);
        let epochs = older.ppo.epochs;
        let mut changes = newer.changes_since(&older);
        changes.sort();
        let expected = [
            format!("ppo.epochs = {} instead of {epochs}", epochs + 1),
            format!("reward.lambda_disturb = 0.1 instead of {:?}", older.reward.weights["lambda_disturb"]),
            "scenes = [\"a.toml\"] instead of []".to_owned(),
            "seed = 9 instead of 1".to_owned(),
            format!("stages.1.frames = 77 instead of {}", older.stages[1].frames),
        ];
        assert_eq!(changes, expected);
        newer.stages.pop();
        assert!(newer.changes_since(&older).iter().any(|change| change.starts_with("stages.1 = unset instead of {")));
        let values = [&older, &newer].map(|config| Value::Table(config.to_table()));
        let whole = differences(&values[0], &values[1], Lists::Whole);
        assert!(whole.iter().any(|difference| difference.path == "stages"), "a list as one value: {whole:?}");
    }
}
