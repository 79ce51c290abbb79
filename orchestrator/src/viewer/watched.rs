//! One run or evaluation that is looked at: what was read of it, so that only what is new is read again.

use super::episode_table::{self, Pairable};
use super::logbook::{Found, beginnings, logs_of};
use super::process_log::{Log, WARNINGS, workers};
use super::processes::Processes;
use super::roster::Entry;
use super::tail::{New, Tail};
use crate::environment::growing;
use crate::evaluation::journal;
use crate::evaluation::progress::Progress;
use crate::evaluation::text::{brief, conditions, results};
use crate::output::format;
use crate::report_builder::files::PAGE;
use crate::run::checkpoints::newest_path;
use crate::run::identity::{Identity, is_evaluation};
use crate::run::lock::{LockState, holder, state_of};
use crate::training::means::{by_stage, frames_per_s, recent};
use crate::training::metrics::{Figures, left_out};
use crate::training::next_steps;
use crate::training::scores::{Score, Scores, read_result, result_folder};
use crate::training::summary::Summary;
use crate::training::wall::{Wall, elapsed_s, is_idle, signs_of_life};
use anyhow::{Context, Result};
use proto::bounded::{FIGURES_BYTES_MOST, TABLE_BYTES_MOST};
use proto::config::Config;
use proto::evaluation::{EpisodeRecord, TABLE_FILE, read_table_from};
use proto::replay::ReplaySetup;
use proto::run_folder::{RolloutName, RunFolder};
use proto::stage::total_frames;
use proto::task::Spec;
use proto::trained::{History, Trained};
use recording::Recordings;
use recording::episode_index::{EpisodeIndex, Shelved};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use view::data::{
    Card, Curves, EpisodeKey, EpisodePage, EpisodeQuery, EpisodeRow, Film, Kitchen, Live, Made, Problem, Recorded,
    Results, Source, Stage, Start, Validated,
};

/// How long recordings are read at a time: while a run is watched, each second; and for a table that somebody waits
/// for.
const GLANCE: Duration = Duration::from_millis(120);
const LOOK: Duration = Duration::from_millis(800);
const NEWEST: usize = 50;
/// All logs together are read up to so many bytes; of longer ones the ends.
const LOG_BYTES_MOST: u64 = 256 << 20;
const POINTS_MOST: usize = 50_000_000;
const FILM_BYTES_MOST: u64 = 256 << 20;

pub struct Watched {
    entry: Entry,
    folder: RunFolder,
    metrics: Tail,
    history: History,
    damaged: usize,
    left_out: Vec<String>,
    /// Of a run at rest: its newest checkpoint, with which the figures were completed, and what was noted then.
    completed: Option<(Option<PathBuf>, Vec<String>)>,
    /// Changes when rollouts that were told are void.
    edition: u64,
    logs: BTreeMap<String, Log>,
    episode_index: EpisodeIndex,
    processes: Processes,
    id: Option<String>,
    /// Of an evaluation that is complete.
    results: Option<Results>,
}

impl Watched {
    pub fn of(entry: Entry) -> Self {
        let folder = entry.folder.clone();
        Self {
            metrics: Tail::of(folder.clone(), folder.metrics(), 0),
            history: History::default(),
            damaged: 0,
            left_out: Vec::new(),
            completed: None,
            edition: 1,
            logs: BTreeMap::new(),
            episode_index: EpisodeIndex::of(folder.clone()),
            processes: Processes::default(),
            id: None,
            results: None,
            entry,
            folder,
        }
    }

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

    pub fn card(&mut self, patience: Duration) -> Result<Card> {
        let identity = self.notice_another_run()?;
        let held = holder(&self.folder)?;
        self.read_metrics(patience, held == LockState::Free);
        let config = Config::of_run(&self.folder)?;
        self.card_of(&config, &identity, &held)
    }

