use proto::replay::{RecordedEpisode, ReplaySetup};
use proto::show::ShownEpisode;
use proto::task::Described;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Problem {
    #[error("{0}")]
    NotThere(String),
    /// It may be there: what would tell is not read yet.
    #[error("{0}")]
    NotYet(String),
    #[error("{0}")]
    Unreadable(String),
}

/// A source of runs. Calls may take a second: the server makes them on threads where that is no harm.
pub trait Runs: Send + Sync + 'static {
    fn list(&self) -> Vec<Card>;
    fn live(&self, run: &str) -> Result<Live, Problem>;
    /// Its learning curves: those that come after the first `known` rollouts of that edition, or all if the figures
    /// were written anew since.
    fn curves(&self, run: &str, edition: u64, known: usize) -> Result<Curves, Problem>;
    fn episodes(&self, run: &str, query: &EpisodeQuery) -> Result<EpisodePage, Problem>;
    fn pairs(&self, runs: [&str; 2]) -> Result<Pairs, Problem>;
    fn recorded(&self, run: &str, key: EpisodeKey) -> Result<Recorded, Problem>;
    /// The newest episode of an environment, which may still go on; none if nothing was recorded of it yet.
    fn newest(&self, run: &str, kitchen: u32, environment: u32) -> Result<Option<EpisodeKey>, Problem>;
    /// The page of the run's report, or of the suite's that it is of.
    fn report(&self, run: &str) -> Result<String, Problem>;
    /// All runs of the suite that the run is of.
    fn suite(&self, run: &str) -> Result<Vec<SuiteRun>, Problem>;
    /// A film that its own environment drew of an episode.
    fn film(&self, run: &str, key: EpisodeKey) -> Result<Film, Problem>;
}

/// A recorded episode, and what its run says of it.
#[derive(Debug, Clone)]
pub struct Recorded {
    pub source: Source,
    pub made: Made,
}

