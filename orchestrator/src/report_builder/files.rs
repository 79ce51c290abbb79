use crate::comparison::row::Row;
use crate::comparison::settings::differences;
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
use proto::run_state::{Ending, RunState};
use proto::shell::quoted;
use proto::task::{Described, Kind};
use report::comparison::Comparison;
use report::format::{interval, percent};
use report::statistics::{Estimate, Interval};
use report::study::{Origin, Run};
use report::{FieldResult, GroupReport, Kept, Options, Report, RunReport};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
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
/// report, the page last. An older report there is replaced. With the settings in which its groups differ. `subject`: the one
/// folder that it is of.
pub fn write(gathered: Gathered, options: &Options, subject: Option<&Path>, out: &Path) -> Result<(Report, Vec<Row>)> {
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
    let differences = between(&report, &runs);
    let data = json!({
        "made": made,
        "name": subject.and_then(Path::file_name).map(|name| name.to_string_lossy()),
        "program": name::called(),
        "drawn": has(|config| config.environment.is_none()),
        "labelled": has(|config| config.label().is_some()),
        "report": report,
        "episodes": episodes,
        "undrawn": undrawn,
        "differences": differences,
    });
    fault::reach("report.before_page");
    put(PAGE, &view::page::report(&data.to_string(), &table(&report)))?;
    Ok((report, differences))
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

/// A row for each result of a group: the group, which episodes and how many, and the metrics of its task with their
/// intervals; then how these were made, and what a star stands for.
pub fn rows(report: &Report) -> (Vec<Vec<String>>, Vec<String>) {
    let mut made: BTreeMap<Made, (Vec<&str>, BTreeSet<u64>)> = BTreeMap::new();
    let mut row = |(group, result): (&GroupReport, &FieldResult)| {
        let (seeds, episodes) = (result.seeds.len() as u64, result.pooled.episodes);
        let described: Vec<&Described> = report.tasks[&group.task].shown.iter().collect();
        let mut metrics = Vec::new();
        for one in described {
            let Some(metric) = result.metrics.get(&one.name) else { continue };
            let shown = |figure| shown(one, Some(figure));
            let within = interval_of(result, &one.name).map(|(Interval { low, high }, how)| {
                let (labels, over) = made.entry(how).or_default();
                if !labels.contains(&one.label.as_str()) {
                    labels.push(&one.label);
                }
                over.insert(if how == Made::OverSeeds { seeds } else { episodes });
                format!(" [{}, {}]", shown(low), shown(high))
            });
            let mean = format::metric(one, Some(metric.mean.point));
            metrics.push(format!("{} {mean}{}", one.label, within.unwrap_or_default()));
        }
        let runs = group.runs.iter().filter(|run| result.seeds.iter().any(|seed| seed.run == run.name));
        let seeds = format!("{}{}", counted(seeds, "seed"), unfinished(runs));
        let first = [group.label.clone(), result.name.clone(), seeds, counted(episodes, "episode")];
        first.into_iter().chain(metrics).collect()
    };
    let rows = of_groups(report)
        .map(&mut row)
        .chain(report.groups.iter().filter_map(|group| trained(report, group)))
        .collect();
    let starred = report.groups.iter().filter(|group| group.label.contains('*'));
    let other = |GroupReport { label, preset, differences, .. }: &GroupReport| {
        format!("{label} is the preset {preset} with {}", differences.join("; "))
    };
    let other: BTreeSet<String> = starred.map(other).collect();
    let ways = made.iter().map(|(how, (labels, over))| format!("{}: {}", labels.join(", "), how.text(over)));
    let ways = ways.collect::<Vec<_>>().join("; ");
    let ways = (!ways.is_empty()).then(|| format!("in brackets, 95% intervals. {ways}"));
    (rows, ways.into_iter().chain(other).collect())
}

/// The row of a group that was not evaluated: what its training came to.
fn trained(report: &Report, group: &GroupReport) -> Option<Vec<String>> {
    let stage = group.stages.iter().rfind(|stage| group.results.is_empty() && !stage.figures.is_empty())?;
    let known = report.tasks[&group.task].shown.iter().filter_map(|one| Some((one, *stage.figures.get(&one.name)?)));
    let metrics = known.map(|(one, figure)| format!("{} {}", one.label, format::metric(one, Some(figure))));
    let seeds = format!("{}{}", counted(group.runs.len() as u64, "seed"), unfinished(group.runs.iter()));
    let what = format!("training, newest tenth of stage {}", stage.name);
    Some([group.label.clone(), what, seeds].into_iter().chain(metrics).collect())
}

/// The states of runs that are not complete, in brackets; nothing where all are.
pub fn unfinished<'a>(runs: impl Iterator<Item = &'a RunReport>) -> String {
    let (mut all, mut states) = (0, Vec::new());
    for run in runs {
        all += 1;
        if let Origin::Run(state) = &run.state
            && *state != RunState::Ended(Ending::Complete)
        {
            states.push(format!("{state} at {} of {} frames", format::count(run.frames), format::count(run.budget)));
        }
    }
    match states.as_slice() {
        [] => String::new(),
        [one] if all == 1 => format!(" ({one})"),
        some => format!(" ({} of them not complete: {})", some.len(), some.join(", ")),
    }
}

