//! How success falls when less disturbance is forgiven.

use super::parts::{in_parts, legend};
use crate::chart::{Axis, Content, Figure, LinePlot, Mark, Markers, Panel, Series, Unit};
use crate::results::{FieldResult, LimitPoint};
use crate::study::Field;
use crate::styled_group::StyledGroup;
use proto::reward::UNDISTURBED_THRESHOLD_M;

/// Success with less displacement than a threshold, over the threshold.
pub fn by_threshold(entries: &[StyledGroup<'_>]) -> Vec<Figure> {
    figures(
        entries,
        "srwod-by-threshold",
        "Share of episodes that are successful with a total displacement of all other objects below the threshold, mean \
         over seeds and kitchens with 95% stratified-bootstrap intervals. SRwoD is the value at 0.01 m.",
        &Axis::logarithmic("threshold on the total displacement (m)", Unit::Number),
        &[Mark { x: f64::from(UNDISTURBED_THRESHOLD_M), label: "SRwoD".into() }],
        |result| &result.by_threshold,
    )
}

/// Success with at most so many disturbed objects.
pub fn by_objects(entries: &[StyledGroup<'_>]) -> Vec<Figure> {
    figures(
        entries,
        "srwod-by-objects",
        "Share of episodes that are successful with at most so many objects more than 0.01 m from their place on some \
         axis, mean over seeds and kitchens with 95% stratified-bootstrap intervals.",
        &Axis::new("disturbed objects at most", Unit::Count),
        &[],
        |result| &result.by_disturbed_objects,
    )
}

fn figures(
    entries: &[StyledGroup<'_>],
    name: &str,
    caption: &str,
    x: &Axis,
    marks: &[Mark],
    curve: impl Fn(&FieldResult) -> &[LimitPoint],
) -> Vec<Figure> {
    let evaluated: Vec<&StyledGroup<'_>> = entries.iter().filter(|entry| !entry.results.is_empty()).collect();
    in_parts(&evaluated, name, |name, part| {
        let fields = Field::ALL.into_iter().filter(|&field| part.iter().any(|entry| entry.in_field(field).is_some()));
        let panels = fields.map(|field| {
            let series = part.iter().filter_map(|entry| {
                let points = curve(entry.in_field(field)?);
                let band = points.iter().filter_map(|point| {
                    let interval = point.interval?;
                    Some((point.at, interval.low, interval.high))
                });
                Some(Series {
                    style: entry.style,
                    points: points.iter().map(|point| (point.at, point.mean)).collect(),
                    band: band.collect(),
                    markers: Markers::All,
                    ..Series::default()
                })
            });
            let plot = LinePlot {
                x: x.clone(),
                y: Axis::new("success", Unit::Percent),
                series: series.collect(),
                marks: marks.to_vec(),
            };
            Panel { title: field.name(), content: Content::Lines(plot) }
        });
        Figure {
            name,
            caption: caption.to_owned(),
            legend: legend(part),
            columns: 2,
            panel_height: 270.0,
            panels: panels.collect(),
        }
    })
}
