//! The report as one HTML page that needs nothing but itself.

mod table;

use crate::chart::{Figure, escape};
use crate::format::{NOTHING, count, interval, number, percent, share};
use crate::report::{FigureSet, GroupReport, Made, Report};
use crate::results::{FieldResult, Rate};
use crate::statistics::Estimate;
use crate::study::{Field, NOT_GIVEN, UNKNOWN};
use crate::tables::{Comparison, Ours, Published, Row};
use std::fmt::Write;
use table::{Cell, Table};

const STYLE: &str = include_str!("style.css");

/// Sections of the page: anchor and heading.
const SECTIONS: [(&str, &str); 10] = [
    ("groups", "Results"),
    ("paper", "Beside the paper"),
    ("training", "Learning curves"),
    ("optimisation", "Optimisation"),
    ("validation", "Validation during training"),
    ("disturbance", "Success and disturbance"),
    ("sweep", "λ_disturb"),
    ("prediction", "Disturbance prediction"),
    ("actions", "Actions by step"),
    ("runs", "Runs and evaluations"),
];

impl Made {
    /// The page. `made` says when and by what.
    pub fn page(&self, made: &str) -> String {
        let Self { report, figures } = self;
        let links: Vec<String> =
            SECTIONS.iter().map(|(anchor, heading)| format!("<a href=\"#{anchor}\">{}</a>", escape(heading))).collect();
        let mut html = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width\">\n<title>Stillroom report</title>\n\
             <style>\n{STYLE}</style>\n</head>\n<body>\n<h1>Stillroom report</h1>\n<p>{}</p>\n<nav>{}</nav>\n",
            escape(made),
            links.join("\n")
        );
        for sentence in &report.episodes {
            let _ = writeln!(html, "<p class=\"episodes\">{}</p>", escape(sentence));
        }
        if !report.notes.is_empty() {
            html.push_str("<h3>Before you trust these figures</h3>\n<ul>\n");
            for note in &report.notes {
                let _ = writeln!(html, "<li>{}</li>", escape(note));
            }
            html.push_str("</ul>\n");
        }
        for (anchor, heading) in SECTIONS {
            let _ = writeln!(html, "<h2 id=\"{anchor}\">{}</h2>", escape(heading));
            html.push_str(&section(anchor, report, figures));
        }
        html.push_str("</body>\n</html>\n");
        html
    }
}

fn section(anchor: &str, report: &Report, figures: &FigureSet) -> String {
    match anchor {
        "groups" => groups(report, figures),
        "paper" => beside_the_paper(report),
        "training" => {
            let otherwise = "None of these runs has trained a rollout (metrics.jsonl is empty).";
            drawn(&figures.learning, &of_training(report, otherwise))
        }
        "optimisation" => {
            let otherwise = "None of these runs has noted an update (metrics.jsonl is empty).";
            drawn(&figures.optimisation, &of_training(report, otherwise))
        }
        "validation" => {
            let otherwise =
                "None of these runs was evaluated during training (the table [validation] of its configuration).";
            drawn(&figures.validation, &of_training(report, otherwise))
        }
        "disturbance" => drawn(&figures.disturbance, NOT_EVALUATED),
        "sweep" => drawn(
            &figures.sweep,
            "No two of these groups differ in λ_disturb alone and are evaluated on the same episodes. The presets \
             lambda-0, lambda-1, lambda-5, ..., lambda-25 are the paper's sweep.",
        ),
        "prediction" => {
            let otherwise =
                "None of these runs trained the auxiliary task disturb, whose focal loss these curves are about.";
            drawn(&figures.prediction, &of_training(report, otherwise)) + &prediction_table(report)
        }
        "actions" => drawn(&figures.actions, NOT_EVALUATED),
        _ => runs(report),
    }
}

const NOT_EVALUATED: &str =
    "None of these runs has been evaluated yet: orchestrator eval RUN --split test --objects novel.";

/// Why there is no figure about training: where a run is not there but evaluations of its weights are, nobody has said
/// what it trained.
fn of_training(report: &Report, otherwise: &str) -> String {
    let mut runs = report.groups.iter().flat_map(|group| &group.runs);
    if runs.any(|run| [NOT_GIVEN, UNKNOWN].contains(&run.state.as_str())) {
        "Evaluations stand here without the runs that trained their weights; what was noted in training lies in a run's \
         own folder: name that folder, too."
            .to_owned()
    } else {
        otherwise.to_owned()
    }
}

fn missing(what: &str) -> String {
    format!("<p class=\"missing\">{}</p>\n", escape(what))
}

fn drawn(figures: &[Figure], otherwise: &str) -> String {
    if figures.is_empty() {
        return missing(otherwise);
    }
    format!("<div class=\"figures\">\n{}</div>\n", figures.iter().map(figure).collect::<String>())
}

