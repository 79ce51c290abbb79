//! The figures of a run as TensorBoard event files ([`events`]): a folder for each stage, because each has a reward of
//! its own, and one for the validations. Steps are frames.
//!
//! Whenever a learner begins, the files are compared with what `metrics.jsonl` says by then: a new file voids what was
//! written and does not count any more, and has what was never written. So the state is in the files alone, and
//! whoever is killed, each step is shown once. A board that cannot be written costs a warning, never the run.

mod events;

use crate::run::identity::{host_name, unix_now};
use crate::training::scores::Score;
use anyhow::Result;
use events::{EventFile, Point, marks_in};
use proto::config::{Config, StageConfig};
use proto::metric;
use proto::run_folder::RunFolder;
use proto::task::Spec;
use proto::trained::{History, Trained};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::PathBuf;

/// Tags that others use, too (CleanRL's); every other figure keeps its name.
const TAGS: [(&str, &str); 12] = [
    (metric::EPISODES, "charts/episodes"),
    (metric::RETURN, "charts/episodic_return"),
    (metric::LENGTH, "charts/episodic_length"),
    (metric::REWARD, "charts/reward"),
    (metric::LEARNING_RATE, "charts/learning_rate"),
    (metric::POLICY_LOSS, "losses/policy_loss"),
    (metric::VALUE_LOSS, "losses/value_loss"),
    (metric::AUXILIARY_LOSS, "losses/auxiliary_loss"),
    (metric::ENTROPY, "losses/entropy"),
    (metric::CLIP_FRACTION, "losses/clipfrac"),
    (metric::APPROXIMATE_KL, "losses/approx_kl"),
    (metric::GRADIENT_NORM, "losses/gradient_norm"),
];

fn tag(task: &Spec, name: &str) -> String {
    let known = || TAGS.iter().find(|(metric, _)| *metric == name).map_or(name, |(_, tag)| tag).to_owned();
    metric::of_task(name).map_or_else(known, |name| tag_of_task(task, name))
}

fn tag_of_task(task: &Spec, name: &str) -> String {
    let rate = if task.columns().iter().any(|one| one.name == name && one.is_share()) { "_rate" } else { "" };
    format!("charts/{name}{rate}")
}

const VALIDATION: &str = "validation";

pub struct Board {
    root: PathBuf,
    task: &'static Spec,
    stages: Vec<String>,
    name: String,
    files: HashMap<String, EventFile>,
    validated: Option<usize>,
    /// Something could not be written: nothing more is, until a learner begins.
    given_up: bool,
}

impl Board {
    pub fn of(folder: &RunFolder, config: &Config, incarnation: u32) -> Self {
        let plain = |name: &str| name.replace(|letter: char| !letter.is_ascii_alphanumeric(), "-");
        let stage = |(number, stage): (usize, &StageConfig)| format!("stage-{}-{}", number + 1, plain(&stage.name));
        Self {
            root: folder.tensorboard(),
            task: config.spec(),
            stages: config.stages.iter().enumerate().map(stage).collect(),
            name: format!("{}.{incarnation:03}", host_name()),
            files: HashMap::new(),
            validated: None,
            given_up: false,
        }
    }

    pub fn begin(&mut self, history: &History) {
        self.given_up = false;
        self.attempt(|board| board.agree(history));
    }

    pub fn rollout(&mut self, history: &History) {
        self.attempt(|board| {
            let mut newest = history.iter().rev();
            let Some(trained) = newest.next() else { return Ok(()) };
            let point = point_of(board.task, newest.next(), trained);
            board.add(&board.stage(trained), &point)
        });
    }

    pub fn validations(&mut self, scores: &[Score]) {
        if self.validated == Some(scores.len()) {
            return;
        }
        self.attempt(|board| {
            let mut wanted: Vec<Point> = scores.iter().map(|score| point_of_score(board.task, score)).collect();
            wanted.sort_by_key(|point| point.step);
            board.have_say(VALIDATION, wanted.into_iter())?;
            board.validated = Some(scores.len());
            Ok(())
        });
    }

    /// Whether the files say what happened. Where something could not be written, all of it is tried once more.
    pub fn is_whole(&mut self, history: &History, scores: &[Score]) -> bool {
        if self.given_up {
            self.begin(history);
            self.validations(scores);
        }
        !self.given_up
    }

