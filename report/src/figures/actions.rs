//! What a policy does when.

use crate::chart::{Content, Figure, HeatMap, Panel};
use crate::results::FieldResult;
use crate::study::Field;
use crate::styled_group::StyledGroup;

/// One map a group, of the first field in which it was evaluated.
pub fn action_maps(entries: &[StyledGroup<'_>]) -> Vec<Figure> {
    let mut figures = Vec::new();
    for (index, entry) in entries.iter().enumerate() {
        let Some((field, result)) = Field::ALL.into_iter().find_map(|field| Some((field, entry.in_field(field)?)))
        else {
            continue;
        };
        figures.push(Figure {
            name: format!("actions-{}", index + 1),
            caption: format!(
                "{}: share of the episodes still running at a step in which each action was taken, over all seeds; the \
                 colours are logarithmic, the same on every map, and the darkest is 0.1% or less (the evaluations that count for {}; all their episodes).",
                entry.group.label,
                field.name()
            ),
            legend: Vec::new(),
            columns: 1,
            panel_height: HeatMap::height(result.actions.actions.len()),
            panels: vec![Panel { title: entry.group.label.clone(), content: Content::Heat(map(result)) }],
        });
    }
    figures
}

fn map(result: &FieldResult) -> HeatMap {
    let counts = &result.actions.counts_by_step;
    let totals: Vec<u64> = counts.iter().map(|row| row.iter().sum()).collect();
    let row = |action: usize| {
        let share = |(step, total): (usize, &u64)| (*total > 0).then(|| counts[step][action] as f64 / *total as f64);
        totals.iter().enumerate().map(share).collect()
    };
    HeatMap {
        x_label: "step of the episode".into(),
        scale_label: "share of running episodes (logarithmic)".into(),
        values: (0..result.actions.actions.len()).map(row).collect(),
        rows: result.actions.actions.clone(),
    }
}
