//! The section of runs: which there are, and which of their evaluations count.

use super::table::{Cell, RowKind, Table};
use crate::format::{count, interval, percent};
use crate::report::Report;
use crate::results::Rate;
use maud::{Markup, html};

/// Every run, and the evaluations that count.
pub fn section(report: &Report) -> Markup {
    let counting = counting(report);
    html! {
        (runs(report))
        @if !counting.is_empty() {
            h3 { "The evaluations that count" }
            p {
                "Of several evaluations of a run on the same kind of episodes that of the newest checkpoint counts, then \
                 the one with sampled actions, then the one with the most episodes, then the newest. In brackets, \
                 Wilson's 95% interval of that policy's rate over its episodes: it says nothing about other seeds."
            }
            (counting)
        }
    }
}

fn runs(report: &Report) -> Table {
    let mut table = Table::new(vec![
        Cell::text("run"),
        Cell::text("group"),
        Cell::number("seed"),
        Cell::text("state"),
        Cell::number("frames"),
        Cell::number("of"),
        Cell::text("evaluations"),
    ]);
    for group in &report.groups {
        for run in &group.runs {
            let evaluations =
                if run.evaluations.is_empty() { "none yet".to_owned() } else { run.evaluations.join(", ") };
            table.row(
                RowKind::Plain,
                vec![
                    Cell::text(&run.name),
                    Cell::text(&group.label),
                    Cell::number(run.seed.to_string()),
                    Cell::text(run.state.to_string()),
                    Cell::number(count(run.frames)),
                    Cell::number(count(run.budget)),
                    Cell::wide(evaluations),
                ],
            );
        }
    }
    table
}

/// The evaluations that count, a seed each.
fn counting(report: &Report) -> Table {
    let mut table = Table::new(vec![
        Cell::text("episodes of"),
        Cell::text("group"),
        Cell::number("seed"),
        Cell::text("evaluation"),
        Cell::number("frames"),
        Cell::number("episodes"),
        Cell::number("SR"),
        Cell::number("SRwoD"),
        Cell::number("SRwoD (per axis)"),
        Cell::text("weights"),
    ]);
    let rate = |rate: &Rate| Cell::number(percent(rate.share)).over(interval(&rate.interval));
    let results = report.groups.iter().flat_map(|group| group.results.iter().map(move |result| (group, result)));
    let seeds = results.flat_map(|(group, result)| result.seeds.iter().map(move |seed| (group, result, seed)));
    for (group, result, seed) in seeds {
        table.row(
            RowKind::Plain,
            vec![
                Cell::text(&result.field),
                Cell::text(&group.label),
                Cell::number(seed.seed.to_string()),
                Cell::text(&seed.evaluation),
                Cell::number(count(seed.frames)),
                Cell::number(count(seed.episodes)),
                rate(&seed.success),
                rate(&seed.success_without_disturbance),
                rate(&seed.success_without_disturbance_per_axis),
                Cell::text(seed.weights.chars().take(12).collect::<String>()),
            ],
        );
    }
    table
}