    fn card_of(&self, config: &Config, identity: &Identity, held: &LockState) -> Result<Card> {
        let card = Card {
            seed: config.seed,
            task: config.environment.is_some().then(|| config.task.clone()),
            preset: config.preset.clone(),
            created_unix_s: identity.created_unix_s,
            elsewhere: config.environment.is_some(),
            metrics: config.spec().shown(),
            note: self.notes().next().cloned(),
            scenes: scene_names(config, &self.folder),
            report: self.report().map(|(_, page)| page.display().to_string()),
            ..self.entry.card()
        };
        if let Some(standing) = Progress::read(&self.folder, config)? {
            return Ok(Card {
                evaluation: true,
                conditions: config.evaluation.as_ref().map(|asked| conditions(config, asked)),
                asked: config.evaluation.as_ref().map(|asked| brief(config, asked)),
                state: state_of(identity, held, standing.result.is_some()).to_string(),
                done: standing.played,
                budget: standing.asked,
                figures: config.spec().with_quotients(standing.known()),
                ..card
            });
        }
        let idle = *held == LockState::Free || is_idle(identity, &self.history);
        let recent = recent(&config.stages, &self.history, idle);
        let complete = Summary::read(&self.folder)?.is_some();
        Ok(Card {
            state: state_of(identity, held, complete).to_string(),
            done: recent.frames,
            budget: recent.budget,
            figures: config.spec().with_quotients(recent.episodes.with_return()),
            left_s: recent.left_s.filter(|_| !complete),
            frames_per_s: frames_per_s(&self.history),
            ..card
        })
    }

    /// The command that goes on with a run at rest which is not complete.
    fn go_on(&self, identity: &Identity, held: &LockState) -> Result<Option<String>> {
        if *held != LockState::Free || is_evaluation(&self.folder) || Summary::read(&self.folder)?.is_some() {
            return Ok(None);
        }
        Ok(Some(next_steps::go_on(&next_steps::program(), self.folder.root(), identity.hosts())))
    }

    pub fn live(&mut self) -> Result<Live> {
        let identity = self.notice_another_run()?;
        let held = holder(&self.folder)?;
        let at_rest = held == LockState::Free;
        self.read_metrics(LOOK, at_rest);
        let config = Config::of_run(&self.folder)?;
        self.episode_index.advance(if at_rest { LOOK } else { GLANCE });
        let recent = recent(&config.stages, &self.history, at_rest || is_idle(&identity, &self.history));
        let here = match &held {
            LockState::By(holder) if holder.is_here() => Some(holder.pid),
            LockState::By(_) | LockState::Free | LockState::Unsigned => None,
        };
        let processes = here.map(|pid| self.processes.look(pid)).unwrap_or_default();
        let mut notes: Vec<String> = self.notes().cloned().collect();
        notes.extend(self.episode_index.notes.iter().cloned());
        if self.damaged > 0 && self.completed.is_none() {
            notes.push(format!("metrics.jsonl has {}", format::counted(self.damaged as u64, "damaged line")));
        }
        let scores = Scores::read(&self.folder, config.spec(), at_rest);
        notes.extend(scores.notes);
        if self.results.is_none() && config.evaluation.is_some() {
            self.results = read_result(&self.folder).ok().map(|result| results(config.spec(), &result));
        }
        let cores = std::thread::available_parallelism().ok().map(usize::from);
        notes.extend(self.read_logs());
        let empty = VecDeque::new();
        let log = self.logs.get("orchestrator");
        Ok(Live {
            stages: stages(&config, &self.history),
            stage: recent.stage,
            frames_per_s: recent.frames_per_s,
            shares: [recent.simulate, recent.infer, recent.update],
            wall_s: Wall::of(&identity, &signs_of_life(&self.history), !at_rest).all_starts_s,
            starts: identity.incarnations.iter().map(start).collect(),
            workers: workers(&self.logs, &processes, &growing(&self.folder, &config)),
            cores: cores.filter(|_| here.is_some()),
            gpus: if here.is_some() { self.processes.gpus() } else { Vec::new() },
            warnings: log.map_or(&empty, |log| &log.warnings).iter().cloned().collect(),
            log: log.map_or(&empty, |log| &log.lines).iter().cloned().collect(),
            validation: scores.scores.into_iter().map(|score| validated(config.spec(), score)).collect(),
            kitchens: match config.environment {
                None => kitchens(config.spec(), &self.episode_index),
                Some(_) => Vec::new(),
            },
            recordings: Recordings::of(&self.folder).as_ref().map(format::recordings),
            indexed: self.episode_index.indexed(),
            notes,
            rollouts: self.history.len() as u64,
            go_on: self.go_on(&identity, &held)?,
            results: self.results.clone(),
            card: self.card_of(&config, &identity, &held)?,
        })
    }

