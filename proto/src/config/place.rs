//! Where a key stands in a text of TOML, and what its values can be.

use super::ConfigError;
use super::remedy::{unit_of, with_value};
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Value};

/// The line, from 1, of a dotted key; in a list of tables the first that has it.
pub(super) fn line_of(text: &str, key: &str) -> Option<usize> {
    let table = DeTable::parse(text).ok()?;
    let at = start_of(table.get_ref(), key)?;
    Some(text[..at].matches('\n').count() + 1)
}

fn start_of(table: &DeTable<'_>, key: &str) -> Option<usize> {
    let (first, rest) = key.split_once('.').map_or((key, None), |(first, rest)| (first, Some(rest)));
    let (name, value) = table.iter().find(|(name, _)| name.get_ref() == first)?;
    match (rest, value.get_ref()) {
        (None, _) => Some(name.span().start),
        (Some(rest), DeValue::Table(inner)) => start_of(inner, rest),
        (Some(rest), DeValue::Array(all)) => all.iter().find_map(|one| match one.get_ref() {
            DeValue::Table(inner) => start_of(inner, rest),
            _ => None,
        }),
        _ => None,
    }
}

/// The dotted key of the value that this byte is of.
pub(super) fn key_at(text: &str, at: usize) -> Option<String> {
    fn of(value: &Spanned<DeValue<'_>>, at: usize, path: &str) -> Option<String> {
        let inner = match value.get_ref() {
            DeValue::Table(inner) => inner.iter().find_map(|(name, value)| of(value, at, &below(path, name.get_ref()))),
            DeValue::Array(all) => all.iter().find_map(|one| of(one, at, path)),
            _ => None,
        };
        inner.or_else(|| value.span().contains(&at).then(|| path.to_owned()))
    }
    let table = DeTable::parse(text).ok()?;
    table.get_ref().iter().find_map(|(name, value)| of(value, at, name.get_ref()))
}

fn below(path: &str, name: &str) -> String {
    format!("{path}.{name}")
}

/// A problem with a number's type, with the numbers that its key can be, if they are known.
pub(super) fn with_range(key: &str, problem: String) -> String {
    let kinds = ["expected a whole number", "expected a number"];
    let Some(kind) = kinds.into_iter().find(|kind| problem.starts_with(kind)) else { return problem };
    let problem = match unit_of(key) {
        Some(unit) => problem.replacen(kind, &format!("{kind} of {unit}"), 1),
        None => problem,
    };
    match range_of(key) {
        Some(range) => {
            let plain = problem.replacen(" from 0 to 4294967295", "", 1).replacen(", 0 or greater", "", 1);
            format!("{plain} ({range})")
        }
        None => problem,
    }
}

/// What the check of a key's range says of numbers outside.
fn range_of(key: &str) -> Option<&'static str> {
    let extremes = [Value::Integer(0), u32::MAX.into(), Value::Float(-1.0), Value::Float(0.0), Value::Float(1e30)];
    extremes.into_iter().find_map(|extreme| match with_value(key, extreme).ok()?.validate() {
        Err(ConfigError::OutOfRange { key: found, problem, .. }) if found == key => Some(problem),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "seed = 1\nlearner.count = 2\n[ppo]\nclip = 0.1\nepochs = 100\n[[stages]]\nname = \"I\"\n\
                        [[stages]]\nframes = -5\n";

    #[test]
    fn a_key_has_a_line_and_a_value_a_key() {
        for (key, line) in
            [("seed", 1), ("learner.count", 2), ("ppo", 3), ("ppo.epochs", 5), ("stages", 6), ("stages.frames", 9)]
        {
            assert_eq!(line_of(TEXT, key), Some(line), "{key}");
        }
        for unknown in ["count", "ppo.count", "seed.count"] {
            assert_eq!(line_of(TEXT, unknown), None);
        }
        for (value, key) in [("2\n", "learner.count"), ("100", "ppo.epochs"), ("-5", "stages.frames")] {
            assert_eq!(key_at(TEXT, TEXT.find(value).unwrap()).as_deref(), Some(key));
        }
        assert_eq!((key_at("a = ", 4), line_of("a = ", "a")), (None, None), "no TOML");
    }

    #[test]
    fn a_number_of_the_wrong_type_is_told_its_range() {
        let told = |key| with_range(key, "expected a whole number from 0 to 4294967295, found a list".to_owned());
        assert_eq!(told("ppo.epochs"), "expected a whole number, found a list (must be 1 to 64)");
        assert!(told("ppo.environments_per_pass").contains("from 0 to 4294967295"), "any goes");
        assert_eq!(with_range("ppo.epochs", "expected a table".to_owned()), "expected a table");
    }
}
