//! One run or evaluation that is looked at: what was read of it, so that only what is new is read again.

use super::logbook::logs_of;
use super::processes::{Process, Processes};
use super::roster::Entry;
use super::table;
use super::tail::Tail;
use crate::evaluation::journal;
use crate::evaluation::standing::Standing;
use crate::recording::Recordings;
use crate::recording::shelf::{Shelf, Shelved};
use crate::run::identity::{Identity, unix_now};
use crate::run::lock::{Held, holder};
use crate::run::state::state_of;
use crate::showing::format;
use crate::showing::log_line::LogLine as Parsed;
use crate::training::means::{by_stage, recent};
use crate::training::scores::{Scores, result_folder};
use crate::training::summary::Summary;
use crate::training::wall::{Last, Wall};
use anyhow::{Context, Result};
use proto::bounded;
use proto::config::Config;
use proto::evaluation::{EpisodeRecord, TABLE_FILE, read_table};
use proto::replay::{RecordedEpisode, ReplaySetup};
use proto::run_folder::{RolloutName, RunFolder};
use proto::stage::total_frames;
use proto::trained::{History, Trained};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::Path;
use std::time::Duration;
use tracing::Level;
use view::data::{
    Card, Curves, EpisodeKey, EpisodePage, EpisodeQuery, EpisodeRow, Kitchen, Live, LogLine, Problem, Stage, Start,
    Validated, Worker,
};

/// How long recordings are read at a time: while a run is watched, each second; and for a table that somebody waits
/// for.
const GLANCE: Duration = Duration::from_millis(120);
const LOOK: Duration = Duration::from_millis(800);
/// Warnings and lines of the log that are kept.
const WARNINGS: usize = 30;
const LINES: usize = 14;
/// A line of a log is shown up to here, characters.
const TEXT_MAX: usize = 600;
/// Episodes of a kitchen whose means are shown.
const NEWEST: usize = 50;

/// A log, as far as it is shown.
struct Log {
    tail: Tail,
    lines: VecDeque<LogLine>,
    warnings: VecDeque<LogLine>,
    /// Starts of its process in all, and within the newest start of the orchestrator.
    starts: u32,
    incarnation: u32,
}

impl Log {
    fn of(path: std::path::PathBuf) -> Self {
        let (lines, warnings) = (VecDeque::new(), VecDeque::new());
        Self { tail: Tail::of(path), lines, warnings, starts: 0, incarnation: 0 }
    }

    fn read(&mut self) {
        let Ok(new) = self.tail.read() else { return };
        if new.anew {
            (self.starts, self.incarnation) = (0, 0);
            self.lines.clear();
            self.warnings.clear();
        }
        for line in new.lines {
            let line = String::from_utf8_lossy(&line);
            if let Some(start) = line.strip_prefix("--- ") {
                self.starts += 1;
                let number = start.split_once(", start ").and_then(|(_, rest)| rest.split_once(' ')?.0.parse().ok());
                self.incarnation = number.unwrap_or(self.starts);
                continue;
            }
            let Parsed { level, text } = Parsed::parse(&line);
            let at = line.split_once(' ').filter(|_| level.is_some()).map_or("", |(at, _)| at);
            let text = text.chars().take(TEXT_MAX).collect();
            let shown = LogLine { at: at.to_owned(), level: level.map_or("", |level| level.as_str()).to_owned(), text };
            // An error is the least verbose of levels.
            if level.is_some_and(|level| level <= Level::WARN) {
                push(&mut self.warnings, shown.clone(), WARNINGS);
            }
            push(&mut self.lines, shown, LINES);
        }
    }
}

fn push(lines: &mut VecDeque<LogLine>, line: LogLine, most: usize) {
    if lines.len() == most {
        lines.pop_front();
    }
    lines.push_back(line);
}

