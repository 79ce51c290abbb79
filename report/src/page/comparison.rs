//! The section beside the paper.

use super::table::{Cell, RowKind, Table};
use crate::comparison::{Comparison, Ours, Row};
use crate::format::{count, percent, share};
use crate::paper::Published;
use crate::report::Report;
use maud::{Markup, html};

/// The paper's tables with ours in them; rows of the paper that no group is are folded away, and so is a table of nothing
/// else.
pub fn section(report: &Report) -> Markup {
    let alone = |comparison: &Comparison| comparison.rows.iter().all(|row| row.ours.is_empty());
    html! {
        @if !report.comparisons.iter().all(alone) { (explained(report)) }
        @for comparison in &report.comparisons {
            @let id = format!("table-{}", comparison.name);
            @if alone(comparison) {
                details id=(id) {
                    summary {
                        (comparison.title) ": "
                        span.none { "No group here is a row of this table and evaluated on its episodes." }
                    }
                    (table(comparison, |_| true))
                }
            } @else {
                @let missing = comparison.rows.iter().filter(|row| row.ours.is_empty()).count();
                h3 id=(id) { (comparison.title) }
                (table(comparison, |row| !row.ours.is_empty()))
                @if missing > 0 {
                    details {
                        summary {
                            "The paper's other rows: " (missing) " of " (comparison.rows.len())
                            ", of which no group here is one"
                        }
                        (table(comparison, |row| row.ours.is_empty()))
                    }
                }
            }
        }
    }
}

fn explained(report: &Report) -> Markup {
    html! {
        p {
            "Each row of the paper's tables (" (report.paper) "), and below it, shaded, our runs of its method, with the \
             settings that are not its own. SR: share of successful episodes; SRwoD: successful with a total \
             displacement of all other objects below 0.01 m, the paper's definition; SRwoD (per axis): successful with \
             no other object moved more than 0.01 m on any axis, as the program published with the paper measures it; \
             percentages. In brackets, 95% intervals by a percentile bootstrap of "
            (count(u64::from(report.statistics.resamples)))
            " resamples, stratified by kitchen, over the matrix of seeds × kitchens, as rliable defines them; one seed \
             alone has none. The paper's IQM is the mean of the middle three of five seeds: ours by that definition \
             stands in the column “IQM of seeds”, while “IQM” is the interquartile mean over all seeds × kitchens."
        }
    }
}

fn table(comparison: &Comparison, shown: impl Fn(&Row) -> bool) -> Table {
    let mut head: Vec<Cell> = comparison.columns.iter().map(|name| Cell::text(*name)).collect();
    head.push(Cell::number("seeds"));
    for _ in 0..2 {
        head.extend(["mean", "IQM", "IQM of seeds"].map(Cell::number));
    }
    head.push(Cell::number("mean"));
    let spans = vec![(comparison.columns.len() + 1, ""), (3, "SR"), (3, "SRwoD"), (1, "SRwoD (per axis)")];
    let mut table = Table::new(head).spans(spans);
    for row in comparison.rows.iter().filter(|row| shown(row)) {
        published_row(&mut table, row);
        for ours in &row.ours {
            our_row(&mut table, comparison.columns.len(), ours);
        }
    }
    table
}

fn published_row(table: &mut Table, row: &Row) {
    let Published { success, success_iqm, success_without_disturbance, success_without_disturbance_iqm } = row.paper;
    let (kind, seeds) = if row.ours.is_empty() { (RowKind::NotRun, "not run") } else { (RowKind::Plain, "paper") };
    let mut cells: Vec<Cell> = row.what.iter().map(Cell::text).collect();
    cells.push(Cell::number(seeds));
    for (mean, iqm) in [(success, success_iqm), (success_without_disturbance, success_without_disturbance_iqm)] {
        cells.extend([percent(mean), String::new(), share(iqm)].map(Cell::number));
    }
    cells.push(Cell::number(""));
    table.row(kind, cells);
}

fn our_row(table: &mut Table, columns: usize, ours: &Ours) {
    let frames = match ours.frames {
        (low, high) if low == high => count(low),
        (low, high) => format!("{} to {}", count(low), count(high)),
    };
    let best = if ours.field.ends_with("-best") { "best checkpoint " } else { "" };
    let what = Cell::text(format!("ours: {}, {best}after {frames} frames", ours.group));
    let mut cells = vec![what.over(ours.differences.join("; ")).across(columns)];
    cells.push(Cell::number(ours.success.seeds.to_string()));
    for aggregate in [ours.success, ours.success_without_disturbance] {
        cells.push(Cell::estimate(&aggregate.mean));
        cells.push(Cell::estimate(&aggregate.iqm));
        cells.push(Cell::number(percent(aggregate.iqm_of_seeds)));
    }
    cells.push(Cell::estimate(&ours.success_without_disturbance_per_axis.mean));
    table.row(RowKind::Ours, cells);
}
