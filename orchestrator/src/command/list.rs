use crate::output::format::{self, NOTHING};
use crate::output::terminal;
use crate::run::identity::{no_folder, unix_now};
use crate::viewer::RunReaders;
use crate::wrong::demand;
use anyhow::Result;
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::time::Duration;
use view::data::{Card, Runs, SuiteStanding};

pub const RUNS: &str = "runs";
/// Where evaluations stand: in their run, or beside `runs` those of policy files.
pub const EVALUATIONS: &str = "evaluations";

/// List runs and evaluations with their state, the newest first. Times are UTC
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator list
  orchestrator list /data/runs --json \\
    | jq -r '.[] | select(.state == \"running\") | .folder'")]
pub struct ListArgs {
    /// Folders that hold runs, or runs [default: runs and evaluations]
    #[arg(value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Print one JSON array
    #[arg(long)]
    json: bool,
}

pub fn run(args: &ListArgs) -> Result<()> {
    for folder in &args.folders {
        demand!(!folder.is_file(), "{}", no_folder(folder));
        demand!(folder.is_dir(), "{} is not a folder: give one that holds runs", folder.display());
    }
    let usual = || [RUNS, EVALUATIONS].map(PathBuf::from).into_iter().filter(|folder| folder.exists()).collect();
    let folders = if args.folders.is_empty() { usual() } else { args.folders.clone() };
    let cards = if folders.is_empty() { vec![] } else { RunReaders::once(folders).list() };
    if args.json {
        return Ok(terminal::out_json(&cards)?);
    }
    print(&cards);
    Ok(())
}

pub fn print(cards: &[Card]) {
    if cards.is_empty() {
        terminal::note("no run yet: `orchestrator up` starts one");
    }
    terminal::out_table(&rows(cards));
    note(cards);
}

/// A row for each card, and for each suite before the newest of its cards. One run's evaluations stand without its suite.
fn rows(cards: &[Card]) -> Vec<Vec<String>> {
    let (mut rows, mut suites) = (Vec::new(), BTreeSet::new());
    let has_runs = cards.iter().any(|card| !card.evaluation);
    for card in cards {
        let suite = card.suite_standing.as_ref().filter(|suite| has_runs && suites.insert(&suite.folder));
        if let Some(SuiteStanding { folder, counts, .. }) = suite {
            // As the card's folder is named.
            let up = if card.evaluation { 4 } else { 2 };
            let named = Path::new(&card.folder).ancestors().nth(up).filter(|named| !named.as_os_str().is_empty());
            let named = named.map_or_else(|| folder.clone(), |named| named.display().to_string());
            rows.push(vec![named, begun(card), "suite".to_owned(), counts.clone()]);
        }
        rows.push([vec![card.folder.clone()], cells(card)].concat());
    }
    rows
}

/// Sentences, which would widen a column for all.
pub fn note(cards: &[Card]) {
    for card in cards {
        for sentence in card.problem.iter().chain(&card.note) {
            // A parser's message shows the place in further lines.
            let sentence = sentence.lines().next().unwrap_or_default();
            let is_named = sentence.starts_with(&card.folder);
            let folder = if is_named { String::new() } else { format!("{}: ", card.folder) };
            terminal::note(&format!("{folder}{sentence}"));
        }
    }
    let has_figures = |evaluation| cards.iter().any(|card| card.evaluation == evaluation && !card.figures.is_empty());
    if has_figures(false) && has_figures(true) {
        terminal::note(
            "figures: of runs those of training, newest tenth of the newest stage; of evaluations those of all episodes",
        );
    }
}

/// When it was begun, state and subject, then how far it is, its figures and the time left.
pub fn cells(card: &Card) -> Vec<String> {
    if card.problem.is_some() {
        return vec![NOTHING.to_owned(), "unreadable".to_owned()];
    }
    let budget = format::counted(card.budget, if card.evaluation { "episode" } else { "frame" });
    let done = if card.done == card.budget { budget } else { format!("{} / {budget}", format::count(card.done)) };
    let metrics = card.metrics.iter().filter(|metric| metric.unit.is_empty());
    let figures = format::metrics(metrics, &card.figures, "  ");
    let left = card.left_s.and_then(|left_s| Duration::try_from_secs_f64(left_s).ok());
    let left = left.map_or_else(String::new, |left| format!("{} left", format::duration(left)));
    vec![begun(card), card.state.clone(), subject(card), done, figures, left]
}

