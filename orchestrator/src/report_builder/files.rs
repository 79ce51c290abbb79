use crate::comparison::settings::{Row, differences};
use crate::output::format::{self, counted, shown};
use crate::output::name;
use crate::report_builder::gather::Gathered;
use crate::report_builder::strips::strips;
use crate::run::identity::unix_now;
use crate::wrong::{demand, reject};
use anyhow::{Context, Result, anyhow, ensure};
use proto::bounded;
use proto::config::Config;
use proto::run_folder::write_atomically;
use proto::shell::quoted;
use proto::task::{Described, Kind};
use report::comparison::Comparison;
use report::format::{interval, percent};
use report::statistics::{Estimate, Interval};
use report::study::Run;
use report::{FieldResult, GroupReport, Kept, Options, Report};
use serde_json::json;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;
use wire::fault;

pub const PAGE: &str = "report.html";
pub const NUMBERS: &str = "report.json";

/// Everything that a call which was killed may have left.
const BEGUN: [&str; 3] = [NUMBERS, "report.json.partial", "report.html.partial"];

/// Refuses a folder that holds something else than a report. One without a page is of a call that was killed, if it
/// holds the numbers, whole or not, and nothing else that is not ours.
pub fn check_free(out: &Path) -> Result<()> {
    let mut names = Vec::new();
    match std::fs::read_dir(out) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) if error.kind() == std::io::ErrorKind::NotADirectory => {
            reject!("{} is a file: choose a folder with --out", out.display())
        }
        entries => {
            for entry in entries.with_context(|| format!("report folder {}", out.display()))? {
                names.push(entry?.file_name().to_string_lossy().into_owned());
            }
        }
    }
    let has = |name: &str| names.iter().any(|found| found == name);
    let killed = || BEGUN[..2].iter().any(|name| has(name)) && names.iter().all(|name| BEGUN.contains(&name.as_str()));
    demand!(
        names.is_empty() || has(PAGE) || killed(),
        "{} is not empty, and what it holds is no report: choose another folder with --out",
        out.display()
    );
    Ok(())
}

fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| refused("create", folder))
}

/// A run may lie where nobody can write.
fn refused(what: &str, path: &Path) -> String {
    format!("cannot {what} {} (--out puts the report somewhere else)", path.display())
}

/// Makes the report on what was gathered and writes it to `out`: the numbers first, by which the folder is known for a
/// report, the page last. An older report there is replaced.
pub fn write(gathered: Gathered, options: &Options, out: &Path) -> Result<Report> {
    check_free(out)?;
    let Gathered { runs, notes } = gathered;
    let report = Report::of(&runs, options, notes)?;
    let (episodes, undrawn) = strips(&runs);
    make_folder(out)?;
    let put = |name: &str, content: &str| {
        let path = out.join(name);
        write_atomically(&path, content.as_bytes()).with_context(|| refused("write", &path))
    };
    put(NUMBERS, &(serde_json::to_string_pretty(&report).context(NUMBERS)? + "\n"))?;
    let made = format!(
        "made {} by stillroom {} from {}",
        format::date(unix_now()),
        env!("CARGO_PKG_VERSION"),
        counted(runs.len() as u64, "run")
    );
    let has = |of: fn(&Config) -> bool| runs.iter().any(|run| of(&run.config));
    let data = json!({
        "made": made,
        "program": name::called(),
        "drawn": has(|config| config.environment.is_none()),
        "labelled": has(|config| config.label().is_some()),
        "report": report,
        "episodes": episodes,
        "undrawn": undrawn,
        "differences": between(&report, &runs),
    });
    fault::reach("report.before_page");
    put(PAGE, &view::page::report(&data.to_string(), &table(&report)))?;
    Ok(report)
}

/// The settings in which the groups of a report differ, with the value of each group. Seeds stand elsewhere.
fn between(report: &Report, runs: &[Run]) -> Vec<Row> {
    let first =
        |group: &GroupReport| runs.iter().find(|run| run.name == group.runs[0].name).map(|run| run.config.clone());
    let configs: Vec<Config> = report.groups.iter().filter_map(first).collect();
    let mut rows = differences(&configs);
    rows.retain(|row| row.name != "seed" && !row.name.starts_with("evaluation"));
    rows
}

/// A row for each result of a group that is over so many seeds at least: the group, which episodes and how many, and the
/// metrics of its task with their intervals; how these were made, and what a star stands for.
pub fn rows(report: &Report, least: usize) -> (Vec<Vec<String>>, Vec<String>) {
    let mut made = BTreeSet::new();
    let row = |(group, result): (&GroupReport, &FieldResult)| {
        let metric = |one: &Described| {
            let shown = |figure| shown(one, Some(figure));
            let within = interval_of(result, &one.name).map(|(Interval { low, high }, how)| {
                made.insert(how);
                format!(" [{}, {}]", shown(low), shown(high))
            });
            let mean = format::metric(one, Some(result.metrics.get(&one.name)?.mean.point));
            Some(format!("{} {mean}{}", one.label, within.unwrap_or_default()))
        };
        let [seeds, episodes] = [(result.seeds.len() as u64, "seed"), (result.pooled.episodes, "episode")]
            .map(|(count, of)| counted(count, of));
        let metrics = report.tasks[&group.task].shown.iter().filter_map(metric);
        [group.label.clone(), result.name.clone(), seeds, episodes].into_iter().chain(metrics).collect()
    };
    let found = || of_groups(report).filter(|(_, result)| result.seeds.len() >= least);
    let rows = found().map(row).collect();
    let starred = found().map(|(group, _)| group).filter(|group| group.label.contains('*'));
    let other = |GroupReport { label, preset, differences, .. }: &GroupReport| {
        format!("{label} is the preset {preset} with {}", differences.join("; "))
    };
    let other: BTreeSet<String> = starred.map(other).collect();
    (rows, made.into_iter().map(|how| format!("in brackets: {how}")).chain(other).collect())
}

