//! The figures of the report. Each function makes those of one question; none where nothing was recorded for it.

mod actions;
mod curves;
mod disturbance;
mod optimisation;
mod stages;
mod sweep;
mod training;

pub use actions::action_maps;
pub use curves::{prediction, validation};
pub use disturbance::{by_objects, by_threshold};
pub use optimisation::optimisation;
pub use sweep::{Sweep, sweep_figure, sweeps};
pub use training::{learning, multiplier};

use crate::chart::palette::STYLES;
use crate::chart::{Content, Figure, IntervalPlot, IntervalRow, Markers, Panel, Series};
use crate::curves::{Curve, of_run, smoothed};
use crate::results::FieldResult;
use crate::study::{Field, Group};
use crate::tables::published;

/// A group with its number and what was found of it.
#[derive(Debug, Clone)]
pub struct Subject<'a> {
    /// Number of its style in every figure.
    pub style: usize,
    /// The group.
    pub group: &'a Group<'a>,
    /// In each field in which it was evaluated.
    pub results: Vec<(Field, FieldResult)>,
}

impl Subject<'_> {
    /// Its result in a field.
    pub fn in_field(&self, field: Field) -> Option<&FieldResult> {
        self.results.iter().find(|(found, _)| *found == field).map(|(_, result)| result)
    }
}

/// As many figures as are needed so that none has more curves than there are colours.
fn in_parts<'a>(
    all: &'a [&'a Subject<'a>],
    name: &str,
    mut figure: impl FnMut(String, &'a [&'a Subject<'a>]) -> Figure,
) -> Vec<Figure> {
    let parts = all.len().div_ceil(STYLES);
    all.chunks(STYLES)
        .enumerate()
        .map(|(part, chunk)| figure(if parts > 1 { format!("{name}-{}", part + 1) } else { name.to_owned() }, chunk))
        .collect()
}

/// Names of these groups beside their styles.
fn legend(subjects: &[&Subject<'_>]) -> Vec<(usize, String)> {
    subjects.iter().map(|subject| (subject.style, subject.group.label.clone())).collect()
}

/// A group's curve of measurements; the band is the range over seeds.
fn measured(subject: &Subject<'_>, curve: &Curve) -> Series {
    let band = curve.points.iter().filter(|point| point.seeds > 1).map(|point| (point.frames, point.low, point.high));
    Series {
        style: subject.style,
        points: curve.points.iter().map(|point| (point.frames, point.mean)).collect(),
        band: band.collect(),
        ..Series::default()
    }
}

/// A group's metric over training, smoothed within each stage, before the rollouts of its runs; none where no run has
/// it.
fn trained(subject: &Subject<'_>, metric: &str) -> Option<Series> {
    let group = subject.group;
    let measured = measured(subject, &Curve::of_training(group, metric)?);
    let ends = stages::ends(group);
    let band = |figure: fn(&(f64, f64, f64)) -> f64| {
        let line: Vec<(f64, f64)> = measured.band.iter().map(|point| (point.0, figure(point))).collect();
        smoothed(&line, &ends)
    };
    let (low, high) = (band(|point| point.1), band(|point| point.2));
    Some(Series {
        points: smoothed(&measured.points, &ends),
        band: low.into_iter().zip(high).map(|((frames, low), (_, high))| (frames, low, high)).collect(),
        markers: Markers::Some,
        raw: group.runs.iter().map(|run| of_run(run, metric)).collect(),
        ..measured
    })
}

/// Interquartile means with their intervals, SR beside `SRwoD`, and what the paper has for the preset.
pub fn intervals(subjects: &[Subject<'_>], field: Field) -> Option<Figure> {
    let found: Vec<(&Subject<'_>, &FieldResult)> =
        subjects.iter().filter_map(|subject| Some((subject, subject.in_field(field)?))).collect();
    if found.is_empty() {
        return None;
    }
    let panel = |title: &str, without_disturbance: bool| {
        let rows = found.iter().map(|(subject, result)| {
            let published = published(subject.group, field);
            let (aggregate, published) = if without_disturbance {
                (result.success_without_disturbance, published.map(|paper| paper.success_without_disturbance))
            } else {
                (result.success, published.map(|paper| paper.success))
            };
            IntervalRow {
                name: subject.group.label.clone(),
                style: subject.style,
                point: Some(aggregate.iqm.point),
                interval: aggregate.iqm.interval.map(|interval| (interval.low, interval.high)),
                published,
            }
        });
        let label = "interquartile mean".to_owned();
        Panel { title: title.to_owned(), content: Content::Intervals(IntervalPlot { label, rows: rows.collect() }) }
    };
    Some(Figure {
        name: format!("results-{}", field.key()),
        caption: format!(
            "Interquartile mean over seeds and kitchens with its 95% stratified-bootstrap interval ({}); a group of one \
             seed has no interval. Open diamond: the mean of the paper's row, after the paper's number of frames.",
            field.name()
        ),
        legend: Vec::new(),
        columns: 2,
        panel_height: IntervalPlot::height(found.len()),
        panels: vec![panel("success rate", false), panel("success without disturbance", true)],
    })
}
