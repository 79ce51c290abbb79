//! `orchestrator status`: how a run or an evaluation stands, from its folder alone.

use super::list::{self, EVALUATIONS};
use crate::environment::growing;
use crate::evaluation::progress::Progress;
use crate::evaluation::text::conditions;
use crate::output::format;
use crate::output::terminal;
use crate::run::identity::{Identity, Incarnation};
use crate::run::lock::{LockState, holder, state_of};
use crate::run::process_state::{Stopped, stopped};
use crate::suite::{self, At};
use crate::training::means::{Recent, StageMeans, by_stage, recent};
use crate::training::metrics::Figures;
use crate::training::next_steps;
use crate::training::progress::frames_line;
use crate::training::restarts::restarts;
use crate::training::scores::Scores;
use crate::training::summary::{Summary, table};
use crate::training::wall::{Wall, is_idle, signs_of_life, silent_s};
use crate::viewer::RunReaders;
use anyhow::Result;
use proto::config::Config;
use proto::run_folder::RunFolder;
use proto::run_state::RunState;
use proto::trained::History;
use recording::Recordings;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use view::data::{Card, Runs};

/// Show how a run, an evaluation or a suite stands
///
/// Lists a run's evaluations, too, and says what keeps a run from going on: processes that are stopped, and how long ago
/// the last rollout was trained if that is unusually long.
///
/// Wall time is counted from the beginning of each start to its end, not in between, by a clock that nobody sets; a start
/// that was killed counts until the last rollout that it trained.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator status runs/20261121-020423-demo-1
  orchestrator status --json RUN | jq .recent.frames_per_s")]
pub struct StatusArgs {
    /// Run folder, or that of an evaluation or of a suite
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Status {
    folder: PathBuf,
    id: String,
    state: RunState,
    preset: String,
    seed: u64,
    incarnations: Vec<Incarnation>,
    recordings: Option<Recordings>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    stopped: Vec<Stopped>,
    #[serde(flatten)]
    work: Work,
    evaluations: Vec<Card>,
}

#[derive(Debug, Serialize)]
struct SuiteStatus<'a> {
    folder: &'a Path,
    #[serde(skip_serializing_if = "Option::is_none")]
    standing: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    /// Those that were begun, and evaluations, the newest first: as `list --json` has them.
    runs: Vec<Card>,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Work {
    Training {
        recent: Box<Recent>,
        stages: Vec<StageMeans>,
        weights: Option<String>,
        wall: Wall,
        /// For how long no rollout was trained, if somebody works on it, seconds.
        #[serde(skip_serializing_if = "Option::is_none")]
        silent_s: Option<u64>,
        #[serde(skip)]
        usual_s: f64,
        /// Actors whose memory grows without an end in sight.
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        growth: BTreeMap<String, String>,
        /// How often processes died and were started again, and why the last did.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        restarts: Vec<String>,
        #[serde(skip_serializing_if = "Vec::is_empty")]
        notes: Vec<String>,
    },
    /// An evaluation trains nothing: its configuration's stages are its run's.
    Evaluation { evaluation: Progress },
}

impl Work {
    fn read(folder: &RunFolder, config: &Config, identity: &Identity, held: &LockState) -> Result<Self> {
        if let Some(evaluation) = Progress::read(folder, config)? {
            return Ok(Self::Evaluation { evaluation });
        }
        let at_rest = *held == LockState::Free;
        let Figures { history, mut notes } = Figures::read(folder, at_rest);
        notes.extend(Scores::read(folder, config.spec(), at_rest).notes);
        let summary = Summary::read(folder)?;
        notes
            .extend(summary.iter().flat_map(|summary| &summary.missing).map(|missing| format!("{missing} is missing")));
        let seen = signs_of_life(&history);
        let newest = identity.incarnations.last().filter(|_| !at_rest);
        let silent_s = newest.map(|start| silent_s(start, seen.get(&start.number).copied()) as u64);
        let recent = recent(&config.stages, &history, at_rest || is_idle(identity, &history));
        let stages = by_stage(&config.stages, &history).into_iter().map(|stage| stage.with_quotients(config.spec()));
        Ok(Self::Training {
            recent: Box::new(recent.with_quotients(config.spec())),
            stages: stages.collect(),
            weights: summary.map(|summary| summary.weights),
            wall: Wall::of(identity, &seen, !at_rest),
            silent_s,
            usual_s: usual_s(&history),
            growth: growing(folder, config),
            restarts: restarts(folder),
            notes,
        })
    }

