//! SR and `SRwoD` over `λ_disturb`.

use crate::results::{FieldResult, GroupResults};
use crate::statistics::Estimate;
use crate::study::Field;
use serde::Serialize;
use toml::Table;

/// Groups that differ in `λ_disturb` only.
#[derive(Debug, Clone, Serialize)]
pub struct Sweep {
    /// `test-novel`, ...
    pub field: String,
    pub points: Vec<SweepPoint>,
}

#[derive(Debug, Clone, Serialize)]
pub struct SweepPoint {
    /// `λ_disturb`.
    pub lambda_disturb: f64,
    pub group: String,
    /// SR, mean over seeds and kitchens.
    pub success: Estimate,
    /// `SRwoD`, mean over seeds and kitchens.
    pub success_without_disturbance: Estimate,
}

/// All sweeps over at least two values.
pub(crate) fn sweeps(entries: &[GroupResults<'_>]) -> Vec<Sweep> {
    let mut families: Vec<(Table, Vec<&GroupResults<'_>>)> = Vec::new();
    for entry in entries.iter().filter(|entry| !entry.group.untrained() && !entry.group.unknown()) {
        let mut rest = entry.group.settings.clone();
        if let Some(reward) = rest.get_mut("reward").and_then(toml::Value::as_table_mut) {
            reward.remove("lambda_disturb");
        }
        match families.iter_mut().find(|(settings, _)| *settings == rest) {
            Some((_, members)) => members.push(entry),
            None => families.push((rest, vec![entry])),
        }
    }
    let mut sweeps = Vec::new();
    for (_, members) in families {
        for field in Field::ALL {
            let mut points: Vec<SweepPoint> =
                members.iter().filter_map(|entry| Some(SweepPoint::of(entry, entry.in_field(field)?))).collect();
            points.sort_by(|a, b| a.lambda_disturb.total_cmp(&b.lambda_disturb));
            if points.array_windows().any(|[a, b]| a.lambda_disturb != b.lambda_disturb) {
                sweeps.push(Sweep { field: field.key(), points });
            }
        }
    }
    sweeps
}

impl SweepPoint {
    fn of(entry: &GroupResults<'_>, result: &FieldResult) -> Self {
        Self {
            lambda_disturb: f64::from(entry.group.runs[0].config.reward.weights["lambda_disturb"]),
            group: entry.group.label.clone(),
            success: result.success.mean,
            success_without_disturbance: result.success_without_disturbance.mean,
        }
    }
}
