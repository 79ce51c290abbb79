//! Validation during training, and how well disturbances are foretold.

use super::{Subject, in_parts, legend, measured, stages, trained};
use crate::chart::{Axis, Content, Figure, LinePlot, Panel, Unit};
use crate::curves::Curve;

/// SR and `SRwoD` on validation episodes over training.
pub fn validation(subjects: &[Subject<'_>]) -> Vec<Figure> {
    let with: Vec<&Subject<'_>> =
        subjects.iter().filter(|subject| subject.group.runs.iter().any(|run| !run.validation.is_empty())).collect();
    in_parts(&with, "validation", |name, part| {
        let panel = |title: &str, label: &str, without_disturbance: bool| {
            let curves = part.iter().filter_map(|subject| {
                let curve = Curve::of_validation(subject.group, label, |run| {
                    let figure = |point: &crate::study::Validated| {
                        if without_disturbance { point.success_without_disturbance } else { point.success }
                    };
                    run.validation.iter().map(|point| (point.frames, figure(point))).collect()
                })?;
                Some(measured(subject, &curve))
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
                panel("success (SR)", "success rate", false),
                panel("success without disturbance (SRwoD)", "SRwoD", true),
            ],
        }
    })
}

/// Title, metric of the `disturb` task, axis: precision and recall have one axis.
const PREDICTION: [(&str, &str, &str); 4] = [
    ("precision", "auxiliary/precision", "share of such steps"),
    ("recall of disturbing steps", "auxiliary/recall_disturb", "share of such steps"),
    ("recall of quiet steps", "auxiliary/recall_no_disturb", "share of such steps"),
    ("steps that disturb", "auxiliary/label_rate", "share of all steps"),
];

/// Precision and recall of disturbance prediction over training.
pub fn prediction(subjects: &[Subject<'_>]) -> Vec<Figure> {
    // The rate of the label is told with every rollout; shares of nothing are not.
    let with: Vec<&Subject<'_>> =
        subjects.iter().filter(|subject| Curve::of_training(subject.group, PREDICTION[3].1).is_some()).collect();
    in_parts(&with, "prediction", |name, part| {
        let panels = PREDICTION.map(|(title, metric, label)| {
            let series = part.iter().filter_map(|subject| trained(subject, metric)).collect();
            let (x, y) = (Axis::new("frames", Unit::Count), Axis::new(label, Unit::Percent));
            let mut plot = LinePlot { x, y, series, marks: Vec::new() };
            stages::mark(&mut plot, part);
            Panel { title: title.to_owned(), content: Content::Lines(plot) }
        });
        Figure {
            name,
            caption: "The auxiliary head that is trained with the focal loss: of the steps foretold to disturb, those \
                      that did (precision); of the steps that did, those foretold (recall); the same recall for quiet \
                      steps; and how rare disturbing steps are. Precision is missing where nothing was foretold."
                .into(),
            legend: legend(part),
            columns: 2,
            panel_height: 230.0,
            panels: panels.into(),
        }
    })
}
