//! How the optimiser fared: entropy, steps of the policy, losses, gradients, and how long it all took.

use super::{Subject, in_parts, legend, measured, stages, trained};
use crate::chart::{Axis, Content, Figure, LinePlot, Markers, Panel, Series, Unit};
use crate::curves::Curve;
use crate::study::{ELAPSED_S, FRAMES_PER_S};
use proto::metric;

/// A training time of more than this is told in hours.
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
pub fn optimisation(subjects: &[Subject<'_>]) -> Vec<Figure> {
    let with: Vec<&Subject<'_>> = subjects
        .iter()
        .filter(|subject| measures().iter().any(|(_, metric, _)| trained(subject, metric).is_some()))
        .collect();
    in_parts(&with, "optimisation", |name, part| {
        let panels = measures().into_iter().filter_map(|(title, metric, mut y)| {
            // Time only grows: it is not smoothed.
            let of_time = |subject: &Subject<'_>| {
                let curve = Curve::of_training(subject.group, metric)?;
                Some(Series { markers: Markers::Some, ..measured(subject, &curve) })
            };
            let drawn = |subject: &&Subject<'_>| {
                if metric == ELAPSED_S { of_time(subject) } else { trained(subject, metric) }
            };
            let mut series: Vec<Series> = part.iter().filter_map(drawn).collect();
            if series.is_empty() {
                return None;
            }
            if metric == ELAPSED_S {
                in_readable_time(&mut series, &mut y);
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

/// Seconds as minutes, or as hours where there are many.
fn in_readable_time(series: &mut [Series], y: &mut Axis) {
    let longest_s = series.iter().flat_map(|series| &series.points).fold(0.0f64, |most, point| most.max(point.1));
    let (unit_s, label) = if longest_s > 60.0 * MINUTES_MOST { (3600.0, "hours") } else { (60.0, "minutes") };
    label.clone_into(&mut y.label);
    for series in series {
        series.points.iter_mut().for_each(|point| point.1 /= unit_s);
        for (_, low, high) in &mut series.band {
            *low /= unit_s;
            *high /= unit_s;
        }
    }
}