/// A run or an evaluation.
pub struct Watched {
    entry: Entry,
    folder: RunFolder,
    metrics: Tail,
    history: History,
    damaged: usize,
    /// Changes when rollouts that were told are void.
    edition: u64,
    logs: BTreeMap<String, Log>,
    shelf: Shelf,
    processes: Processes,
    /// Whose folder it was when it was last looked at.
    id: Option<String>,
}

impl Watched {
    /// Nothing is read yet.
    pub fn of(entry: Entry) -> Self {
        let folder = RunFolder::new(&entry.folder);
        Self {
            metrics: Tail::of(folder.metrics()),
            history: History::default(),
            damaged: 0,
            edition: 1,
            logs: BTreeMap::new(),
            shelf: Shelf::of(folder.root().to_path_buf()),
            processes: Processes::default(),
            id: None,
            entry,
            folder,
        }
    }

    /// Whether its folder is still there.
    pub fn is_there(&self) -> bool {
        self.folder.root().is_dir()
    }

    /// Whose folder it is. Forgets everything if another run began in a new folder of that name.
    fn notice_another_run(&mut self) -> Result<Identity> {
        let identity = Identity::read(&self.folder)?;
        if self.id.as_ref().is_some_and(|id| *id != identity.id) {
            *self = Self { edition: self.edition + 1, ..Self::of(self.entry.clone()) };
        }
        self.id = Some(identity.id.clone());
        Ok(identity)
    }

    /// Its line in the list.
    pub fn card(&mut self) -> Result<Card> {
        let identity = self.notice_another_run()?;
        self.read_metrics()?;
        let config = Config::of_run(&self.folder)?;
        let held = holder(&self.folder)?;
        self.card_of(&config, &identity, &held)
    }

    fn card_of(&self, config: &Config, identity: &Identity, held: &Held) -> Result<Card> {
        let card = Card {
            seed: config.seed,
            preset: config.preset.clone(),
            created_unix_s: identity.created_unix_s,
            ..self.entry.card()
        };
        if let Some(standing) = Standing::read(&self.folder, config)? {
            return Ok(Card {
                evaluation: true,
                state: state_of(identity, held, standing.result.is_some()).to_string(),
                done: standing.played,
                budget: standing.asked,
                success: standing.success,
                success_without_disturbance: standing.success_without_disturbance,
                ..card
            });
        }
        let recent = recent(&config.stages, &self.history);
        let complete = Summary::read(&self.folder)?.is_some();
        // Of a run that has ended the last tenth tells more than its last moment.
        let last_tenth = || by_stage(&config.stages, &self.history).last().map(|stage| stage.last_tenth);
        let lately = complete.then(last_tenth).flatten().unwrap_or(recent.episodes);
        Ok(Card {
            state: state_of(identity, held, complete).to_string(),
            done: recent.frames,
            budget: recent.budget,
            success: lately.success,
            success_without_disturbance: lately.success_without_disturbance,
            disturbance_m: lately.disturbance_m,
            left_s: recent.left_s.filter(|_| *held != Held::Free && !complete),
            ..card
        })
    }

