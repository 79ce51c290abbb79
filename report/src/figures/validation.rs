//! Validation during training.

use super::parts::{in_parts, legend};
use super::series::measured;
use super::stages;
use crate::chart::{Axis, Content, Figure, LinePlot, Panel, Unit};
use crate::curves::Curve;
use crate::study::Validated;
use crate::styled_group::StyledGroup;

/// SR and `SRwoD` on validation episodes over training.
pub fn validation(entries: &[StyledGroup<'_>]) -> Vec<Figure> {
    let with: Vec<&StyledGroup<'_>> =
        entries.iter().filter(|entry| entry.group.runs.iter().any(|run| !run.validation.is_empty())).collect();
    in_parts(&with, "validation", |name, part| {
        let panel = |title: &str, label: &str, figure: fn(&Validated) -> f64| {
            let curves = part.iter().filter_map(|entry| {
                let curve = Curve::of_validation(entry.group, label, figure)?;
                Some(measured(entry, &curve))
            });
            let mut plot = LinePlot {
                x: Axis::new("frames", Unit::Count),
                y: Axis::new("share of episodes", Unit::Percent),
                series: curves.collect(),
                marks: Vec::new(),
            };
            stages::mark(&mut plot, part);
            Panel { title: title.to_owned(), content: Content::Lines(plot) }
        };
        Figure {
            name,
            caption: "Episodes of the validation kitchens during training, where every seed was evaluated: mean \
                      over seeds; shaded, the range from the lowest seed to the highest."
                .into(),
            legend: legend(part),
            columns: 2,
            panel_height: 250.0,
            panels: vec![
                panel("success (SR)", "success rate", |point| point.success),
                panel("success without disturbance (SRwoD)", "SRwoD", |point| point.success_without_disturbance),
            ],
        }
    })
}
