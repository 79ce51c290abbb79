use super::field::{Field, Source};
use proto::config::Config;
use proto::evaluation::{Distribution, EpisodeRecord, Evaluation};
use proto::figures::Figures;
use proto::run_folder::BEST;
use proto::run_state::RunState;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone)]
pub struct Run {
    pub name: String,
    pub origin: Origin,
    pub config: Config,
    pub rollouts: Vec<Rollout>,
    /// Of each stage, means of the task's metrics and of the return over its newest tenth, by name: as the run itself
    /// shows them. Empty of one that has not begun.
    pub stages: Vec<BTreeMap<String, f64>>,
    pub evaluations: Vec<Evaluated>,
    pub validation: Vec<Validated>,
}

/// Who trained the weights of a [`Run`]. Its text is that of the page and of `report.json`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    Run(RunState),
    NotGiven,
    Untrained,
    /// Nothing but a policy file of this name is known.
    Policy(String),
    Unknown,
}

impl Origin {
    pub(crate) fn trained(&self) -> Option<bool> {
        match self {
            Self::Run(_) | Self::NotGiven => Some(true),
            Self::Untrained => Some(false),
            Self::Policy(_) | Self::Unknown => None,
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Run(state) => state.fmt(f),
            Self::NotGiven => f.write_str("its run was not given"),
            Self::Untrained => f.write_str("untrained"),
            Self::Policy(file) => write!(f, "of the file {file}"),
            Self::Unknown => f.write_str("its run cannot be found"),
        }
    }
}

impl Serialize for Origin {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rollout {
    pub frames: u64,
    pub frames_per_s: Option<f64>,
    pub elapsed_s: f64,
    /// Figures: see [`proto::metric`]. Rollouts share their names, of which a run has hundreds of thousands.
    pub metrics: Figures,
}

const FRAMES_PER_S: &str = "time/frames_per_second";
const ELAPSED_S: &str = "time/elapsed_s";

impl Rollout {
    pub(crate) fn get(&self, name: &str) -> Option<f64> {
        match name {
            FRAMES_PER_S => self.frames_per_s,
            ELAPSED_S => Some(self.elapsed_s),
            _ => self.metrics.get(name),
        }
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.metrics.names().chain(self.frames_per_s.map(|_| FRAMES_PER_S)).chain([ELAPSED_S])
    }
}

#[derive(Debug, Clone)]
pub struct Evaluated {
    pub name: String,
    pub folder: PathBuf,
    pub result: Evaluation,
    pub episodes: Vec<EpisodeRecord>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Validated {
    pub frames: u64,
    pub distribution: Distribution,
    pub figures: BTreeMap<String, f64>,
}

impl Evaluated {
    /// Whether its weights were asked for as the run's best: by the folder of their checkpoint, `RUN/best`.
    fn of_best(&self) -> bool {
        let checkpoint = self.result.subject.checkpoint.as_deref().map(Path::new);
        checkpoint.and_then(Path::parent).and_then(Path::file_name).is_some_and(|folder| folder == BEST)
    }

    pub(crate) fn episodes_in(&self, field: Field) -> impl Iterator<Item = &EpisodeRecord> {
        let conditions = &self.result.conditions;
        let in_field = conditions.split == field.split
            && Source::of(conditions) == field.source
            && (self.of_best(), conditions.deterministic) == (field.best, field.deterministic);
        self.episodes.iter().filter(move |record| in_field && record.is_in(field.objects))
    }
}

impl Run {
    /// The evaluation that represents this run in a field: of the newest checkpoint that was evaluated there, by
    /// frames; of that the one with the most episodes, then the newest.
    pub(crate) fn evaluation_in(&self, field: Field) -> Option<&Evaluated> {
        self.ranked_in(field).into_iter().next()
    }

    /// All of them, that which counts first.
    pub(crate) fn ranked_in(&self, field: Field) -> Vec<&Evaluated> {
        let rank = |evaluated: &&Evaluated| {
            let frames = evaluated.result.subject.frames;
            (frames, evaluated.episodes_in(field).count(), evaluated.result.cost.at_unix_s)
        };
        let mut ranked: Vec<&Evaluated> = self.evaluations_in(field).collect();
        // The last of equals first.
        ranked.sort_by_key(rank);
        ranked.reverse();
        ranked
    }

    pub(crate) fn evaluations_in(&self, field: Field) -> impl Iterator<Item = &Evaluated> {
        self.evaluations.iter().filter(move |evaluated| evaluated.episodes_in(field).next().is_some())
    }
}