    /// How it stands.
    pub fn live(&mut self) -> Result<Live> {
        let identity = self.notice_another_run()?;
        self.read_metrics()?;
        self.shelf.advance(GLANCE);
        let config = Config::of_run(&self.folder)?;
        let held = holder(&self.folder)?;
        let at_rest = held == Held::Free;
        let recent = recent(&config.stages, &self.history);
        let last = if at_rest { Last::AsNoted } else { Last::Until(unix_now()) };
        let here = match &held {
            Held::By(holder) if holder.is_here() => Some(holder.pid),
            Held::By(_) | Held::Free | Held::Unsigned => None,
        };
        let processes = here.map(|pid| self.processes.look(pid)).unwrap_or_default();
        let mut notes = self.shelf.notes.clone();
        if self.damaged > 0 {
            notes.push(format!("metrics.jsonl has {}", format::counted(self.damaged as u64, "damaged line")));
        }
        let scores = Scores::read(&self.folder, at_rest)?;
        notes.extend(scores.notes);
        let cores = std::thread::available_parallelism().ok().map(usize::from);
        self.read_logs();
        let empty = VecDeque::new();
        let log = self.logs.get("orchestrator");
        Ok(Live {
            stages: stages(&config, &self.history),
            stage: recent.stage,
            frames_per_s: recent.frames_per_s,
            shares: [recent.simulate, recent.infer, recent.update],
            wall_s: Wall::of(&identity, &self.signs_of_life(), last).all_starts_s,
            starts: identity.incarnations.iter().map(start).collect(),
            workers: workers(&self.logs, &processes),
            cores: cores.filter(|_| here.is_some()),
            gpus: if here.is_some() { self.processes.gpus() } else { Vec::new() },
            warnings: log.map_or(&empty, |log| &log.warnings).iter().cloned().collect(),
            log: log.map_or(&empty, |log| &log.lines).iter().cloned().collect(),
            validation: scores.scores.iter().map(validated).collect(),
            kitchens: kitchens(&self.shelf),
            recordings: Recordings::of(&self.folder).map(|recordings| recordings.line()),
            indexed: self.shelf.indexed(),
            notes,
            rollouts: self.history.len() as u64,
            newest: self.newest_figures(),
            card: self.card_of(&config, &identity, &held)?,
        })
    }

    fn newest_figures(&self) -> BTreeMap<String, f32> {
        let figures = self.history.iter().next_back().map(|trained| trained.metrics.iter());
        figures.into_iter().flatten().map(|(name, value)| (name.to_owned(), value as f32)).collect()
    }

    /// Its learning curves after the first `known` rollouts.
    pub fn curves(&mut self, edition: u64, known: usize) -> Result<Curves> {
        self.read_metrics()?;
        let config = Config::of_run(&self.folder)?;
        let from = if edition == self.edition { known.min(self.history.len()) } else { 0 };
        let mut begins_at = 0;
        let stages = config.stages.iter().map(|stage| {
            let named = (stage.name.clone(), begins_at);
            begins_at += stage.frames;
            named
        });
        let mut curves = Curves {
            edition: self.edition,
            from,
            stages: stages.collect(),
            paper: report::level_of(&config),
            ..Curves::default()
        };
        let mut before = self.history.iter().take(from).last().map_or(0, |trained| trained.frames);
        let told: Vec<&Trained> = self.history.iter().skip(from).collect();
        let names: std::collections::BTreeSet<&str> = told.iter().flat_map(|trained| trained.metrics.names()).collect();
        for name in names {
            let of = |trained: &&Trained| trained.metrics.get(name).map(|value| value as f32);
            curves.series.insert(name.to_owned(), told.iter().map(of).collect());
        }
        let mut rates = Vec::new();
        for trained in told {
            curves.frames.push(trained.frames);
            curves.stage.push(trained.stage);
            curves.at.push(trained.at_unix_s);
            let total_s = trained.timing.total_s();
            let frames = trained.frames.saturating_sub(before) as f64;
            rates.push((total_s > 0.0).then_some((frames / total_s) as f32));
            before = trained.frames;
        }
        curves.series.insert("frames_per_s".to_owned(), rates);
        Ok(curves)
    }

