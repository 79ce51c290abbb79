use super::row::{Format, Row};
use proto::config::{Config, Lists, differences as between};
use std::collections::BTreeSet;
use toml::Value;

/// The settings that are not the same in all, by their names. A table that some do not have is one setting.
pub fn differences(configs: &[Config]) -> Vec<Row> {
    let values: Vec<Value> = configs.iter().map(|config| Value::Table(config.to_table())).collect();
    let Some((first, others)) = values.split_first() else { return Vec::new() };
    let paths: BTreeSet<String> = others
        .iter()
        .flat_map(|other| between(first, other, Lists::ByElement).into_iter().map(|difference| difference.path))
        .collect();
    let is_part =
        |path: &str| paths.iter().any(|whole| path.strip_prefix(whole).is_some_and(|rest| rest.starts_with('.')));
    paths.iter().filter(|path| !is_part(path)).map(|path| row(path, &values)).collect()
}

fn row(path: &str, values: &[Value]) -> Row {
    let found: Vec<Option<&Value>> = values.iter().map(|value| at(value, path)).collect();
    let json = |value: Option<&Value>| value.and_then(|value| serde_json::to_value(value).ok()).unwrap_or_default();
    let text = |value: Option<&Value>| match value {
        None => String::new(),
        // Of an evaluation no number of episodes is all that there are.
        Some(Value::Integer(0)) if path == "evaluation.episodes" => "all".to_owned(),
        Some(Value::String(text)) => text.clone(),
        Some(value) => value.to_string(),
    };
    Row {
        name: path.to_owned(),
        values: found.iter().copied().map(json).collect(),
        shown: found.iter().copied().map(text).collect(),
        format: Format::Text,
    }
}

fn at<'a>(value: &'a Value, path: &str) -> Option<&'a Value> {
    path.split('.').try_fold(value, |value, key| match value {
        Value::Table(table) => table.get(key),
        Value::Array(list) => list.get(key.parse::<usize>().ok()?),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::evaluation::{EvaluationConfig, ObjectSet};
    use proto::kitchen::Split;
    use serde_json::json;

    #[test]
    fn no_number_of_episodes_is_all() {
        let all = Config {
            evaluation: Some(EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 0)),
            ..Config::resolve("demo", None).unwrap()
        };
        let mut some = all.clone();
        some.evaluation.as_mut().unwrap().episodes = 30;
        let rows = differences(&[all, some]);
        assert_eq!((rows.len(), &rows[0].shown), (1, &vec!["all".to_owned(), "30".to_owned()]));
        assert_eq!(rows[0].values, [json!(0), json!(30)]);
    }

    #[test]
    fn a_setting_that_is_not_the_same_in_all_is_shown_of_all() {
        let one = Config::resolve("demo", None).unwrap();
        let mut two = one.clone();
        two.seed = 9;
        two.stages[1].frames = 77;
        two.reward.weights.insert("lambda_disturb".to_owned(), 0.1);
        let mut three = one.clone();
        three.seed = 9;
        three.scenes = vec!["a.toml".into()];
        let rows = differences(&[one.clone(), two, three]);
        let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names, ["reward.lambda_disturb", "scenes", "seed", "stages.1.frames"]);
        // A number of 32 bits, as it was given.
        assert_eq!((&rows[0].values[1], rows[0].shown[1].as_str()), (&json!(0.1), "0.1"));
        assert_eq!(rows[2].values, [json!(1), json!(9), json!(9)]);
        assert_eq!(
            rows[3].shown,
            [one.stages[1].frames.to_string(), "77".to_owned(), one.stages[1].frames.to_string()]
        );
        assert_eq!(rows[1].values[2], json!(["a.toml"]));
        assert_eq!(differences(&[one.clone(), one.clone()]), []);
        let mut longer = one.clone();
        longer.stages.push(one.stages[0].clone());
        let rows = differences(&[one, longer]);
        assert_eq!((rows.len(), rows[0].name.as_str(), &rows[0].values[0]), (1, "stages.2", &json!(null)));
    }
}