/// How an interval was made. Those over episodes say nothing of other seeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Made {
    OverSeeds,
    OfShare,
    OfMean,
}

impl Made {
    fn text(self, over: &BTreeSet<u64>) -> String {
        let of = if self == Self::OverSeeds { "seed" } else { "episode" };
        let most = over.last().map(|&most| format::counted(most, of)).unwrap_or_default();
        let least = over.first().filter(|_| over.len() > 1).map(|&least| format::count(least));
        let between = if over.len() > 2 { "to" } else { "or" };
        let counts = least.map_or_else(|| most.clone(), |least| format!("{least} {between} {most}"));
        match self {
            Self::OverSeeds if over.contains(&2) => format!("bootstrap over {counts}, too narrow where there are two"),
            Self::OverSeeds => format!("bootstrap over {counts}"),
            Self::OfShare => format!("Wilson's over {counts} alone"),
            Self::OfMean => format!("bootstrap over {counts} alone"),
        }
    }
}

fn interval_of(result: &FieldResult, name: &str) -> Option<(Interval, Made)> {
    let over_seeds = result.metrics.get(name)?.mean.interval.map(|interval| (interval, Made::OverSeeds));
    let of_share = || result.rates.get(name).map(|rate| (rate.interval, Made::OfShare));
    let of_mean = || result.intervals.get(name).map(|interval| (*interval, Made::OfMean));
    over_seeds.or_else(of_share).or_else(of_mean)
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
        let runs = [("a", 1), ("b", 2)].map(|(name, seed)| run(name, seed, 0.3, &[false]));
        let runs = runs.map(|run| Run { origin: Origin::NotGiven, ..run });
        let report = Report::of(&runs, &Options::default(), Vec::new()).unwrap();
        let (rows, said) = rows(&report);
        assert_eq!(rows[0][0], "demo*");
        assert_eq!(said[0], "in brackets, 95% intervals. SR, SRwoD: Wilson's over 2 episodes alone");
        let over = |seeds: &[u64]| Made::OverSeeds.text(&seeds.iter().copied().collect());
        assert_eq!(over(&[2]), "bootstrap over 2 seeds, too narrow where there are two");
        assert_eq!(over(&[5, 3]), "bootstrap over 3 or 5 seeds");
        assert_eq!(Made::OfMean.text(&[1].into()), "bootstrap over 1 episode alone");
        assert_eq!(Made::OfShare.text(&[360, 5, 30].into()), "Wilson's over 5 to 360 episodes alone");
        let mut begun = report.groups[0].runs.clone();
        begun[0].state = Origin::Run(RunState::CutOff);
        assert_eq!(unfinished(begun[..1].iter()), " (cut off at 0 of 420,000 frames)");
        assert_eq!(unfinished(begun.iter()), " (1 of them not complete: cut off at 0 of 420,000 frames)");
        assert_eq!(unfinished(begun[1..].iter()), "");
        assert!(rows[0].iter().any(|cell| cell.starts_with("disturbance 0.000 m")), "{rows:?}");
        let star = "demo* is the preset demo with ppo.clip = 0.3".to_owned();
        assert!(said.contains(&star), "{said:?}");
        // Of what was not evaluated it has what the training came to.
        let mut alone = runs[0].clone();
        alone.evaluations.clear();
        alone.stages = vec![[("success".to_owned(), 0.25)].into(), BTreeMap::new()];
        let (rows, said) = super::rows(&Report::of(&[alone], &Options::default(), Vec::new()).unwrap());
        assert_eq!(rows, [["demo*", "training, newest tenth of stage I", "1 seed", "SR 25.0%"]]);
        assert_eq!(said, [star]);
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