    /// A part of its table of episodes.
    pub fn episodes(&mut self, query: &EpisodeQuery) -> Result<EpisodePage> {
        self.shelf.advance(LOOK);
        let mut sources = Vec::new();
        let config = Config::of_run(&self.folder)?;
        let rows: Vec<EpisodeRow> = if config.evaluation.is_some() {
            let recorded: HashMap<(u32, u32), EpisodeKey> = self
                .shelf
                .episodes()
                .filter(|(_, shelved)| shelved.is_playable())
                .filter_map(|((kitchen, environment, episode), shelved)| {
                    Some(((kitchen, shelved.fixed?), EpisodeKey { kitchen, environment, episode }))
                })
                .collect();
            let played = records_in(self.folder.root())?;
            let played = if played.is_empty() { journal::read(&self.folder)? } else { played };
            played.iter().map(|record| table::row_of_record(record, &recorded)).collect()
        } else {
            sources = self.sources();
            if let Some(rollout) = RolloutName::Folder.rollout_of(Path::new(&query.source)) {
                let records = records_in(&result_folder(&self.folder, rollout))?;
                records.iter().map(|record| table::row_of_record(record, &HashMap::new())).collect()
            } else {
                let of = |(key, shelved): (_, &Shelved)| Some((shelved.order, table::row_of_shelved(key, shelved)?));
                let mut ended: Vec<(u64, EpisodeRow)> = self.shelf.episodes().filter_map(of).collect();
                ended.sort_unstable_by_key(|(order, _)| *order);
                ended.into_iter().map(|(_, row)| row).collect()
            }
        };
        let page = table::page(rows, query);
        Ok(EpisodePage { sources, indexed: self.shelf.indexed(), notes: self.shelf.notes.clone(), ..page })
    }

    /// What was recorded of an episode.
    pub fn recorded(&mut self, key: EpisodeKey) -> Result<(ReplaySetup, RecordedEpisode)> {
        self.shelf.advance(LOOK);
        let taken = self.shelf.take_out((key.kitchen, key.environment, key.episode))?;
        let (config, recorded) = taken.ok_or_else(|| {
            let more = if self.shelf.indexed() < 1.0 { " yet: they are still being read" } else { "" };
            Problem::NotThere(format!(
                "the recordings hold no episode {} of environment {}/{}{more}",
                key.episode, key.kitchen, key.environment
            ))
        })?;
        let folder = std::path::absolute(self.folder.root())?;
        let folder = folder.to_str().context("the run's folder has a name that is not text")?.to_owned();
        Ok((ReplaySetup { config, folder: Some(folder), images: None }, recorded))
    }

    /// The newest episode of an environment, if anything was recorded of it.
    pub fn newest(&mut self, kitchen: u32, environment: u32) -> Option<EpisodeKey> {
        self.shelf.advance(LOOK);
        let (kitchen, environment, episode) = self.shelf.last_of(kitchen, environment)?;
        Some(EpisodeKey { kitchen, environment, episode })
    }

    fn read_metrics(&mut self) -> Result<()> {
        let new = self.metrics.read().with_context(|| self.folder.metrics().display().to_string())?;
        if new.anew {
            self.history = History::default();
            self.damaged = 0;
            self.edition += 1;
        }
        for line in new.lines.iter().filter(|line| !line.is_empty()) {
            match serde_json::from_slice::<Trained>(line) {
                Ok(trained) => {
                    let newest = self.history.iter().next_back().map(|trained| trained.rollout);
                    self.edition += u64::from(newest.is_some_and(|newest| newest >= trained.rollout));
                    self.history.insert(trained);
                }
                Err(_) => self.damaged += 1,
            }
        }
        Ok(())
    }

    /// When each incarnation last wrote of a rollout, seconds since 1970.
    fn signs_of_life(&self) -> BTreeMap<u32, u64> {
        let mut seen = BTreeMap::new();
        for trained in self.history.iter() {
            let newest = seen.entry(trained.incarnation).or_insert(trained.at_unix_s);
            *newest = trained.at_unix_s.max(*newest);
        }
        seen
    }

    fn read_logs(&mut self) {
        for (name, path) in logs_of(&self.folder) {
            self.logs.entry(name).or_insert_with(|| Log::of(path)).read();
        }
    }

    /// Tables that there are: of training, and of each validation.
    fn sources(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.validations()).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries
            .filter(|entry| RolloutName::Folder.rollout_of(&entry.path()).is_some())
            .filter(|entry| entry.path().join("result").join(TABLE_FILE).is_file())
            .filter_map(|entry| entry.file_name().into_string().ok())
            .collect();
        names.sort_unstable();
        names.insert(0, "training".to_owned());
        names
    }
}

