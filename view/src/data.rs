//! What the pages show, as plain data, and what a source of runs has to answer.

use crate::feed::Feed;
use proto::replay::{RecordedEpisode, ReplaySetup};
use proto::task::Described;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Why something cannot be shown.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Problem {
    /// There is no such run, episode or kitchen.
    #[error("{0}")]
    NotThere(String),
    /// It may be there: what would tell is not read yet.
    #[error("{0}")]
    NotYet(String),
    /// It is there and cannot be read.
    #[error("{0}")]
    Unreadable(String),
}

/// A source of runs. Calls may take a second: the server makes them on threads where that is no harm.
pub trait Runs: Send + Sync + 'static {
    /// All runs and evaluations, the newest first.
    fn list(&self) -> Vec<Card>;
    fn live(&self, run: &str) -> Result<Live, Problem>;
    /// Its learning curves: those that come after the first `known` rollouts of that edition, or all if the figures
    /// were written anew since.
    fn curves(&self, run: &str, edition: u64, known: usize) -> Result<Curves, Problem>;
    /// A part of its table of episodes.
    fn episodes(&self, run: &str, query: &EpisodeQuery) -> Result<EpisodePage, Problem>;
    fn recorded(&self, run: &str, key: EpisodeKey) -> Result<(ReplaySetup, RecordedEpisode), Problem>;
    /// The newest episode of an environment, which may still go on; none if nothing was recorded of it yet.
    fn newest(&self, run: &str, kitchen: u32, environment: u32) -> Result<Option<EpisodeKey>, Problem>;
    /// What is new of it from now on, message by message.
    fn feed(&self, run: &str) -> Result<Box<dyn Feed>, Problem>;
}

/// A run or an evaluation in the list.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Card {
    /// In addresses; never a path.
    pub id: String,
    /// Its folder, as the user called it.
    pub folder: String,
    /// Preset or, of an evaluation, what it evaluates.
    pub preset: String,
    pub seed: u64,
    /// `running`, `complete`, ...
    pub state: String,
    pub evaluation: bool,
    /// When it was made, seconds since 1970.
    pub created_unix_s: u64,
    /// Frames trained on, or episodes played.
    pub done: u64,
    pub budget: u64,
    /// The task's metrics that are shown.
    pub metrics: Vec<Described>,
    /// Their means over the newest tenth of its stage, by name; without those that are not known.
    pub figures: BTreeMap<String, f64>,
    /// Time left, seconds, of one that runs.
    pub left_s: Option<f64>,
    /// What of it is not read, if something is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
    /// Why it cannot be read, if it cannot.
    pub problem: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Live {
    /// As in the list.
    pub card: Card,
    /// Stages, in order.
    pub stages: Vec<Stage>,
    /// Stage of the newest rollout.
    pub stage: Option<usize>,
    /// Frames a second, updates included: over the last rollouts, of a run at rest over all.
    pub frames_per_s: Option<f64>,
    /// Where the time goes, shares 0..1: simulate, infer, update.
    pub shares: [f64; 3],
    /// Wall time of all starts, seconds.
    pub wall_s: f64,
    /// When it was started, and by whom: one for each start of the orchestrator.
    pub starts: Vec<Start>,
    /// Learners and actors.
    pub workers: Vec<Worker>,
    /// Cores of this machine; none if the run works elsewhere or not at all.
    pub cores: Option<usize>,
    /// GPUs, where `nvidia-smi` is.
    pub gpus: Vec<Gpu>,
    /// Warnings and errors, newest last.
    pub warnings: Vec<LogLine>,
    /// The last lines of the log.
    pub log: Vec<LogLine>,
    /// Evaluations of its checkpoints on validation kitchens.
    pub validation: Vec<Validated>,
    /// Means by kitchen over the newest episodes of each; none where environments are not built in.
    pub kitchens: Vec<Kitchen>,
    pub recordings: Option<String>,
    /// Share of the recordings that the table of episodes has taken in, 0..1.
    pub indexed: f64,
    /// What is wrong with its files.
    pub notes: Vec<String>,
    /// Changes whenever the figures do.
    pub rollouts: u64,
    /// Figures of the newest rollout by name.
    pub newest: BTreeMap<String, f32>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stage {
    pub name: String,
    /// `r`, `r′` or `Lagrangian`.
    pub reward: String,
    /// Frames before it.
    pub begins_at: u64,
    pub budget: u64,
    /// Frames trained on in it.
    pub frames: u64,
    /// Means of the task's metrics over its newest tenth, by name.
    pub figures: BTreeMap<String, f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Start {
    /// From 1.
    pub number: u32,
    /// Machine and process.
    pub place: String,
    /// When, seconds since 1970.
    pub at_unix_s: u64,
    /// When it ended, if that was noted.
    pub ended_unix_s: Option<u64>,
    /// How it ended.
    pub how: Option<String>,
    /// Why, if it was said.
    pub reason: Option<String>,
}

/// A learner, an actor, or the orchestrator itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worker {
    /// `learner-0`, `actor-03`.
    pub name: String,
    /// Process, if it lives on this machine.
    pub pid: Option<u32>,
    /// Its incarnation in the newest start of the orchestrator, from 1.
    pub incarnation: u32,
    /// How often it was started in all.
    pub starts: u32,
    /// Cores that it uses, if that is known.
    pub cores: Option<f64>,
    /// Memory that only it has, bytes.
    pub memory_bytes: Option<u64>,
    /// A sentence about an actor's memory that grows without an end in sight.
    pub growth: Option<String>,
    /// It is stopped by a signal.
    pub stopped: bool,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gpu {
    pub index: u32,
    pub name: String,
    /// Share of the time in which a kernel ran, 0..1.
    pub busy: f64,
    /// Memory in use, MiB.
    pub used_mib: u64,
    /// Memory, MiB.
    pub total_mib: u64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogLine {
    pub at: String,
    /// `INFO`, `WARN`, `ERROR`; empty where there is none.
    pub level: String,
    pub text: String,
}

/// An evaluation on validation kitchens.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Validated {
    /// First rollout that is not in the checkpoint.
    pub rollout: u64,
    /// Frames that its weights were trained on.
    pub frames: u64,
    /// Means of the task's metrics, by name.
    pub figures: BTreeMap<String, f64>,
}

/// What came of the newest episodes in a kitchen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Kitchen {
    pub kitchen: u32,
    pub environments: Vec<u32>,
    /// Episodes looked at.
    pub episodes: u64,
    /// Means of the task's metrics, by name.
    pub figures: BTreeMap<String, f64>,
}

/// Learning curves: columns of equal length.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Curves {
    /// Changes when rollouts that were told before are void.
    pub edition: u64,
    /// Rollouts before the first of these.
    pub from: usize,
    /// Frames after each rollout.
    pub frames: Vec<u64>,
    pub stage: Vec<u32>,
    /// Wall time of all starts until then, seconds.
    pub elapsed_s: Vec<f64>,
    /// Figures by name; null where there is none.
    pub series: BTreeMap<String, Vec<Option<f32>>>,
    /// Name and first frame of each stage.
    pub stages: Vec<(String, u64)>,
    /// The task's metrics, those first that are shown.
    pub metrics: Vec<Described>,
    /// Those of the paper's row of this method, by name.
    pub paper: BTreeMap<String, f64>,
}

