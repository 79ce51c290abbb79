//! What groups came to in a field, with how far it can be trusted.

use crate::chart::{Axis, Content, Figure, IntervalPlot, IntervalRow, Panel, Unit};
use crate::method::published;
use crate::results::FieldResult;
use crate::study::Field;
use crate::styled_group::StyledGroup;

/// Interquartile means with their intervals, SR beside `SRwoD`, and what the paper has for the preset.
pub fn intervals(entries: &[StyledGroup<'_>], field: Field) -> Option<Figure> {
    let found: Vec<(&StyledGroup<'_>, &FieldResult)> =
        entries.iter().filter_map(|entry| Some((entry, entry.in_field(field)?))).collect();
    if found.is_empty() {
        return None;
    }
    let panel = |title: &str, without_disturbance: bool| {
        let rows = found.iter().map(|(entry, result)| {
            let published = published(entry.group, field);
            let (aggregate, published) = if without_disturbance {
                (result.success_without_disturbance, published.map(|paper| paper.success_without_disturbance))
            } else {
                (result.success, published.map(|paper| paper.success))
            };
            IntervalRow {
                name: entry.group.label.clone(),
                style: entry.style,
                point: Some(aggregate.iqm.point),
                interval: aggregate.iqm.interval.map(|interval| (interval.low, interval.high)),
                published,
            }
        });
        let axis = Axis::new("interquartile mean", Unit::Percent);
        Panel { title: title.to_owned(), content: Content::Intervals(IntervalPlot { axis, rows: rows.collect() }) }
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