    fn name(&self) -> &'static str {
        match self {
            Self::Training { .. } => "run",
            Self::Evaluation { .. } => "evaluation",
        }
    }

    fn is_complete(&self) -> bool {
        match self {
            Self::Training { weights, .. } => weights.is_some(),
            Self::Evaluation { evaluation } => evaluation.result.is_some(),
        }
    }

    /// As people read it. `goes_on`: whether somebody works on it. `starts`: how often somebody began to.
    fn lines(&self, config: &Config, goes_on: bool, starts: usize) -> Vec<String> {
        match self {
            Self::Training { recent, stages, wall, silent_s, usual_s, growth, restarts, notes, .. } => {
                let metrics = config.spec().shown();
                let mut lines = vec![frames_line(&config.stages, recent)];
                if !stages.is_empty() {
                    lines.extend(table(&metrics, stages));
                }
                if config.environment.is_some() {
                    lines.push(format!("restore {}", config.spec().restore.describe()));
                }
                if starts > 0 {
                    lines.push(wall.text(starts as u32));
                }
                lines.extend(restarts.iter().cloned());
                lines.extend(growth.iter().map(|(actor, growth)| format!("{actor}: {growth}")));
                if let Some(silent_s) = silent_s.filter(|&silent_s| silent_s as f64 > (3.0 * usual_s).max(10.0)) {
                    lines.push(if *usual_s > 0.0 {
                        format!("no rollout for {silent_s} s (the last ones took {usual_s:.1} s each)")
                    } else {
                        format!("no rollout yet, {silent_s} s after the start")
                    });
                }
                lines.extend(notes.iter().map(|note| format!("note: {note}")));
                lines
            }
            Self::Evaluation { evaluation } => {
                let result = match &evaluation.result {
                    Some(path) => path.display().to_string(),
                    None if goes_on => "none yet".to_owned(),
                    None => "none: an evaluation that was cut off is made anew, in another folder".to_owned(),
                };
                let asked = config.evaluation.as_ref().map(|asked| conditions(config, asked));
                let lines = [evaluation.line(None, None), format!("result: {result}")];
                asked.into_iter().chain(lines).collect()
            }
        }
    }
}

const USUAL: usize = 8;

fn usual_s(history: &History) -> f64 {
    let last: Vec<f64> = history.iter().rev().take(USUAL).map(|trained| trained.timing.total_s()).collect();
    last.iter().sum::<f64>() / last.len().max(1) as f64
}

fn stopped_line(process: &Stopped, holder: u32) -> String {
    let Stopped { program, pid } = process;
    if *pid == holder {
        format!("its orchestrator (pid {pid}) is stopped: nobody supervises the run until `kill -CONT {pid}`")
    } else {
        format!(
            "{program} (pid {pid}) is stopped: it does nothing until `kill -CONT {pid}`, or until it is started again"
        )
    }
}

pub fn of_suite(root: &Path, json: bool) -> Result<()> {
    let cards = RunReaders::once(vec![root.to_path_buf()]).list();
    let read = suite::Standing::read(root);
    if json {
        let (standing, problem) = match &read {
            Ok(standing) => (Some(standing.counts()), None),
            Err(error) => (None, Some(format!("{error:#}"))),
        };
        return Ok(terminal::out_json(&SuiteStatus { folder: root, standing, problem, runs: cards })?);
    }
    let standing = match read {
        Ok(standing) => standing,
        Err(error) => {
            terminal::note(&format!("{error:#}"));
            list::print(&cards);
            return Ok(());
        }
    };
    terminal::out(&standing.summary());
    let runs = standing.each();
    terminal::out_table(&suite_rows(&runs, &cards));
    standing.apart().iter().for_each(|line| terminal::out_wrapped(line));
    terminal::out(&format!("runs in {}", root.join("runs").display()));
    for (run, _, reason) in &runs {
        if let Some(reason) = reason {
            terminal::out_wrapped(&format!("{}: {reason}", run.display()));
        }
    }
    list::note(&cards);
    if let Some(go_on) = standing.go_on() {
        terminal::out_wrapped(&format!("go on with: {go_on}"));
    }
    Ok(())
}