/// Which episode: kitchen, environment in it, number in the environment. In addresses `3-0-41`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EpisodeKey {
    pub kitchen: u32,
    pub environment: u32,
    pub episode: u32,
}

impl std::fmt::Display for EpisodeKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-{}-{}", self.kitchen, self.environment, self.episode)
    }
}

impl std::str::FromStr for EpisodeKey {
    type Err = Problem;
    fn from_str(text: &str) -> Result<Self, Problem> {
        let wrong = || Problem::NotThere("an episode is called KITCHEN-ENVIRONMENT-EPISODE, e.g. 3-0-41".to_owned());
        let mut parts = text.splitn(3, '-');
        let mut part = || parts.next().ok_or_else(wrong);
        let (kitchen, environment, episode) = (part()?, part()?, part()?);
        Ok(Self {
            kitchen: kitchen.parse().map_err(|_| wrong())?,
            environment: environment.parse().map_err(|_| wrong())?,
            episode: episode.parse().map_err(|_| wrong())?,
        })
    }
}

impl Serialize for EpisodeKey {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Which episodes, and in which order.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EpisodeQuery {
    /// `training`, or the folder's name of a validation; empty: what the folder is about.
    pub source: String,
    pub kitchen: Option<u32>,
    pub target: Option<String>,
    pub outcome: Option<String>,
    /// Only those that can be simulated again.
    pub recorded: Option<bool>,
    /// Column of numbers that `least` and `most` are about; empty: of none.
    pub range: String,
    /// Only with at least this in that column.
    pub least: Option<f64>,
    /// Only with at most this in that column.
    pub most: Option<f64>,
    /// Column to sort by; empty: the newest first.
    pub sort: String,
    /// The largest first.
    pub descending: bool,
    /// Rows to leave out.
    pub offset: usize,
    /// Rows at most; 0: [`ROWS`].
    pub limit: usize,
}

/// Rows of a page of the table, unless asked otherwise, and at most.
pub const ROWS: usize = 50;
/// Rows that can be asked for.
pub const ROWS_MAX: usize = 500;

/// A part of the table.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct EpisodePage {
    /// Episodes without filters.
    pub total: usize,
    /// Those that the filters let through.
    pub matching: usize,
    /// The rows asked for.
    pub rows: Vec<EpisodeRow>,
    pub kitchens: Vec<u32>,
    /// The environments are not built in, and are in no kitchen.
    pub elsewhere: bool,
    /// None of a task without targets.
    pub targets: Vec<String>,
    /// Figures that rows have, beside their length.
    pub columns: Vec<EpisodeColumn>,
    pub successes: Vec<String>,
    /// Tables that there are: `training`, and one for each validation.
    pub sources: Vec<String>,
    /// Share of the recordings that was taken in, 0..1.
    pub indexed: f64,
    /// What is wrong with the files.
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeRow {
    /// Its address; none if its actions were not recorded.
    pub key: Option<EpisodeKey>,
    pub kitchen: u32,
    /// Number: in the environment, in an evaluation in the kitchen.
    pub episode: u32,
    /// Environment; unknown of an evaluation that did not record.
    pub environment: Option<u32>,
    /// Name of the target, of a task that has targets.
    pub target: Option<String>,
    /// E.g. `success-without-disturbance`, `failure`, `time-limit`.
    pub outcome: String,
    /// Steps.
    pub length: u32,
    /// The task's metrics, and returns under its rewards, as far as they are known.
    pub figures: BTreeMap<String, f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeColumn {
    /// Its unit is its last word.
    pub name: String,
    /// What it is, as a sentence.
    pub doc: String,
    /// It is 1 or 0.
    pub is_share: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episode_s_address_is_read_as_it_is_written_and_nothing_else_is() {
        let key = EpisodeKey { kitchen: 3, environment: 0, episode: 41 };
        assert_eq!(key.to_string().parse(), Ok(key));
        for wrong in ["", "3", "3-0", "3-0-", "4294967296-0-1", "3-0-1-2", "3--1", "../3-0-1", "3-0-99999999999"] {
            assert!(wrong.parse::<EpisodeKey>().is_err(), "{wrong}");
        }
    }
}