/// A figure's panels, which the page places side by side as its width allows, under the legend that they share.
fn figure(figure: &Figure) -> String {
    let class = match (figure.columns, figure.panels.len()) {
        (1, _) => "wide",
        (_, 1 | 2) => "pair",
        _ => "many",
    };
    let keys = figure.legend_keys();
    let keys = keys.iter().map(|(key, name)| format!("<span>{key} {}</span>\n", escape(name)));
    let legend = if figure.legend.is_empty() {
        String::new()
    } else {
        format!("<div class=\"legend\">\n{}</div>\n", keys.collect::<String>())
    };
    format!(
        "<figure id=\"{name}\" class=\"{class}\">\n{legend}<div class=\"panels\">\n{}</div>\n<figcaption>{} \
         <code>figures/{name}.svg</code></figcaption>\n</figure>\n",
        figure.panel_svgs().concat(),
        escape(&figure.caption),
        name = figure.name,
    )
}

fn beside_the_paper(report: &Report) -> String {
    let explained = format!(
        "<p>Each row of the paper's tables ({}), and below it, shaded, our runs of its method, with the settings that are \
         not its own. SR: share of successful episodes; SRwoD: successful with a total displacement of all other objects \
         below 0.01 m, the paper's definition; SRwoD (per axis): successful with no other object moved more than 0.01 m on \
         any axis, as the program published with the paper measures it; percentages. In brackets, 95% intervals by a \
         percentile bootstrap of {} resamples, stratified by kitchen, over the matrix of seeds × kitchens, as rliable defines them; one seed alone has none. The paper's IQM is the mean \
         of the middle three of five seeds: ours by that definition stands in the column “IQM of seeds”, while “IQM” is the \
         interquartile mean over all seeds × kitchens.</p>\n",
        escape(&report.paper),
        count(u64::from(report.statistics.resamples))
    );
    let alone = |comparison: &Comparison| comparison.rows.iter().all(|row| row.ours.is_empty());
    let mut html = if report.comparisons.iter().all(alone) { String::new() } else { explained };
    for comparison in &report.comparisons {
        let (name, title) = (&comparison.name, escape(&comparison.title));
        let table = comparison_table(comparison).html();
        if alone(comparison) {
            // A table of the paper alone is folded into a line.
            let _ = writeln!(
                html,
                "<details id=\"table-{name}\">\n<summary>{title}: <span class=\"none\">No group here is a row of this table \
                 and evaluated on its episodes.</span></summary>\n{table}</details>"
            );
        } else {
            let _ = writeln!(html, "<h3 id=\"table-{name}\">{title}</h3>\n{table}");
        }
    }
    html
}

fn comparison_table(comparison: &Comparison) -> Table {
    let mut head: Vec<Cell> = comparison.columns.iter().map(|name| Cell::text(*name)).collect();
    head.push(Cell::number("seeds"));
    for _ in 0..2 {
        head.extend(["mean", "IQM", "IQM of seeds"].map(Cell::number));
    }
    head.push(Cell::number("mean"));
    let spans = vec![(comparison.columns.len() + 1, ""), (3, "SR"), (3, "SRwoD"), (1, "SRwoD (per axis)")];
    let mut table = Table::new(head).spans(spans);
    for row in &comparison.rows {
        published_row(&mut table, row);
        for ours in &row.ours {
            our_row(&mut table, comparison.columns.len(), ours);
        }
    }
    table
}

fn published_row(table: &mut Table, row: &Row) {
    let Published { success, success_iqm, success_without_disturbance, success_without_disturbance_iqm } = row.paper;
    let mut cells: Vec<Cell> = row.what.iter().map(Cell::text).collect();
    cells.push(Cell::number(if row.ours.is_empty() { "not run" } else { "paper" }));
    for (mean, iqm) in [(success, success_iqm), (success_without_disturbance, success_without_disturbance_iqm)] {
        cells.extend([percent(mean), String::new(), share(iqm)].map(Cell::number));
    }
    cells.push(Cell::number(""));
    table.row(if row.ours.is_empty() { "absent" } else { "" }, cells);
}

fn our_row(table: &mut Table, columns: usize, ours: &Ours) {
    let frames = match ours.frames {
        (low, high) if low == high => count(low),
        (low, high) => format!("{} to {}", count(low), count(high)),
    };
    let what = Cell::text(format!("ours: {}, after {frames} frames", ours.group));
    let mut cells = vec![what.over(ours.differences.join("; ")).across(columns)];
    cells.push(Cell::number(ours.success.seeds.to_string()));
    for aggregate in [ours.success, ours.success_without_disturbance] {
        cells.push(estimated(&aggregate.mean));
        cells.push(estimated(&aggregate.iqm));
        cells.push(Cell::number(percent(aggregate.iqm_of_seeds)));
    }
    cells.push(estimated(&ours.success_without_disturbance_per_axis.mean));
    table.row("ours", cells);
}

