//! How well disturbances are predicted.

use super::parts::{in_parts, legend};
use super::series::trained;
use super::stages;
use crate::chart::{Axis, Content, Figure, LinePlot, Panel, Unit};
use crate::curves::Curve;
use crate::styled_group::StyledGroup;

/// Title, metric of the `disturb` task, axis: precision and recall have one axis.
const PREDICTION: [(&str, &str, &str); 4] = [
    ("precision", "auxiliary/precision", "share of such steps"),
    ("recall of disturbing steps", "auxiliary/recall_disturb", "share of such steps"),
    ("recall of quiet steps", "auxiliary/recall_no_disturb", "share of such steps"),
    ("steps that disturb", "auxiliary/label_rate", "share of all steps"),
];

/// Precision and recall of disturbance prediction over training.
pub fn prediction(entries: &[StyledGroup<'_>]) -> Vec<Figure> {
    // Every rollout has the rate of the label; precision and recall are missing where there is nothing to divide by.
    let with: Vec<&StyledGroup<'_>> =
        entries.iter().filter(|entry| Curve::of_training(entry.group, PREDICTION[3].1).is_some()).collect();
    in_parts(&with, "prediction", |name, part| {
        let panels = PREDICTION.map(|(title, metric, label)| {
            let series = part.iter().filter_map(|entry| trained(entry, metric)).collect();
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