    pub fn curves(&mut self, edition: u64, known: usize) -> Result<Curves> {
        self.read_metrics(LOOK, holder(&self.folder)? == LockState::Free);
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
            metrics: config.spec().charted(),
            paper: report::level_of(&config).unwrap_or_default(),
            elapsed_s: elapsed_s(&self.history).skip(from).collect(),
            ..Curves::default()
        };
        let mut before = self.history.iter().take(from).last().map_or(0, |trained| trained.frames);
        let told: Vec<&Trained> = self.history.iter().skip(from).collect();
        let names: std::collections::BTreeSet<&str> = told.iter().flat_map(|trained| trained.metrics.names()).collect();
        // Some have thousands of names, each of one rollout.
        for name in names.into_iter().take(POINTS_MOST / told.len().max(1)) {
            let of = |trained: &&Trained| trained.metrics.get(name).map(|value| value as f32);
            curves.series.insert(name.to_owned(), told.iter().map(of).collect());
        }
        let mut rates = Vec::new();
        for trained in told {
            curves.frames.push(trained.frames);
            curves.stage.push(trained.stage);
            let total_s = trained.timing.total_s();
            let frames = trained.frames.saturating_sub(before) as f64;
            rates.push((total_s > 0.0).then_some((frames / total_s) as f32));
            before = trained.frames;
        }
        curves.series.insert("frames_per_s".to_owned(), rates);
        Ok(curves)
    }

    pub fn episodes(&mut self, query: &EpisodeQuery) -> Result<EpisodePage> {
        self.episode_index.advance(LOOK);
        let config = Config::of_run(&self.folder)?;
        let rows = self.rows(&config, &query.source)?;
        let page = episode_table::page(config.spec(), rows, query);
        Ok(EpisodePage {
            sources: if config.evaluation.is_some() { Vec::new() } else { self.sources() },
            indexed: self.episode_index.indexed(),
            notes: self.episode_index.notes.clone(),
            elsewhere: config.environment.is_some(),
            ..page
        })
    }

    fn rows(&self, config: &Config, source: &str) -> Result<Vec<EpisodeRow>> {
        let spec = config.spec();
        if config.evaluation.is_some() {
            let recorded: HashMap<(u32, u32), EpisodeKey> = self
                .episode_index
                .episodes()
                .filter(|(_, shelved)| shelved.is_playable())
                .filter_map(|((kitchen, environment, episode), shelved)| {
                    Some(((kitchen, shelved.fixed?), EpisodeKey { kitchen, environment, episode }))
                })
                .collect();
            let played = records_in(spec, &self.folder)?;
            let played = if played.is_empty() { journal::read(&self.folder)? } else { played };
            return Ok(played.iter().map(|record| episode_table::row_of_record(spec, record, &recorded)).collect());
        }
        if let Some(rollout) = RolloutName::Folder.rollout_of(Path::new(source)) {
            let records = records_in(spec, &result_folder(&self.folder, rollout))?;
            return Ok(records
                .iter()
                .map(|record| episode_table::row_of_record(spec, record, &HashMap::new()))
                .collect());
        }
        let of = |(key, shelved): (_, &Shelved)| Some((shelved.order, episode_table::row_of_shelved(key, shelved)?));
        let mut ended: Vec<(u64, EpisodeRow)> = self.episode_index.episodes().filter_map(of).collect();
        ended.sort_unstable_by_key(|(order, _)| *order);
        Ok(ended.into_iter().map(|(_, row)| row).collect())
    }

    /// Its recorded episodes, to be found in another run.
    pub fn pairable(&mut self) -> Result<Pairable> {
        self.episode_index.advance(LOOK);
        let config = Config::of_run(&self.folder)?;
        let spec = config.spec();
        Ok(Pairable {
            seed: config.evaluation.is_none().then_some(config.seed),
            successes: spec.good_outcomes().collect(),
            measure: spec.shown().into_iter().find(|one| !one.is_share()).map(|one| one.name).unwrap_or_default(),
            // Only kitchens are drawn here.
            rows: match config.environment {
                None => self.rows(&config, "")?.into_iter().filter(|row| row.key.is_some()).collect(),
                Some(_) => Vec::new(),
            },
            indexed: self.episode_index.indexed(),
        })
    }

    pub fn recorded(&mut self, key: EpisodeKey) -> Result<Recorded> {
        self.episode_index.advance(LOOK);
        let place = (key.kitchen, key.environment, key.episode);
        let here = Config::of_run(&self.folder)?;
        let elsewhere = here.environment.is_some();
        let source = if elsewhere {
            self.episode_index.told(place)?.map(|shown| Source::Steps(Box::new(shown)))
        } else {
            let folder = std::path::absolute(self.folder.root())?;
            let folder = folder.to_str().context("the run's folder has a name that is not text")?.to_owned();
            let setup = |config| ReplaySetup { config, folder: Some(folder), images: None };
            let taken = self.episode_index.take_out(place)?;
            taken.map(|(config, episode)| Source::Actions { setup: setup(config), episode: Box::new(episode) })
        };
        let source = source.ok_or_else(|| {
            let EpisodeKey { kitchen, environment, episode } = key;
            match self.episode_index.indexed() {
                1.0.. => Problem::NotThere(format!(
                    "the recordings hold no episode {episode} of environment {kitchen}/{environment}"
                )),
                indexed => Problem::NotYet(format!("the recordings are still being read: {:.0}%", 100.0 * indexed)),
            }
        })?;
        let shelved = self.episode_index.get(place);
        let number = shelved.and_then(|shelved| shelved.fixed).unwrap_or(key.episode);
        let film = next_steps::film(&next_steps::program(), self.folder.root(), &here);
        let made = Made {
            number,
            elsewhere,
            filmed: elsewhere && self.film_of(key).is_some(),
            film: film.map(|films| format!("{films} --environment {} --episode {number}", key.environment)),
            reward: shelved.and_then(|shelved| shelved.reward.as_deref()).map(str::to_owned),
        };
        Ok(Recorded { source, made })
    }

    /// Where the film of an episode lies, and what it is, if it is made: `replay` names it.
    fn film_of(&self, key: EpisodeKey) -> Option<(PathBuf, &'static str)> {
        let EpisodeKey { environment, episode, .. } = key;
        let film = |(ending, kind): (&str, &'static str)| {
            let name = format!("films/environment-{environment}-episode-{episode:06}.{ending}");
            (self.folder.root().join(name), kind)
        };
        let kinds = [("mp4", "video/mp4"), ("png", "image/apng")];
        kinds.map(film).into_iter().find(|(path, _)| self.folder.has(path))
    }

    pub fn film(&self, key: EpisodeKey) -> Result<Film> {
        let (path, kind) = self.film_of(key).ok_or_else(|| Problem::NotThere(format!("no film is made of {key}")))?;
        let bytes = self.folder.read(&path, FILM_BYTES_MOST).with_context(|| path.display().to_string())?;
        Ok(Film { kind, bytes })
    }

    pub fn newest(&mut self, kitchen: u32, environment: u32) -> Option<EpisodeKey> {
        self.episode_index.advance(LOOK);
        let (kitchen, environment, episode) = self.episode_index.last_of(kitchen, environment)?;
        Some(EpisodeKey { kitchen, environment, episode })
    }

    /// Of a run of no suite its folder, and the page of its report in it, where there is one.
    pub fn report(&self) -> Option<(RunFolder, PathBuf)> {
        let page = self.folder.root().join("report").join(PAGE);
        (self.entry.suite.is_none() && self.folder.has(&page)).then(|| (self.folder.clone(), page))
    }

    pub fn suite(&self) -> Option<&Path> {
        self.entry.suite.as_deref()
    }

    fn notes(&self) -> impl Iterator<Item = &String> {
        self.left_out.iter().chain(self.completed.iter().flat_map(|(_, notes)| notes))
    }

    fn read_metrics(&mut self, patience: Duration, at_rest: bool) {
        let until = Instant::now() + patience;
        self.left_out.clear();
        let read = self.metrics.length(FIGURES_BYTES_MOST).and_then(|_| {
            loop {
                let new = self.metrics.read()?;
                let more = new.more;
                self.take_metrics(&new);
                if !more || Instant::now() > until {
                    return Ok(more);
                }
            }
        });
        if !at_rest {
            self.completed = None;
        } else if !matches!(read, Ok(true)) {
            let is_missing = read.is_ok() && !self.folder.has(&self.folder.metrics());
            self.complete(is_missing);
        }
        match read {
            Ok(false) => {}
            Ok(true) => self.left_out.push("metrics.jsonl is long, and is still being read".to_owned()),
            Err(error) => self.left_out.push(left_out("metrics.jsonl", &error)),
        }
    }

    /// The figures of a run at rest are those of `status`: its orchestrator may have been killed before it wrote what its
    /// learner has saved.
    fn complete(&mut self, is_missing: bool) {
        let newest = newest_path(&self.folder);
        if self.completed.as_ref().is_some_and(|(with, _)| *with == newest) {
            return;
        }
        let before = self.history.len();
        let mut figures = Figures { history: std::mem::take(&mut self.history), notes: Vec::new() };
        figures.complete(&self.folder, true, is_missing, self.damaged);
        self.edition += u64::from(figures.history.len() > before);
        self.history = figures.history;
        self.completed = Some((newest, figures.notes));
    }

    fn take_metrics(&mut self, new: &New) {
        if new.anew {
            self.history = History::default();
            self.damaged = 0;
            self.edition += 1;
        }
        if new.anew || !new.lines.is_empty() {
            self.completed = None;
        }
        for line in new.lines.iter().filter(|line| !line.is_empty()) {
            let before = self.history.len();
            if self.history.insert_line(line) {
                // It made others void.
                self.edition += u64::from(self.history.len() <= before);
            } else {
                self.damaged += 1;
            }
        }
    }

    fn read_logs(&mut self) -> Vec<String> {
        let until = Instant::now() + GLANCE;
        let mut logs = match logs_of(&self.folder) {
            Ok(logs) => logs,
            Err(error) => return vec![left_out("logs/", &error)],
        };
        let (beginnings, note) = beginnings(&mut logs, LOG_BYTES_MOST);
        let mut notes: Vec<String> = note.into_iter().collect();
        for (Found { name, path, .. }, from) in logs.into_iter().zip(beginnings) {
            let is_remote = path.parent() != Some(self.folder.logs().as_path());
            let new = || Log::of(Tail::of(self.folder.clone(), path, from), is_remote);
            let log = self.logs.entry(name.clone()).or_insert_with(new);
            if let Err(error) = log.read(until)
                && notes.len() < WARNINGS
            {
                notes.push(left_out(&format!("the log of {name}"), &error));
            }
        }
        notes
    }

    fn sources(&self) -> Vec<String> {
        let items = self.folder.list(&self.folder.validations()).unwrap_or_default();
        let has_table = |rollout: &u64| {
            let result = result_folder(&self.folder, *rollout);
            result.has(&result.root().join(TABLE_FILE))
        };
        let rollouts = items.iter().filter_map(|item| RolloutName::Folder.rollout_of(&item.path)).filter(has_table);
        std::iter::once("training".to_owned()).chain(rollouts.map(|rollout| RolloutName::Folder.of(rollout))).collect()
    }
}

