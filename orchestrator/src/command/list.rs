use crate::output::table::fitted;
use crate::output::{format, terminal};
use crate::run::identity::no_folder;
use crate::viewer::RunReaders;
use crate::wrong::demand;
use anyhow::Result;
use std::path::PathBuf;
use std::time::Duration;
use view::data::{Card, Runs};

pub const RUNS: &str = "runs";

/// List runs and evaluations with their state, the newest first
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator list
  orchestrator list /data/runs --json | jq -r '.[] | select(.state == \"running\") | .folder'")]
pub struct ListArgs {
    /// Folders that hold runs, or runs
    #[arg(value_name = "DIR", default_value = RUNS)]
    folders: Vec<PathBuf>,
    /// Print one JSON array
    #[arg(long)]
    json: bool,
}

pub fn run(args: &ListArgs) -> Result<()> {
    let unused = args.folders == [PathBuf::from(RUNS)] && !args.folders[0].exists();
    for folder in args.folders.iter().filter(|_| !unused) {
        demand!(!folder.is_file(), "{}", no_folder(folder));
        demand!(folder.is_dir(), "{} is not a folder: give one that holds runs", folder.display());
    }
    show(if unused { &[] } else { &args.folders }, args.json)
}

/// A line for each run in these folders.
pub fn show(folders: &[PathBuf], json: bool) -> Result<()> {
    let cards = if folders.is_empty() { vec![] } else { RunReaders::once(folders.to_vec()).list() };
    if json {
        terminal::out_json(&cards)?;
        return Ok(());
    }
    if cards.is_empty() {
        terminal::note("no run yet: `orchestrator up` starts one");
    }
    let rows: Vec<Vec<String>> = cards.iter().map(cells).collect();
    for line in fitted(&rows, terminal::width()) {
        terminal::out(&line);
    }
    // Sentences would widen a column for all.
    for card in &cards {
        for sentence in card.problem.iter().chain(&card.note) {
            // A parser's message shows the place in further lines.
            terminal::note(&format!("{}: {}", card.folder, sentence.lines().next().unwrap_or_default()));
        }
    }
    Ok(())
}

fn cells(card: &Card) -> Vec<String> {
    if card.problem.is_some() {
        return vec![card.folder.clone(), "unreadable".to_owned()];
    }
    let what = if card.evaluation { "episodes" } else { "frames" };
    let done = format!("{} / {} {what}", format::count(card.done), format::count(card.budget));
    let metrics = card.metrics.iter().filter(|metric| metric.unit.is_empty());
    let figures = format::metrics(metrics, &card.figures, "  ");
    let left = card.left_s.and_then(|left_s| Duration::try_from_secs_f64(left_s).ok());
    let left = left.map_or_else(String::new, |left| format!("{} left", format::duration(left)));
    let suite = card.suite.as_ref().map_or_else(String::new, |suite| format!("suite {suite}, "));
    let subject = format!("{suite}{}, seed {}", card.subject(), card.seed);
    vec![card.folder.clone(), card.state.clone(), subject, done, figures, left]
}