/// A row for each run in the order of the suite's file, below it one for each of its evaluations, the oldest first.
fn suite_rows(runs: &[At], cards: &[Card]) -> Vec<Vec<String>> {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    // The name says what the subject would.
    let figures = |card: &Card| list::cells(card).into_iter().skip(3).collect();
    let mut rows = Vec::new();
    for (run, at, _) in runs {
        let of_run = cards.iter().find(|card| Path::new(&card.folder) == run).map_or_else(Vec::new, figures);
        rows.push([vec![name(run), (*at).to_owned()], of_run].concat());
        let evaluations = run.join(EVALUATIONS);
        for card in cards.iter().rev().filter(|card| Path::new(&card.folder).parent() == Some(&*evaluations)) {
            rows.push(
                [vec![format!("  {}", name(Path::new(&card.folder))), card.state.clone()], figures(card)].concat(),
            );
        }
    }
    rows
}

/// Those in a run's own folder, the newest first.
fn evaluations(run: &RunFolder) -> Vec<Card> {
    let folder = run.root().join(EVALUATIONS);
    if folder.is_dir() { RunReaders::once(vec![folder]).list() } else { Vec::new() }
}

pub fn run(args: &StatusArgs) -> Result<()> {
    let folder = RunFolder::new(&args.run);
    if suite::is_suite(folder.root()) {
        return of_suite(folder.root(), args.json);
    }
    let identity = Identity::read(&folder)?;
    let config = Config::of_run(&folder)?;
    let held = holder(&folder)?;
    let work = Work::read(&folder, &config, &identity, &held)?;
    let status = Status {
        folder: folder.root().to_path_buf(),
        id: identity.id.clone(),
        state: state_of(&identity, &held, work.is_complete()),
        preset: config.preset.clone(),
        seed: config.seed,
        incarnations: identity.incarnations.clone(),
        recordings: Recordings::of(&folder),
        stopped: match &held {
            LockState::By(holder) if holder.is_here() => stopped(holder.pid),
            LockState::By(_) | LockState::Free | LockState::Unsigned => Vec::new(),
        },
        work,
        evaluations: evaluations(&folder),
    };
    if args.json {
        return Ok(terminal::out_json(&status)?);
    }
    let by = match &held {
        LockState::By(holder) => format!(" ({holder})"),
        LockState::Free | LockState::Unsigned => String::new(),
    };
    let Status { id, state, preset, seed, incarnations, recordings, stopped, work, evaluations, .. } = status;
    terminal::out_wrapped(&format!("{} {id} {state}{by}: preset {preset}, seed {seed}", work.name()));
    if let Some(last) = incarnations.last() {
        terminal::out_wrapped(&format!("start {} at {}", last.number, format::date(last.started_unix_s)));
        if let Some(reason) = last.ended.as_ref().and_then(|ended| ended.reason.as_ref()) {
            terminal::out_wrapped(reason);
        }
    }
    if let LockState::By(holder) = &held {
        for process in &stopped {
            terminal::out_wrapped(&stopped_line(process, holder.pid));
        }
    }
    for line in identity.changes_of_shape() {
        terminal::out_wrapped(&line);
    }
    for line in work.lines(&config, held != LockState::Free, incarnations.len()) {
        terminal::out_wrapped(&line);
    }
    if let Some(recordings) = recordings {
        terminal::out_wrapped(&format::recordings(&recordings));
    }
    if !evaluations.is_empty() {
        terminal::out("evaluations, with the figures of their episodes:");
        list::print(&evaluations);
    }
    // An evaluation is not gone on with.
    if held == LockState::Free && !work.is_complete() && matches!(work, Work::Training { .. }) {
        let go_on = next_steps::go_on(&next_steps::program(), folder.root(), identity.hosts());
        terminal::out_wrapped(&format!("go on with: {go_on}"));
    }
    Ok(())
}