    fn attempt(&mut self, write: impl FnOnce(&mut Self) -> Result<()>) {
        if self.given_up {
            return;
        }
        if let Err(error) = write(self) {
            self.given_up = true;
            // The last record may be torn: what comes next goes into new files.
            self.files.clear();
            tracing::warn!("TensorBoard's files are not written until a learner begins again: {error:#}");
        }
    }

    fn stage(&self, trained: &Trained) -> String {
        stage_of(&self.stages, trained)
    }

    fn agree(&mut self, history: &History) -> Result<()> {
        // A stage without rollouts has nothing to say: what it said before a learner went back is void.
        let mut folders: BTreeSet<String> = self.stages.iter().cloned().collect();
        folders.extend(history.iter().map(|trained| self.stage(trained)));
        // A point for each rollout is made when it is its turn: all of a long run together are tens of megabytes.
        for folder in folders {
            let before = [None].into_iter().chain(history.iter().map(Some));
            let (stages, task) = (self.stages.clone(), self.task);
            let own = before.zip(history.iter()).filter(|(_, trained)| stage_of(&stages, trained) == folder);
            self.have_say(&folder, own.map(|(before, trained)| point_of(task, before, trained)))?;
        }
        Ok(())
    }

    fn have_say(&mut self, folder: &str, wanted: impl Iterator<Item = Point>) -> Result<()> {
        let written = marks_in(&self.root.join(folder));
        let (mut written, mut wanted) = (written.into_iter().peekable(), wanted.peekable());
        while let (Some(found), Some(point)) = (written.peek(), wanted.peek())
            && *found == point.mark()
        {
            written.next();
            wanted.next();
        }
        let Some(found) = written.next() else {
            return wanted.try_for_each(|point| self.add(folder, &point));
        };
        self.files.remove(folder);
        let void_from = wanted.peek().map_or(found.step, |point| point.step.min(found.step));
        let mut file = EventFile::create(&self.root.join(folder), &self.name, unix_now(), Some(void_from))?;
        wanted.try_for_each(|point| file.append(&point))?;
        self.files.insert(folder.to_owned(), file);
        Ok(())
    }

    fn add(&mut self, folder: &str, point: &Point) -> Result<()> {
        if !self.files.contains_key(folder) {
            let file = EventFile::create(&self.root.join(folder), &self.name, unix_now(), None)?;
            self.files.insert(folder.to_owned(), file);
        }
        self.files.get_mut(folder).map_or(Ok(()), |file| file.append(point))
    }
}

fn stage_of(stages: &[String], trained: &Trained) -> String {
    let number = trained.stage as usize;
    stages.get(number).cloned().unwrap_or_else(|| format!("stage-{}", number + 1))
}

fn point_of(task: &Spec, before: Option<&Trained>, trained: &Trained) -> Point {
    let mut values: BTreeMap<String, f32> =
        trained.metrics.iter().map(|(name, value)| (tag(task, name), value as f32)).collect();
    let timing = &trained.timing;
    let frames_before = match before {
        Some(before) => (before.rollout + 1 == trained.rollout).then_some(before.frames),
        None => (trained.rollout == 0).then_some(0),
    };
    let frames = frames_before.and_then(|before| trained.frames.checked_sub(before));
    if let Some(frames) = frames.filter(|_| timing.total_s() > 0.0) {
        values.insert("charts/SPS".to_owned(), (frames as f64 / timing.total_s()) as f32);
    }
    if timing.exchange_s > 0.0 {
        values.insert("time/exchange_s".to_owned(), timing.exchange_s as f32);
    }
    for (tag, seconds) in [
        ("time/simulate_s", timing.simulate_s),
        ("time/infer_s", timing.infer_s),
        ("time/update_s", timing.update_s),
        ("time/other_s", timing.other_s),
    ] {
        values.insert(tag.to_owned(), seconds as f32);
    }
    Point { step: trained.frames, at_unix_s: trained.at_unix_s, values }
}

fn point_of_score(task: &Spec, score: &Score) -> Point {
    let of_task = score.figures.iter().map(|(name, value)| (tag_of_task(task, name), *value as f32));
    let values = of_task.chain([("charts/episodic_length".to_owned(), score.length as f32)]).collect();
    Point { step: score.frames, at_unix_s: score.at_unix_s, values }
}

#[cfg(test)]
mod tests;
