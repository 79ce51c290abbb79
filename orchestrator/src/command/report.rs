use crate::comparison::row::Row;
use crate::output::format::counted;
use crate::output::terminal;
use crate::report_builder::files::{NUMBERS, PAGE, add_to_table, check_free, read_table, rows, unfinished, write};
use crate::report_builder::gather::gather;
use crate::run::identity::no_folder;
use crate::suite;
use crate::wrong::{demand, judged};
use anyhow::Result;
use proto::shell::quoted;
use report::study::Origin;
use report::{GroupReport, Options, Report};
use std::path::{Path, PathBuf};

/// Put runs and their evaluations on one page, beside the paper's figures
///
/// Writes report.html, one page that needs no network and saves each of its charts as PNG and CSV, and report.json with
/// every number. Runs that differ in the seed only are one group; means have 95% stratified-bootstrap intervals over its
/// seeds. Where a run has recorded evaluations of weights from before stage II and from after it (`eval --record all`),
/// the page shows one episode of both in pictures. What is missing, such as runs that were not evaluated, is listed on
/// the page.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # three seeds or three methods: it sees which
  orchestrator report runs/a runs/b runs/c
  # everything below two folders
  orchestrator report runs evaluations --out report
  orchestrator report runs --json | jq '.groups[] | {label, results}'
  # adds its runs to the paper's tables
  orchestrator report runs/paper --table docs/results/paper.json
  orchestrator report runs/a --threshold 0.01 --threshold 0.05 --threshold 0.1")]
pub struct ReportArgs {
    /// Run folders, evaluation folders, or folders that hold such
    #[arg(value_name = "RUN", required_unless_present = "table")]
    runs: Vec<PathBuf>,
    /// Folder of the report, new, empty, or with an older report [default: RUN/report of one folder, else
    /// runs/report]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Threshold of the task's first curve, such as success within a displacement, metres; repeat it for each point [default:
    /// those that the task declares]
    #[arg(long = "threshold", value_name = "METRES", value_parser = limit)]
    thresholds: Vec<f32>,
    /// The paper's main tables over many reports: adds the scores of these runs to FILE, which keeps those of earlier ones
    /// (kilobytes), and prints the tables of all in Markdown; without RUN it only prints
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    table: Option<PathBuf>,
    /// Print the numbers, those of report.json, as one JSON object
    #[arg(long)]
    json: bool,
}

pub fn run(args: &ReportArgs) -> Result<()> {
    if let (Some(table), []) = (&args.table, args.runs.as_slice()) {
        terminal::out(judged(read_table(table))?.markdown()?.trim_end());
        return Ok(());
    }
    for run in &args.runs {
        demand!(!run.is_file(), "{}", no_folder(run));
    }
    let out = args.out.clone().unwrap_or_else(|| default_folder(&args.runs));
    let is_file = out.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("html"));
    demand!(!is_file, "--out {} is to be a folder, for {PAGE} and {NUMBERS}: leave out .html", out.display());
    check_free(&out)?;
    // Groups are in the order of a suite's file, as on its page.
    let mut given = Vec::new();
    for run in &args.runs {
        if suite::is_suite(run) {
            given.extend(suite::begun(run)?);
        }
        given.push(run.clone());
    }
    let gathered = gather(&given, &args.runs)?;
    let runs = gathered.runs.len();
    let subject = if let [one] = &args.runs[..] { Some(one.as_path()) } else { None };
    let (report, differences) = write(gathered, &options(&args.thresholds)?, subject, &out)?;
    if args.json {
        terminal::out_json(&report)?;
    } else if let Some(table) = &args.table {
        terminal::out(add_to_table(table, &report.comparisons)?.markdown()?.trim_end());
    } else {
        print(&report);
        terminal::out_wrapped(&standing(&report, runs, &differences).join("\n"));
        terminal::out(&format!("numbers: {}", out.join(NUMBERS).display()));
        terminal::out(&format!("page: {}", out.join(PAGE).display()));
    }
    for line in report.episodes.iter().chain(&report.notes) {
        terminal::note(line);
    }
    Ok(())
}

/// How much of it is evaluated, in what groups differ, and what makes the first evaluation that is missing.
fn standing(report: &Report, runs: usize, differences: &[Row]) -> Vec<String> {
    let without: Vec<&GroupReport> = report.groups.iter().filter(|group| group.results.is_empty()).collect();
    let evaluated = report.groups.len() - without.len();
    let mut lines = Vec::new();
    if runs > 1 || evaluated == 0 {
        let groups = counted(report.groups.len() as u64, "group");
        let labels = without.iter().map(|group| format!("{}{}", group.label, unfinished(group.runs.iter())));
        let labels = labels.collect::<Vec<_>>().join(", ");
        let others = if without.is_empty() { String::new() } else { format!("; not evaluated: {labels}") };
        lines.push(format!("{} in {groups}; groups evaluated: {evaluated}{others}", counted(runs as u64, "run")));
    }
    lines.extend(apart(&report.groups, differences));
    let mut missing = without.iter().flat_map(|group| &group.runs);
    if let Some(run) = missing.find(|run| matches!(run.state, Origin::Run(_)) && run.evaluations.is_empty()) {
        lines.push(format!("`orchestrator eval {}` makes an evaluation", quoted(&run.name)));
    }
    lines
}

