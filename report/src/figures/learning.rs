//! Learning curves.

use super::parts::{in_parts, legend};
use super::series::trained;
use super::stages;
use crate::chart::{Axis, Content, Figure, LinePlot, Panel, Unit};
use crate::curves::Curve;
use crate::styled_group::StyledGroup;
use proto::metric;

/// Title, metric, axis.
fn measures() -> [(&'static str, &'static str, Axis); 4] {
    [
        // Side by side, over one axis.
        ("success (SR)", metric::SUCCESS, Axis::new("share of episodes", Unit::Percent)),
        (
            "success without disturbance (SRwoD)",
            metric::SUCCESS_UNDISTURBED,
            Axis::new("share of episodes", Unit::Percent),
        ),
        ("return", metric::RETURN, Axis::free("mean return of an episode", Unit::Number)),
        ("disturbance", metric::DISTURBANCE, Axis::new("displacement at the end (m)", Unit::Number)),
    ]
}

/// Return, success, success without disturbance and disturbance over training.
pub fn learning(entries: &[StyledGroup<'_>]) -> Vec<Figure> {
    let begun: Vec<&StyledGroup<'_>> =
        entries.iter().filter(|entry| entry.group.runs.iter().any(|run| !run.rollouts.is_empty())).collect();
    in_parts(&begun, "learning", |name, part| {
        let panels = measures().map(|(title, metric, y)| {
            let series = part.iter().filter_map(|entry| trained(entry, metric)).collect();
            let mut plot = LinePlot { x: Axis::new("frames", Unit::Count), y, series, marks: Vec::new() };
            stages::mark(&mut plot, part);
            Panel { title: title.to_owned(), content: Content::Lines(plot) }
        });
        Figure {
            name,
            caption: "Training episodes, in bins of an eightieth of the run, smoothed within each stage: mean over seeds; \
                      shaded, the range from the lowest seed to the highest; faint, the rollouts of each run. The return is \
                      under the reward of the stage, so it jumps where the reward changes."
                .into(),
            legend: legend(part),
            columns: 2,
            panel_height: 250.0,
            panels: panels.into(),
        }
    })
}

/// PPO-Lagrangian's multiplier over training.
pub fn multiplier(entries: &[StyledGroup<'_>]) -> Vec<Figure> {
    let with: Vec<&StyledGroup<'_>> =
        entries.iter().filter(|entry| Curve::of_training(entry.group, metric::MULTIPLIER).is_some()).collect();
    in_parts(&with, "multiplier", |name, part| {
        let curves = part.iter().filter_map(|entry| trained(entry, metric::MULTIPLIER));
        let plot = LinePlot {
            x: Axis::new("frames", Unit::Count),
            y: Axis::new("λ", Unit::Number),
            series: curves.collect(),
            marks: Vec::new(),
        };
        Figure {
            name,
            caption:
                "The multiplier of PPO-Lagrangian: mean over seeds; shaded, the range from the lowest seed to the \
                      highest."
                    .into(),
            legend: legend(part),
            columns: 2,
            panel_height: 230.0,
            panels: vec![Panel { title: "PPO-Lagrangian's multiplier".into(), content: Content::Lines(plot) }],
        }
    })
}