#[derive(Debug, Clone)]
pub enum Source {
    /// What it is simulated from.
    Actions { setup: ReplaySetup, episode: Box<RecordedEpisode> },
    /// Of environments that are no kitchens: what was recorded of its steps.
    Steps(Box<ShownEpisode>),
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Made {
    /// As in the table of episodes: [`EpisodeRow::episode`].
    pub number: u32,
    /// The reward of the stage in which it was made.
    pub reward: Option<String>,
    /// Whether its environment is no kitchen: there are no pictures of it.
    pub elsewhere: bool,
    /// Of those: the command that makes its film.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub film: Option<String>,
    /// Whether that is made.
    pub filmed: bool,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Film {
    pub kind: &'static str,
    pub bytes: Vec<u8>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Card {
    /// In addresses; never a path.
    pub id: String,
    pub folder: String,
    /// The suite that it is of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suite: Option<String>,
    /// How that suite stands.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suite_standing: Option<SuiteStanding>,
    /// What its scenes are called, by number from that of the first scene on.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub scenes: Vec<String>,
    /// The task of environments that are no kitchens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<String>,
    /// Preset or, of an evaluation, what it evaluates.
    pub preset: String,
    pub seed: u64,
    pub state: String,
    pub evaluation: bool,
    /// Whether its environments are no kitchens.
    pub elsewhere: bool,
    /// Of an evaluation which policy plays which episodes, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conditions: Option<String>,
    /// The same in a few words, without the policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub asked: Option<String>,
    pub created_unix_s: u64,
    pub done: u64,
    pub budget: u64,
    pub metrics: Vec<Described>,
    /// Their means over the newest tenth of its stage, by name; without those that are not known.
    pub figures: BTreeMap<String, f64>,
    pub left_s: Option<f64>,
    /// The mean over its training so far, updates included.
    pub frames_per_s: Option<f64>,
    /// Path of its report's page, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub report: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
    pub problem: Option<String>,
}

impl Card {
    /// Task and preset.
    pub fn subject(&self) -> String {
        self.task.iter().chain([&self.preset]).cloned().collect::<Vec<_>>().join(", ")
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SuiteStanding {
    pub folder: String,
    /// E.g. `1 of 2 runs complete, 1 evaluating`.
    pub counts: String,
    /// Path of its report's page, where there is one.
    pub report: Option<String>,
}

/// A run of a suite, which may not have begun.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SuiteRun {
    pub name: String,
    /// E.g. `training`.
    pub state: &'static str,
    /// Of a failure.
    pub reason: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Live {
    pub card: Card,
    pub stages: Vec<Stage>,
    pub stage: Option<usize>,
    /// Frames a second, updates included: over the last rollouts, of a run at rest over all.
    pub frames_per_s: Option<f64>,
    /// Where the time goes, shares 0..1: simulate, infer, update.
    pub shares: [f64; 3],
    pub wall_s: f64,
    pub starts: Vec<Start>,
    pub workers: Vec<Worker>,
    pub cores: Option<usize>,
    pub gpus: Vec<Gpu>,
    pub warnings: Vec<LogLine>,
    pub log: Vec<LogLine>,
    pub validation: Vec<Validated>,
    pub kitchens: Vec<Kitchen>,
    pub recordings: Option<String>,
    pub indexed: f64,
    pub notes: Vec<String>,
    /// The command that goes on with a run that was cut off or stopped.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub go_on: Option<String>,
    /// Changes whenever the figures do.
    pub rollouts: u64,
    /// Of an evaluation that is complete.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub results: Option<Results>,
}

/// What an evaluation came to, as `eval` prints it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Results {
    /// Name and documentation of each column.
    pub heads: Vec<[String; 2]>,
    pub rows: Vec<ResultRow>,
    /// 95% intervals of the last row's figures, where they are known.
    pub intervals: Vec<Option<Within>>,
    /// Further ones over all episodes: name, figure with its unit, documentation.
    pub figures: Vec<[String; 3]>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Within {
    /// E.g. `Wilson's`.
    pub whose: &'static str,
    pub low: String,
    pub high: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ResultRow {
    pub name: String,
    /// What the table of episodes is asked for its episodes, e.g. `kitchen=3`.
    pub filter: Option<String>,
    pub episodes: u64,
    pub cells: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stage {
    pub name: String,
    pub reward: String,
    pub begins_at: u64,
    pub budget: u64,
    pub frames: u64,
    /// Means over its newest tenth, by name; of the return, too.
    pub figures: BTreeMap<String, f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Start {
    pub number: u32,
    pub place: String,
    pub at_unix_s: u64,
    pub how: Option<String>,
    pub reason: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worker {
    pub name: String,
    pub pid: Option<u32>,
    pub incarnation: u32,
    pub starts: u32,
    pub cores: Option<f64>,
    pub memory_bytes: Option<u64>,
    pub growth: Option<String>,
    pub stopped: bool,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gpu {
    pub index: u32,
    pub name: String,
    pub busy: f64,
    pub used_mib: u64,
    pub total_mib: u64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogLine {
    pub at: String,
    pub level: String,
    pub text: String,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Validated {
    /// First rollout that is not in the checkpoint.
    pub rollout: u64,
    pub frames: u64,
    pub figures: BTreeMap<String, f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Kitchen {
    pub kitchen: u32,
    pub environments: Vec<u32>,
    pub episodes: u64,
    pub figures: BTreeMap<String, f64>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Curves {
    /// Changes when rollouts that were told before are void.
    pub edition: u64,
    pub from: usize,
    pub frames: Vec<u64>,
    pub stage: Vec<u32>,
    pub elapsed_s: Vec<f64>,
    pub series: BTreeMap<String, Vec<Option<f32>>>,
    pub stages: Vec<(String, u64)>,
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

#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EpisodeQuery {
    /// `training`, or the folder's name of a validation; empty: what the folder is about.
    pub source: String,
    pub kitchen: Option<u32>,
    pub target: Option<String>,
    pub outcome: Option<String>,
    pub recorded: Option<bool>,
    pub range: String,
    pub least: Option<f64>,
    pub most: Option<f64>,
    pub sort: String,
    pub descending: bool,
    pub offset: usize,
    pub limit: usize,
}

pub const ROWS: usize = 50;
pub const ROWS_MAX: usize = 500;

#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct EpisodePage {
    pub total: usize,
    pub matching: usize,
    pub rows: Vec<EpisodeRow>,
    pub kitchens: Vec<u32>,
    pub elsewhere: bool,
    pub targets: Vec<String>,
    pub columns: Vec<EpisodeColumn>,
    pub successes: Vec<String>,
    pub sources: Vec<String>,
    pub indexed: f64,
    pub notes: Vec<String>,
}

/// Recorded episodes that two runs both have: in all, how many of them end better in each, and those that differ most.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Pairs {
    pub total: usize,
    pub better: [usize; 2],
    pub rows: Vec<[EpisodeRow; 2]>,
    pub indexed: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeRow {
    pub key: Option<EpisodeKey>,
    pub kitchen: u32,
    /// Number: in the environment, in an evaluation in the kitchen.
    pub episode: u32,
    pub environment: Option<u32>,
    pub target: Option<String>,
    /// E.g. `success-without-disturbance`, `failure`, `time-limit`.
    pub outcome: String,
    pub length: u32,
    pub figures: BTreeMap<String, f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeColumn {
    pub name: String,
    /// As evaluations call it.
    pub label: String,
    pub doc: String,
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
