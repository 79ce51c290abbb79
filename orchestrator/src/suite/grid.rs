use anyhow::{Context, Result, bail, ensure};
use proto::config::Setting;
use toml::{Table, Value};

#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// What it adds to the run's name: `-learning_rate=0.001-clip=0.2`; nothing without a grid.
    pub suffix: String,
    pub settings: Vec<Setting>,
}

struct Axis {
    key: String,
    values: Vec<(String, Setting)>,
}

/// All combinations, the last key's values changing first; one, of nothing, of an empty grid. At most `most`.
pub fn points(grid: &Table, most: usize) -> Result<Vec<Point>> {
    let mut axes = Vec::new();
    collect("", grid, &mut axes)?;
    let count = axes.iter().try_fold(1usize, |count, axis| count.checked_mul(axis.values.len()));
    ensure!(count.is_some_and(|count| count <= most), "grid: more than {most} combinations");
    let mut points = vec![Point { suffix: String::new(), settings: Vec::new() }];
    for (index, axis) in axes.iter().enumerate() {
        let others = axes.iter().enumerate().filter(|(other, _)| *other != index);
        let unique = others.clone().all(|(_, other)| last(&other.key) != last(&axis.key));
        let name = if unique { last(&axis.key) } else { &axis.key };
        let with = |point: &Point, (text, setting): &(String, Setting)| {
            let mut settings = point.settings.clone();
            settings.push(setting.clone());
            Point { suffix: format!("{}-{name}={text}", point.suffix), settings }
        };
        points = points.iter().flat_map(|point| axis.values.iter().map(|value| with(point, value))).collect();
    }
    Ok(points)
}

fn last(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

/// Reads the axes of a table: keys are dotted in quotes, or without, which TOML makes tables of.
fn collect(above: &str, table: &Table, axes: &mut Vec<Axis>) -> Result<()> {
    for (name, value) in table {
        let key = if above.is_empty() { name.clone() } else { format!("{above}.{name}") };
        match value {
            Value::Table(inner) => collect(&key, inner, axes)?,
            Value::Array(values) => {
                let values = values_of(&key, values).with_context(|| format!("grid.{key}"))?;
                ensure!(axes.iter().all(|axis| axis.key != key), "grid.{key}: it is given twice");
                axes.push(Axis { key, values });
            }
            _ => bail!("grid.{key}: expected a list of values, for example {key} = [{value}]"),
        }
    }
    Ok(())
}

fn values_of(key: &str, values: &[Value]) -> Result<Vec<(String, Setting)>> {
    for (word, instead) in [
        ("seed", "`seeds`, beside the grid"),
        ("seeds", "`seeds`, beside the grid"),
        ("preset", "`preset`: make it [[runs]] of its own"),
        ("from", "`from`: make it [[runs]] of its own"),
        ("evaluation", "[[evaluations]]"),
    ] {
        ensure!(key.split('.').next() != Some(word), "set it by {instead}");
    }
    ensure!(!values.is_empty(), "the list is empty");
    let mut found: Vec<(String, Setting)> = Vec::new();
    for value in values {
        let text = text(value)?;
        ensure!(found.iter().all(|(before, _)| *before != text), "{text} is given twice");
        found.push((text, Setting::new(key, value.clone())?));
    }
    Ok(found)
}

fn text(value: &Value) -> Result<String> {
    let text = match value {
        Value::String(text) => text.clone(),
        Value::Integer(number) => number.to_string(),
        // The shortest that means the same number.
        Value::Float(number) => number.to_string(),
        Value::Boolean(truth) => truth.to_string(),
        Value::Table(_) | Value::Array(_) | Value::Datetime(_) => {
            bail!("{value}: a value is a number, a word, true or false; make it [[runs]] of its own with `config`")
        }
    };
    let sound = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    ensure!(
        !text.is_empty() && text.chars().all(sound),
        "\"{text}\" cannot be a part of a folder's name; make it [[runs]] of its own with `config`"
    );
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(text: &str) -> Result<Vec<Point>> {
        points(&toml::from_str(text).unwrap(), 100)
    }

    fn problem(text: &str) -> String {
        format!("{:#}", grid(text).unwrap_err())
    }

    #[test]
    fn keys_with_the_same_ending_are_written_out() {
        let both = "ppo.learning_rate = [1e-3]\nreward.lagrangian.learning_rate = [0.5]\nppo.clip = [1, 0.2]\n\
                    network.encoder = [\"cnn\"]";
        let names: Vec<String> = grid(both).unwrap().into_iter().map(|point| point.suffix).collect();
        assert_eq!(names.len(), 2);
        assert_eq!(grid("").unwrap().len(), 1, "no grid is one run");
        for part in ["-ppo.learning_rate=0.001", "-reward.lagrangian.learning_rate=0.5", "-encoder=cnn"] {
            assert!(names.iter().all(|name| name.contains(part)), "{names:?}");
        }
        assert!(names[0].contains("-clip=1-") && names[1].contains("-clip=0.2-"), "{names:?}");
    }

    #[test]
    fn mistakes_name_the_key() {
        let unknown = problem("\"ppo.lerning_rate\" = [1e-3]");
        assert_eq!(unknown, "grid.ppo.lerning_rate: unknown key `lerning_rate` (did you mean `learning_rate`?)");
        assert!(
            problem("ppo.epochs = [2, \"four\"]")
                .starts_with("grid.ppo.epochs: expected a whole number, found \"four\" (must be 1 to 64)")
        );
        assert_eq!(problem("ppo.epochs = []"), "grid.ppo.epochs: the list is empty");
        assert_eq!(problem("ppo.clip = [0.2, 0.20]"), "grid.ppo.clip: 0.2 is given twice");
        let alone = problem("ppo.clip = 0.2");
        assert_eq!(alone, "grid.ppo.clip: expected a list of values, for example ppo.clip = [0.2]");
        for key in ["seed", "seeds"] {
            assert!(problem(&format!("{key} = [1, 2]")).ends_with("set it by `seeds`, beside the grid"));
        }
        assert!(problem("scenes = [[\"a.toml\"]]").contains("a value is a number, a word, true or false"));
        assert!(problem("\"ppo.clip\" = [1]\nppo.clip = [2]").contains("grid.ppo.clip: it is given twice"));
        assert!(problem("a = { 1 = [[]] }").starts_with("grid.a.1: "));
        let many =
            "ppo.epochs = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]\nppo.rollout_steps = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]";
        assert_eq!(problem(many), "grid: more than 100 combinations");
    }
}
