//! SR and `SRwoD` over `λ_disturb`.

use crate::chart::{Axis, Content, Figure, LinePlot, MEASURES, Markers, Panel, Series, Unit};
use crate::results::FieldResult;
use crate::statistics::Estimate;
use crate::study::Field;
use crate::styled_group::StyledGroup;
use serde::Serialize;
use toml::Table;

/// Groups that differ in `λ_disturb` only.
#[derive(Debug, Clone, Serialize)]
pub struct Sweep {
    /// `test-novel`, ...
    pub field: String,
    #[serde(skip)]
    title: String,
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
pub fn sweeps(entries: &[StyledGroup<'_>]) -> Vec<Sweep> {
    let mut families: Vec<(Table, Vec<&StyledGroup<'_>>)> = Vec::new();
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
                sweeps.push(Sweep { field: field.key(), title: field.name(), points });
            }
        }
    }
    sweeps
}

impl SweepPoint {
    fn of(entry: &StyledGroup<'_>, result: &FieldResult) -> Self {
        Self {
            lambda_disturb: f64::from(entry.group.runs[0].config.reward.weights["lambda_disturb"]),
            group: entry.group.label.clone(),
            success: result.success.mean,
            success_without_disturbance: result.success_without_disturbance.mean,
        }
    }
}

/// All sweeps, a panel each.
pub fn sweep_figure(sweeps: &[Sweep]) -> Option<Figure> {
    if sweeps.is_empty() {
        return None;
    }
    let panels = sweeps.iter().map(|sweep| {
        let series = |style: usize, figure: fn(&SweepPoint) -> Estimate| {
            let band = sweep.points.iter().filter_map(|point| {
                let interval = figure(point).interval?;
                Some((point.lambda_disturb, interval.low, interval.high))
            });
            Series {
                style,
                points: sweep.points.iter().map(|point| (point.lambda_disturb, figure(point).point)).collect(),
                band: band.collect(),
                markers: Markers::All,
                ..Series::default()
            }
        };
        let plot = LinePlot {
            x: Axis::new("λ_disturb", Unit::Number),
            y: Axis::new("rate", Unit::Percent),
            series: vec![
                series(MEASURES, |point| point.success),
                series(MEASURES + 1, |point| point.success_without_disturbance),
            ],
            marks: Vec::new(),
        };
        Panel { title: sweep.title.clone(), content: Content::Lines(plot) }
    });
    Some(Figure {
        name: "lambda-sweep".into(),
        caption:
            "Runs that differ in λ_disturb only: mean over seeds and kitchens, shaded the 95% stratified-bootstrap \
                  interval."
                .into(),
        legend: vec![(MEASURES, "success rate".into()), (MEASURES + 1, "success without disturbance".into())],
        columns: 2,
        panel_height: 260.0,
        panels: panels.collect(),
    })
}