fn records_in(spec: &Spec, folder: &RunFolder) -> Result<Vec<EpisodeRecord>> {
    let path = folder.root().join(TABLE_FILE);
    match folder.reader(&path, TABLE_BYTES_MOST) {
        Ok(file) => Ok(read_table_from(spec, file).with_context(|| path.display().to_string())?),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error).with_context(|| path.display().to_string()),
    }
}

fn stages(config: &Config, history: &History) -> Vec<Stage> {
    let trained = history.frames().min(total_frames(&config.stages));
    let newest = by_stage(&config.stages, history);
    let mut begins_at = 0;
    let stages = config.stages.iter().map(|stage| {
        let means = newest.iter().find(|means| means.name == stage.name).map(|means| means.last_tenth.with_return());
        let shown = Stage {
            figures: config.spec().with_quotients(means.unwrap_or_default()),
            name: stage.name.clone(),
            reward: stage.reward.clone(),
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
        how: ended.map(|ended| ended.how.to_string()),
        reason: ended.and_then(|ended| ended.reason.clone()),
    }
}

fn validated(spec: &Spec, score: Score) -> Validated {
    let Score { rollout, frames, figures, .. } = score;
    Validated { rollout, frames, figures: spec.with_quotients(figures) }
}

/// Scenes by their glTF files, whose names copies keep.
fn scene_names(config: &Config, folder: &RunFolder) -> Vec<String> {
    let name = |scene: &String| {
        let file: toml::Table = folder.read_text(&folder.root().join(scene)).ok()?.parse().ok()?;
        Some(Path::new(file.get("gltf")?.as_str()?).file_stem()?.to_string_lossy().into_owned())
    };
    config.scenes.iter().map(|scene| name(scene).unwrap_or_else(|| scene.clone())).collect()
}

fn kitchens(spec: &Spec, episode_index: &EpisodeIndex) -> Vec<Kitchen> {
    let mut environments: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (kitchen, environment) in episode_index.environments() {
        environments.entry(kitchen).or_default().push(environment);
    }
    let of = |(kitchen, mut environments): (u32, Vec<u32>)| {
        environments.sort_unstable();
        let ends: Vec<_> =
            episode_index.newest_of(kitchen, NEWEST).filter_map(|shelved: &Shelved| shelved.end.as_ref()).collect();
        let mean = |metric: &str| {
            let sum: f64 = ends.iter().filter_map(|end| end.figures.get(metric)).sum();
            if ends.is_empty() { 0.0 } else { sum / ends.len() as f64 }
        };
        let metrics = spec.shown().into_iter().filter(|metric| metric.quotient.is_none());
        let means = metrics.map(|metric| (metric.name.clone(), mean(&metric.name))).collect();
        Kitchen { kitchen, environments, episodes: ends.len() as u64, figures: spec.with_quotients(means) }
    };
    environments.into_iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::super::roster::Roster;
    use super::*;
    use crate::training::means::tests::{history, stages};
    use crate::training::metrics;

    #[test]
    fn the_film_that_replay_made_of_an_episode_is_found_by_its_name() {
        let (_temporary, folder) = metrics::tests::run();
        let watched = Watched::of(Entry { id: String::new(), folder: folder.clone(), suite: None });
        let key = EpisodeKey { kitchen: 128, environment: 1, episode: 35 };
        assert!(watched.film(key).is_err());
        std::fs::create_dir(folder.root().join("films")).unwrap();
        std::fs::write(folder.root().join("films/environment-1-episode-000035.mp4"), "film").unwrap();
        assert_eq!(watched.film(key).unwrap(), Film { kind: "video/mp4", bytes: b"film".to_vec() });
    }

    /// Its orchestrator was killed before it wrote a rollout that its learner had saved.
    #[test]
    fn a_run_that_was_cut_off_has_one_number_of_frames() {
        let (_temporary, folder) = metrics::tests::run();
        std::fs::write(folder.metrics(), history(4).encode()).unwrap();
        let config = Config { stages: stages(), ..Config::resolve("demo", None).unwrap() };
        std::fs::write(folder.config(), config.to_toml()).unwrap();
        Identity::new().unwrap().write(&folder).unwrap();
        let status = Figures::read(&folder, true);
        assert_eq!(status.history.frames(), 300);
        assert_eq!(
            status.notes,
            ["the figures of 2 rollouts are not in metrics.jsonl and are taken from the checkpoint"]
        );
        let mut watched = Watched::of(Roster::of(vec![folder.root().to_owned()]).look().remove(0));
        let card = watched.card(LOOK).unwrap();
        assert_eq!((card.done, card.note.as_ref()), (300, Some(&status.notes[0])));
        let live = watched.live().unwrap();
        assert_eq!((live.card.done, live.rollouts, &live.notes), (300, 6, &status.notes));
        assert!(live.go_on.unwrap().ends_with(&format!(" resume {}", folder.root().display())));
        assert_eq!(watched.curves(0, 0).unwrap().frames.last(), Some(&300));
        // It goes on: the file says what the checkpoint says.
        std::fs::remove_file(folder.metrics()).unwrap();
        std::fs::write(folder.metrics(), history(7).encode()).unwrap();
        let card = watched.card(LOOK).unwrap();
        assert_eq!((card.done, card.note), (350, None));
    }
}
