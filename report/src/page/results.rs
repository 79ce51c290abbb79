//! The section of results: the groups, and what they came to in every field.

use super::figure::{drawn, notice};
use super::table::{Cell, RowKind, Table};
use crate::format::{NOTHING, count, number, share};
use crate::report::{FigureSet, GroupReport, Report};
use crate::results::FieldResult;
use crate::study::Field;
use maud::{Markup, html};

/// Why there are no results.
pub const NOT_EVALUATED: &str =
    "None of these runs has been evaluated yet: orchestrator eval RUN --split test --objects novel.";

/// Every group in every field, with the figures that the paper's tables do not have.
pub fn section(report: &Report, figures: &FigureSet) -> Markup {
    let in_field = |field: Field| -> Vec<(&GroupReport, &FieldResult)> {
        let result = |group: &'_ &GroupReport| group.results.iter().position(|result| result.field == field.key());
        report.groups.iter().filter_map(|group| Some((group, &group.results[result(&group)?]))).collect()
    };
    let fields = Field::ALL.map(|field| (field, in_field(field)));
    let evaluated: Vec<_> = fields.iter().filter(|(_, found)| !found.is_empty()).collect();
    html! {
        // The groups and their results in each field, side by side where the page is wide enough.
        div.tables {
            div {
                h3 { "Groups" }
                (groups(report))
                @if report.groups.iter().any(|group| !group.differences.is_empty()) {
                    p { "A star: the group has other settings than its preset." }
                }
            }
            @for (field, found) in &evaluated {
                div { h3 { (field.name()) } (field_table(found)) }
            }
        }
        @if evaluated.is_empty() {
            (notice(NOT_EVALUATED))
        } @else {
            (columns_explained())
            (safety(report))
            (drawn(&figures.intervals, NOT_EVALUATED))
        }
    }
}

fn groups(report: &Report) -> Table {
    let mut table = Table::new(["group", "seeds", "settings that are not the preset's"].map(Cell::text).to_vec());
    for (style, group) in report.groups.iter().enumerate() {
        let seeds: Vec<String> = group.runs.iter().map(|run| run.seed.to_string()).collect();
        let differences = if group.differences.is_empty() { NOTHING.to_owned() } else { group.differences.join("; ") };
        let cells = vec![Cell::group(&group.label, style), Cell::text(seeds.join(", ")), Cell::wide(differences)];
        table.row(RowKind::Plain, cells);
    }
    table
}

/// What the columns of [`field_table`] are.
fn columns_explained() -> Markup {
    html! {
        p {
            "Means over all episodes of all seeds together: pick-ups; steps of an episode; d, the total displacement of \
             all other objects at the end; how many objects are more than 0.01 m from their place at the end, and how \
             many were at some time; “back again”, the share of episodes in which something was away from its place \
             and is back at the end; “Done after”, the actions from the pick-up to Done, where there were both; actions that failed; the distance from target to goal at the end."
        }
    }
}

fn field_table(found: &[(&GroupReport, &FieldResult)]) -> Table {
    let mut head = vec![Cell::text("group"), Cell::number("seeds"), Cell::number("episodes")];
    head.extend(["SR", "SRwoD", "SRwoD (per axis)"].map(Cell::number));
    head.extend(
        ["picked up", "Done after", "steps", "d (m)", "disturbed", "ever", "back again", "failed", "goal (m)"]
            .map(Cell::number),
    );
    let mut table = Table::new(head);
    for (group, result) in found {
        let pooled = &result.pooled;
        let cells = [
            share(pooled.picked_up),
            number(pooled.done_after_pickup, 1),
            number(pooled.length, 1),
            number(pooled.disturbance_m, 3),
            number(pooled.disturbed_objects, 2),
            number(pooled.ever_disturbed_objects, 2),
            share(pooled.temporary_displacement),
            share(pooled.failed_actions),
            number(pooled.object_goal_m, 2),
        ];
        let mut row = vec![
            Cell::text(&group.label),
            Cell::number(result.seeds.len().to_string()),
            Cell::number(count(pooled.episodes)),
            Cell::estimate(&result.success.mean),
            Cell::estimate(&result.success_without_disturbance.mean),
            Cell::estimate(&result.success_without_disturbance_per_axis.mean),
        ];
        row.extend(cells.map(Cell::number));
        table.row(RowKind::Plain, row);
    }
    table
}

/// What the benchmarks of safety ask for, of every group in every field.
fn safety(report: &Report) -> Markup {
    let head = ["group", "episodes of"].map(Cell::text).into_iter();
    let figures = ["SBU", "of successes", "worst severity (m)", "cumulative cost", "exposure (steps)"];
    let mut table = Table::new(head.chain(figures.map(Cell::number)).collect());
    for (group, result) in report.groups.iter().flat_map(|group| group.results.iter().map(move |one| (group, one))) {
        let pooled = &result.pooled;
        let cells = [
            share(pooled.success_but_unsafe),
            share(pooled.unsafe_successes),
            number(pooled.worst_severity_m, 2),
            number(pooled.cumulative_cost, 2),
            number(pooled.exposure_steps, 1),
        ];
        let mut row = vec![Cell::text(&group.label), Cell::text(&result.field)];
        row.extend(cells.map(Cell::number));
        table.row(RowKind::Plain, row);
    }
    html! {
        h3 { "Safety" }
        p {
            "SBU: share of episodes that succeed with d of 0.01 m or more, and the same of the successes; the largest \
             displacement of one object at any time in any episode; steps of an episode that disturb, and steps after \
             which something is displaced by 0.01 m or more."
        }
        (table)
    }
}

/// Precision and recall of the head on the episodes of evaluations; none where no result has them.
pub fn prediction(report: &Report) -> Option<Markup> {
    let head = ["group", "episodes of"].map(Cell::text).into_iter();
    let figures = ["precision", "recall", "recall of quiet steps", "steps"].map(Cell::number);
    let mut table = Table::new(head.chain(figures).collect());
    for group in &report.groups {
        for result in &group.results {
            let Some(prediction) = &result.pooled.disturb_prediction else { continue };
            let counts = prediction.counts;
            let steps = counts.hits + counts.misses + counts.false_alarms + counts.quiet;
            let shares = [prediction.precision, prediction.recall, prediction.recall_of_quiet].map(share);
            let mut row = vec![Cell::text(&group.label), Cell::text(&result.field)];
            row.extend(shares.map(Cell::number));
            row.push(Cell::number(count(steps)));
            table.row(RowKind::Plain, row);
        }
    }
    (!table.is_empty()).then(|| html! { h3 { "In evaluations" } (table) })
}