fn begun(card: &Card) -> String {
    format::begun(card.created_unix_s, unix_now())
}

/// A run of a suite is called as the suite calls it, another by its task and preset; an evaluation by its episodes, in a run's
/// folder by these alone.
fn subject(card: &Card) -> String {
    let run = Path::new(&card.folder).ancestors().nth(if card.evaluation { 2 } else { 0 });
    let name = run.and_then(Path::file_name).and_then(OsStr::to_str).filter(|_| card.suite.is_some());
    let name = name.and_then(|name| name.strip_suffix(&format!("-{}", card.seed)));
    let own = format!("{}, seed {}", name.map_or_else(|| card.subject(), str::to_owned), card.seed);
    let is_of_run = Path::new(&card.folder).ancestors().nth(2).is_some_and(|run| !run.as_os_str().is_empty());
    // A column is narrow.
    let short = |asked: &String| {
        ["episodes of ", " episodes", " objects"].iter().fold(asked.clone(), |text, word| text.replace(word, ""))
    };
    let asked = card.asked.as_ref().map(short);
    match asked {
        Some(asked) if is_of_run => asked,
        Some(asked) => format!("{own}: {asked}"),
        None => own,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_has_the_name_that_its_suite_gives_it() {
        let card = |folder: &str, evaluation, suite: Option<&str>| Card {
            folder: folder.to_owned(),
            suite: suite.map(str::to_owned),
            evaluation,
            preset: "demo".to_owned(),
            seed: 12,
            state: "stopped".to_owned(),
            done: 5,
            budget: 1000,
            ..Card::default()
        };
        let named = "none, seed 12";
        let run = cells(&card("runs/s/runs/none-12", false, Some("s")));
        assert_eq!(run[..4], ["Jan  1  1970", "stopped", named, "5 / 1,000 frames"]);
        assert_eq!(subject(&card("runs/s/runs/none-12/evaluations/suite-test", true, Some("s"))), named);
        assert_eq!(subject(&card("runs/s/runs/demo-12", false, Some("s"))), "demo, seed 12");
        assert_eq!(
            [subject(&card(".", false, Some("s"))), subject(&card("runs/none-12", false, None))],
            ["demo, seed 12"; 2]
        );
        let asked = |folder: &str| Card {
            asked: Some("test, novel objects, drawn episodes".to_owned()),
            ..card(folder, true, None)
        };
        assert_eq!(subject(&asked("runs/none-12/evaluations/a")), "test, novel, drawn");
        assert_eq!(subject(&asked("evaluations/a")), "demo, seed 12: test, novel, drawn");
        let done = Card { done: 1000, ..card("a", false, None) };
        assert_eq!(cells(&done)[3], "1,000 frames");
        let one = Card { done: 1, budget: 1, ..card("a", true, None) };
        assert_eq!(cells(&one)[3], "1 episode");
    }

    #[test]
    fn a_suite_stands_once_before_its_runs_with_its_own_state() {
        let card = |run: &str, evaluation| {
            let (folder, counts) = ("/w/runs/s".to_owned(), "1 of 2 runs complete, 1 evaluating".to_owned());
            let suite_standing = Some(SuiteStanding { folder, counts, report: None });
            Card { folder: run.to_owned(), evaluation, suite_standing, ..Card::default() }
        };
        let cards = [
            card("runs/s/runs/b-1/evaluations/suite-test", true),
            card("runs/s/runs/b-1", false),
            card("runs/s/runs/a-1", false),
        ];
        let rows = rows(&cards);
        let begin: Vec<&str> = rows.iter().map(|row| row[0].as_str()).collect();
        assert_eq!(begin, ["runs/s", &cards[0].folder, &cards[1].folder, &cards[2].folder]);
        assert_eq!(super::rows(&cards[..1]).len(), 1);
        assert_eq!(rows[0][1..], ["Jan  1  1970", "suite", "1 of 2 runs complete, 1 evaluating"]);
        assert_eq!(super::rows(&[card("runs/a-1", false)])[0][0], "/w/runs/s", "the suite's folder has no other name");
    }
}