/// A figure with its interval beneath.
fn estimated(estimate: &Estimate) -> Cell {
    let cell = Cell::number(percent(estimate.point));
    match &estimate.interval {
        Some(found) => cell.over(interval(found)),
        None => cell,
    }
}

/// Every group in every field, with the figures that the paper's tables do not have.
fn groups(report: &Report, figures: &FigureSet) -> String {
    let mut list = Table::new(["group", "seeds", "settings that are not the preset's"].map(Cell::text).to_vec());
    for group in &report.groups {
        let seeds: Vec<String> = group.runs.iter().map(|run| run.seed.to_string()).collect();
        let differences = if group.differences.is_empty() { NOTHING.to_owned() } else { group.differences.join("; ") };
        list.row("", vec![Cell::text(&group.label), Cell::text(seeds.join(", ")), Cell::wide(differences)]);
    }
    let star = report.groups.iter().any(|group| !group.differences.is_empty());
    let star = if star { "<p>A star: the group has other settings than its preset.</p>\n" } else { "" };
    // The groups and what each field says of them, side by side where the page is wide enough.
    let mut tables = format!("<div>\n<h3>Groups</h3>\n{}{star}</div>\n", list.html());
    let mut any = false;
    for field in Field::ALL {
        let found: Vec<(&GroupReport, &FieldResult)> = report
            .groups
            .iter()
            .filter_map(|group| Some((group, group.results.iter().find(|result| result.field == field.key())?)))
            .collect();
        if found.is_empty() {
            continue;
        }
        any = true;
        let _ = write!(tables, "<div>\n<h3>{}</h3>\n{}</div>\n", escape(&field.name()), field_table(&found).html());
    }
    let mut html = format!("<div class=\"tables\">\n{tables}</div>\n");
    if any {
        html.push_str(FIGURES);
        html.push_str(&drawn(&figures.intervals, NOT_EVALUATED));
    } else {
        html.push_str(&missing(NOT_EVALUATED));
    }
    html
}

/// What the columns of [`field_table`] are.
const FIGURES: &str = "<p>Means over all episodes of all seeds together: pick-ups; steps of an episode; d, the total \
    displacement of all other objects at the end; how many objects are more than 0.01 m from their place at the end, and \
    how many were at some time; “back again”, the share of the successful episodes in which something was away from its \
    place and is back at the end; actions that failed; the distance from target to goal at the end.</p>\n";

fn field_table(found: &[(&GroupReport, &FieldResult)]) -> Table {
    let mut head = vec![Cell::text("group"), Cell::number("seeds"), Cell::number("episodes")];
    head.extend(["SR", "SRwoD", "SRwoD (per axis)"].map(Cell::number));
    head.extend(
        ["picked up", "steps", "d (m)", "disturbed", "ever", "back again", "failed", "goal (m)"].map(Cell::number),
    );
    let mut table = Table::new(head);
    for (group, result) in found {
        let pooled = &result.pooled;
        let cells = [
            share(pooled.picked_up),
            number(pooled.length, 1),
            number(pooled.disturbance_m, 3),
            number(pooled.disturbed_objects, 2),
            number(pooled.ever_disturbed_objects, 2),
            share(pooled.temporarily_displacing_successes),
            share(pooled.failed_actions),
            number(pooled.object_goal_m, 2),
        ];
        let mut row = vec![
            Cell::text(&group.label),
            Cell::number(result.seeds.len().to_string()),
            Cell::number(count(pooled.episodes)),
            estimated(&result.success.mean),
            estimated(&result.success_without_disturbance.mean),
            estimated(&result.success_without_disturbance_per_axis.mean),
        ];
        row.extend(cells.map(Cell::number));
        table.row("", row);
    }
    table
}

/// Precision and recall of the head on the episodes of evaluations.
fn prediction_table(report: &Report) -> String {
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
            table.row("", row);
        }
    }
    if table.is_empty() { String::new() } else { format!("<h3>In evaluations</h3>\n{}", table.html()) }
}

fn runs(report: &Report) -> String {
    runs_table(report).html() + &counting(report)
}

fn runs_table(report: &Report) -> Table {
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
                "",
                vec![
                    Cell::text(&run.name),
                    Cell::text(&group.label),
                    Cell::number(run.seed.to_string()),
                    Cell::text(&run.state),
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
fn counting(report: &Report) -> String {
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
            "",
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
    if table.is_empty() {
        return String::new();
    }
    format!(
        "<h3>The evaluations that count</h3>\n<p>Of several evaluations of a run on the same kind of episodes that \
         of the newest checkpoint counts, then the one with sampled actions, then the one with the most episodes, then \
         the newest. In brackets, Wilson's 95% \
         interval of that policy's rate over its episodes: it says nothing about other seeds.</p>\n{}",
        table.html()
    )
}