const FEW: usize = 4;

/// Why runs are not one group, where that is short.
fn apart(groups: &[GroupReport], differences: &[Row]) -> Option<String> {
    let settings: Vec<&str> = differences.iter().map(|row| row.name.as_str()).collect();
    let labels = match groups {
        [one, other] => format!("{} and {}", one.label, other.label),
        _ => "they".to_owned(),
    };
    (1..=FEW).contains(&settings.len()).then(|| format!("{labels} differ in {}", settings.join(", ")))
}

pub fn print(report: &Report) {
    let (rows, intervals) = rows(report);
    terminal::out_table(&rows);
    for line in intervals {
        terminal::out_wrapped(&line);
    }
}

/// Where the report goes that names no folder: where runs are, because a checkout has a folder `report` of its own.
fn default_folder(runs: &[PathBuf]) -> PathBuf {
    match runs {
        [one] => one.join("report"),
        _ => Path::new("runs").join("report"),
    }
}

fn limit(text: &str) -> Result<f32, String> {
    let remedy = "expected a number without its unit (metres), and each by itself: --threshold 0.01 --threshold 0.05";
    text.parse().map_err(|_| remedy.to_owned())
}

fn options(thresholds: &[f32]) -> Result<Options> {
    if thresholds.is_empty() {
        return Ok(Options::default());
    }
    for threshold in thresholds {
        demand!(threshold.is_finite() && *threshold > 0.0, "--threshold {threshold}: a threshold is a positive number");
    }
    let mut sorted = thresholds.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted.dedup();
    Ok(Options { limits: Some(sorted) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comparison::settings::differences;
    use crate::evaluation::testing::run;
    use proto::run_state::RunState;
    use report::study::Run;

    #[test]
    fn a_report_that_names_no_folder_has_one_in_a_checkout() {
        let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let several = default_folder(&["runs/a".into(), "runs/b".into()]);
        check_free(&checkout.join(several)).unwrap();
        assert_eq!(default_folder(&["runs/a".into()]), Path::new("runs/a/report"));
    }

    #[test]
    fn what_is_not_evaluated_is_named_and_why_runs_are_not_one_group() {
        let lines = |runs: &[Run]| {
            let differences = differences(&runs.iter().map(|run| run.config.clone()).collect::<Vec<_>>());
            standing(&Report::of(runs, &Options::default(), Vec::new()).unwrap(), runs.len(), &differences)
        };
        let mut runs = [run("a/one", 1, 0.1, &[false, true]), run("a/two", 1, 0.2, &[]), run("b/two", 1, 0.3, &[])];
        let eval = "`orchestrator eval a/two` makes an evaluation";
        let all = [
            "3 runs in 3 groups; groups evaluated: 1; not evaluated: a/two (not started at 0 of 420,000 frames), b/two (not \
             started at 0 of 420,000 frames)",
            "they differ in ppo.clip",
            eval,
        ];
        assert_eq!(lines(&runs), all);
        assert_eq!(
            lines(&runs[1..2]),
            ["1 run in 1 group; groups evaluated: 0; not evaluated: two (not started at 0 of 420,000 frames)", eval]
        );
        assert_eq!(lines(&[run("a", 1, 0.1, &[false])]), [""; 0]);
        assert_eq!(lines(&runs[..2])[1], "one and two differ in ppo.clip");
        runs[1].origin = Origin::Run(RunState::CutOff);
        assert!(lines(&runs[..2])[0].ends_with("two (cut off at 0 of 420,000 frames)"), "{:?}", lines(&runs[..2]));
    }

    #[test]
    fn thresholds_are_positive_and_in_order() {
        assert_eq!(options(&[0.1, 0.01, 0.1]).unwrap().limits, Some(vec![0.01, 0.1]));
        assert_eq!(options(&[]).unwrap(), Options::default());
        assert!(limit("1cm").unwrap_err().contains("without its unit") && limit("0.01") == Ok(0.01));
        for wrong in [0.0, -1.0, f32::NAN] {
            assert!(options(&[wrong]).unwrap_err().to_string().contains("--threshold"));
        }
    }
}