/// The interval of a mean, and how it was made. Those over episodes say nothing of other seeds.
fn interval_of(result: &FieldResult, name: &str) -> Option<(Interval, &'static str)> {
    let over_seeds =
        result.metrics.get(name)?.mean.interval.map(|interval| (interval, "95% interval of a bootstrap over seeds"));
    let of_rate =
        || result.rates.get(name).map(|rate| (rate.interval, "Wilson's 95% interval over these episodes alone"));
    let of_mean = || {
        result.intervals.get(name).map(|interval| (*interval, "95% interval of a bootstrap over these episodes alone"))
    };
    over_seeds.or_else(of_rate).or_else(of_mean)
}

fn of_groups(report: &Report) -> impl Iterator<Item = (&GroupReport, &FieldResult)> {
    report.groups.iter().flat_map(|group| group.results.iter().map(move |result| (group, result)))
}

fn table(report: &Report) -> String {
    let text = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;");
    let rate = |Estimate { point, interval: found }: Estimate| match &found {
        Some(found) => format!("{} {}", percent(point), interval(found)),
        None => percent(point),
    };
    let mut table = "<table><tr><th>group<th>episodes of<th>seeds<th>episodes<th>metrics, shares in %".to_owned();
    for (group, result) in of_groups(report) {
        let (label, seeds, episodes) = (text(&group.label), result.seeds.len(), result.pooled.episodes);
        let described = &report.tasks[&group.task].described;
        let metrics = described.iter().filter_map(|one| Some((one, result.metrics.get(&one.name)?.mean)));
        let cells = metrics.map(|(one, mean)| match one.kind {
            Kind::Share => format!("{} {}", text(&one.label), rate(mean)),
            _ => format!("{} {}", text(&one.label), shown(one, Some(mean.point))),
        });
        let cells = cells.collect::<Vec<_>>().join(", ");
        let _ = write!(table, "<tr><td>{label}<td>{}<td>{seeds}<td>{episodes}<td>{cells}", result.field);
    }
    table + "</table>"
}

/// The scores of the paper's tables over many reports.
pub fn read_table(path: &Path) -> Result<Kept> {
    let (shown, typed) = (path.display(), quoted(path));
    ensure!(path.exists(), "{shown} does not exist: `orchestrator report RUN --table {typed}` writes it");
    let text = bounded::read_text(path).with_context(|| path.display().to_string())?;
    let other =
        || format!("{} keeps no table: name a file that `orchestrator report RUN --table FILE` wrote", path.display());
    serde_json::from_str(&text).map_err(|_| anyhow!(other()))
}

pub fn add_to_table(path: &Path, tables: &[Comparison]) -> Result<Kept> {
    let mut kept = if path.exists() { read_table(path)? } else { Kept::default() };
    kept.add(tables)?;
    let mut text = serde_json::to_string_pretty(&kept).context("plain data")?;
    text.push('\n');
    write_atomically(path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::testing::run;

    #[test]
    fn settings_that_differ_between_groups_have_a_value_of_each() {
        let runs = [run("a-1", 1, 0.1, &[]), run("b", 1, 0.3, &[]), run("a-2", 2, 0.1, &[])];
        let report = Report::of(&runs, &Options::default(), Vec::new()).unwrap();
        let rows = between(&report, &runs);
        assert_eq!((rows.len(), rows[0].name.as_str()), (1, "ppo.clip"), "and not the seed");
        assert_eq!(rows[0].values, [json!(0.1), json!(0.3)]);
        assert_eq!(between(&Report::of(&runs[1..2], &Options::default(), Vec::new()).unwrap(), &runs), []);
    }

    #[test]
    fn the_terminal_has_each_metric_and_says_what_a_star_is() {
        let report =
            Report::of(&[run("a", 1, 0.3, &[false]), run("b", 2, 0.3, &[false])], &Options::default(), Vec::new())
                .unwrap();
        let (rows, said) = rows(&report, 1);
        assert_eq!(rows[0][0], "demo*");
        assert!(rows[0].iter().any(|cell| cell.starts_with("disturbance 0.000 m")), "{rows:?}");
        assert!(said.contains(&"demo* is the preset demo with ppo.clip = 0.3".to_owned()), "{said:?}");
    }

    #[test]
    fn a_folder_is_a_reports_or_empty() {
        let temporary = tempfile::tempdir().unwrap();
        let with = |names: &[&str]| {
            let out = temporary.path().join(names.concat());
            std::fs::create_dir_all(&out).unwrap();
            for name in names {
                std::fs::write(out.join(name), "").unwrap();
            }
            check_free(&out)
        };
        check_free(&temporary.path().join("new")).unwrap();
        for ours in [
            &[][..],
            &["report.json.partial"],
            &["report.json"],
            &["report.json", "report.html.partial"],
            &["report.html", "report.json", "of the user's own"],
        ] {
            with(ours).unwrap();
        }
        let file = temporary.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(make_folder(&file.join("report")).unwrap_err().to_string().contains("--out puts the report"));
        for foreign in [&["report.html.partial"][..], &["report.json", "thesis.tex"], &["run.toml"]] {
            assert!(with(foreign).unwrap_err().to_string().contains("no report"), "{foreign:?}");
        }
    }
}
