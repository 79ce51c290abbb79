//! Curves over training as series of a plot.

use super::stages;
use crate::chart::{Markers, Series};
use crate::curves::{Curve, of_run, smoothed};
use crate::styled_group::StyledGroup;

/// A group's curve of measurements; the band is the range over seeds.
pub fn measured(entry: &StyledGroup<'_>, curve: &Curve) -> Series {
    let band = curve.points.iter().filter(|point| point.seeds > 1).map(|point| (point.frames, point.low, point.high));
    Series {
        style: entry.style,
        points: curve.points.iter().map(|point| (point.frames, point.mean)).collect(),
        band: band.collect(),
        ..Series::default()
    }
}

/// A group's metric over training, smoothed within each stage, before the rollouts of its runs; none where no run has
/// it.
pub fn trained(entry: &StyledGroup<'_>, metric: &str) -> Option<Series> {
    let group = entry.group;
    let measured = measured(entry, &Curve::of_training(group, metric)?);
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
