//! How the optimiser fared: entropy, steps of the policy, losses, gradients, and how long it all took.

use super::parts::{in_parts, legend};
use super::series::{measured, trained};
use super::stages;
use crate::chart::{Axis, Content, Figure, LinePlot, Markers, Panel, Series, Unit};
use crate::curves::Curve;
use crate::study::{ELAPSED_S, FRAMES_PER_S};
use crate::styled_group::StyledGroup;
use proto::metric;

/// A longer training time is given in hours.
const MINUTES_MOST: f64 = 180.0;

/// Title, metric, axis.
fn measures() -> [(&'static str, &'static str, Axis); 9] {
    [
        ("entropy of the policy", metric::ENTROPY, Axis::free("nats", Unit::Number)),
        ("approximate KL of an update", metric::APPROXIMATE_KL, Axis::new("(ratio − 1) − ln ratio", Unit::Number)),
        ("clipped samples", metric::CLIP_FRACTION, Axis::new("share of samples", Unit::Percent)),
        ("policy loss", metric::POLICY_LOSS, Axis::free("clipped surrogate loss", Unit::Number)),
        ("value loss", metric::VALUE_LOSS, Axis::new("before its coefficient", Unit::Number)),
        ("auxiliary loss", metric::AUXILIARY_LOSS, Axis::new("before its weight", Unit::Number)),
        ("gradient norm", metric::GRADIENT_NORM, Axis::new("before clipping", Unit::Number)),
        ("throughput", FRAMES_PER_S, Axis::new("frames a second", Unit::Count)),
        ("time trained", ELAPSED_S, Axis::new("minutes", Unit::Number)),
    ]
}

/// The optimiser's figures over training; those that no run has are left out.
pub fn optimisation(entries: &[StyledGroup<'_>]) -> Vec<Figure> {
    let with: Vec<&StyledGroup<'_>> = entries
        .iter()
        .filter(|entry| measures().iter().any(|(_, metric, _)| trained(entry, metric).is_some()))
        .collect();
    let unit = TimeUnit::of(&with);
    in_parts(&with, "optimisation", |name, part| {
        let panels = measures().into_iter().filter_map(|(title, metric, mut y)| {
            let drawn = |entry: &&StyledGroup<'_>| {
                if metric == ELAPSED_S { time_trained(entry, &unit) } else { trained(entry, metric) }
            };
            let series: Vec<Series> = part.iter().filter_map(drawn).collect();
            if series.is_empty() {
                return None;
            }
            if metric == ELAPSED_S {
                unit.name.clone_into(&mut y.label);
            }
            let mut plot = LinePlot { x: Axis::new("frames", Unit::Count), y, series, marks: Vec::new() };
            stages::mark(&mut plot, part);
            Some(Panel { title: title.to_owned(), content: Content::Lines(plot) })
        });
        Figure {
            name,
            caption: "The optimiser over training, smoothed within each stage: mean over seeds, shaded the range from the \
                      lowest seed to the highest; faint, the rollouts of each run. Time trained is the sum over rollouts \
                      of simulation, inference and update; while a run stands still, no time passes."
                .into(),
            legend: legend(part),
            columns: 2,
            panel_height: 230.0,
            panels: panels.collect(),
        }
    })
}

/// Unit of training times, the same for all groups.
struct TimeUnit {
    seconds: f64,
    name: &'static str,
}

impl TimeUnit {
    /// Minutes, or hours where there are many.
    fn of(entries: &[&StyledGroup<'_>]) -> Self {
        let curves = entries.iter().filter_map(|entry| Curve::of_training(entry.group, ELAPSED_S));
        let longest_s = curves.flat_map(|curve| curve.points).fold(0.0f64, |most, point| most.max(point.mean));
        if longest_s > 60.0 * MINUTES_MOST {
            Self { seconds: 3600.0, name: "hours" }
        } else {
            Self { seconds: 60.0, name: "minutes" }
        }
    }
}

/// A group's training time. Time only grows: it is not smoothed.
fn time_trained(entry: &StyledGroup<'_>, unit: &TimeUnit) -> Option<Series> {
    let mut series = measured(entry, &Curve::of_training(entry.group, ELAPSED_S)?);
    series.points.iter_mut().for_each(|point| point.1 /= unit.seconds);
    for (_, low, high) in &mut series.band {
        *low /= unit.seconds;
        *high /= unit.seconds;
    }
    Some(Series { markers: Markers::Some, ..series })
}
