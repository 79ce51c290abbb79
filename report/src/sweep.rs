use crate::results::{FieldResult, GroupResults};
use crate::statistics::Estimate;
use crate::study::Field;
use serde::Serialize;
use std::collections::BTreeMap;
use toml::Table;

#[derive(Debug, Clone, Serialize)]
pub struct Sweep {
    pub weight: String,
    pub field: String,
    pub points: Vec<SweepPoint>,
}

#[derive(Debug, Clone, Serialize)]
pub struct SweepPoint {
    pub value: f64,
    pub group: String,
    pub metrics: BTreeMap<String, Estimate>,
}

pub(crate) fn sweeps(entries: &[GroupResults<'_>]) -> Vec<Sweep> {
    let mut families: Vec<(&str, Table, Vec<&GroupResults<'_>>)> = Vec::new();
    for entry in entries.iter().filter(|entry| !entry.group.untrained() && !entry.group.unknown()) {
        for weight in entry.group.runs[0].config.reward.weights.keys() {
            let mut rest = entry.group.settings.clone();
            if let Some(reward) = rest.get_mut("reward").and_then(toml::Value::as_table_mut) {
                reward.remove(weight);
            }
            match families.iter_mut().find(|(name, settings, _)| name == weight && *settings == rest) {
                Some((_, _, members)) => members.push(entry),
                None => families.push((weight, rest, vec![entry])),
            }
        }
    }
    let mut sweeps = Vec::new();
    for (weight, _, members) in families {
        for field in Field::all() {
            let point = |entry: &&GroupResults<'_>| Some(SweepPoint::of(weight, entry, entry.in_field(field)?));
            let mut points: Vec<SweepPoint> = members.iter().filter_map(point).collect();
            points.sort_by(|a, b| a.value.total_cmp(&b.value));
            if points.array_windows().any(|[a, b]| a.value != b.value) {
                sweeps.push(Sweep { weight: weight.to_owned(), field: field.key(), points });
            }
        }
    }
    sweeps
}

impl SweepPoint {
    fn of(weight: &str, entry: &GroupResults<'_>, result: &FieldResult) -> Self {
        let config = &entry.group.runs[0].config;
        let mean = |name: &String| Some((name.clone(), result.metrics.get(name)?.mean));
        Self {
            value: f64::from(config.reward.weights[weight]),
            group: entry.group.label.clone(),
            metrics: config.spec().ranking().iter().filter_map(|metric| mean(&metric.name)).collect(),
        }
    }
}