/// The table of an evaluation's folder; empty where there is none.
fn records_in(folder: &Path) -> Result<Vec<EpisodeRecord>> {
    let path = folder.join(TABLE_FILE);
    match bounded::read_figures_text(&path) {
        Ok(text) => Ok(read_table(&text).with_context(|| path.display().to_string())?),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error).with_context(|| path.display().to_string()),
    }
}

fn stages(config: &Config, history: &History) -> Vec<Stage> {
    let trained = history.frames().min(total_frames(&config.stages));
    let mut begins_at = 0;
    let stages = config.stages.iter().map(|stage| {
        let shown = Stage {
            name: stage.name.clone(),
            reward: format::reward_symbol(stage.reward).to_owned(),
            begins_at,
            budget: stage.frames,
            frames: trained.saturating_sub(begins_at).min(stage.frames),
        };
        begins_at += stage.frames;
        shown
    });
    stages.collect()
}

fn start(incarnation: &crate::run::identity::Incarnation) -> Start {
    let ended = incarnation.ended.as_ref();
    Start {
        number: incarnation.number,
        place: format!("pid {} on {}", incarnation.pid, incarnation.host),
        at_unix_s: incarnation.started_unix_s,
        ended_unix_s: ended.map(|ended| ended.at_unix_s).or(incarnation.seen_unix_s),
        how: ended.map(|ended| ended.how.to_string()),
        reason: ended.and_then(|ended| ended.reason.clone()),
    }
}

/// Learners and actors by their logs, with their processes.
fn workers(logs: &BTreeMap<String, Log>, processes: &[Process]) -> Vec<Worker> {
    let process = |name: &str| processes.iter().find(|process| process.name == name);
    let worker = |name: &str, incarnation: u32, starts: u32| {
        let process = process(name);
        Worker {
            name: name.to_owned(),
            pid: process.map(|process| process.pid),
            incarnation,
            starts,
            cores: process.and_then(|process| process.cores),
            memory_bytes: process.and_then(|process| process.memory_bytes),
            stopped: process.is_some_and(|process| process.stopped),
        }
    };
    let of_logs = logs.iter().filter(|(_, log)| log.starts > 0);
    let mut workers: Vec<Worker> = of_logs.map(|(name, log)| worker(name, log.incarnation, log.starts)).collect();
    // The orchestrator and learners before actors.
    workers.sort_by_key(|worker| !worker.name.starts_with("learner"));
    if process("orchestrator").is_some() {
        workers.insert(0, worker("orchestrator", 1, 1));
    }
    workers
}

fn validated(score: &crate::training::scores::Score) -> Validated {
    Validated {
        rollout: score.rollout,
        frames: score.frames,
        success: score.success,
        success_without_disturbance: score.success_without_disturbance,
        disturbance_m: score.disturbance_m,
    }
}

/// Means over the newest episodes of each kitchen.
fn kitchens(shelf: &Shelf) -> Vec<Kitchen> {
    let mut environments: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (kitchen, environment) in shelf.environments() {
        environments.entry(kitchen).or_default().push(environment);
    }
    let of = |(kitchen, mut environments): (u32, Vec<u32>)| {
        environments.sort_unstable();
        let ends: Vec<_> =
            shelf.newest_of(kitchen, NEWEST).filter_map(|shelved: &Shelved| shelved.end.as_ref()).collect();
        let mean = |sum: f64| if ends.is_empty() { 0.0 } else { sum / ends.len() as f64 };
        Kitchen {
            kitchen,
            environments,
            episodes: ends.len() as u64,
            success: mean(ends.iter().filter(|end| end.success).count() as f64),
            success_without_disturbance: mean(ends.iter().filter(|end| end.success_undisturbed).count() as f64),
            disturbance_m: mean(ends.iter().map(|end| f64::from(end.disturbance_m)).sum()),
        }
    };
    environments.into_iter().map(of).collect()
}
