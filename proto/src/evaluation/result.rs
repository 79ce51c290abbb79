use super::asked::ObjectSet;
use super::distribution::{Distribution, describe};
use super::figures::Figures;
use super::interval::intervals;
use super::record::EpisodeRecord;
use crate::kitchen::{KitchenId, KitchenRange, Split, TargetCategory};
use crate::task::{ActionSpace, Described, Spec};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

/// Name of the result file in an evaluation's folder.
pub const RESULT_FILE: &str = "evaluation.json";
/// Name of the per-episode table in an evaluation's folder.
pub const TABLE_FILE: &str = "episodes.csv";

/// Number of the result file's form. One of an older form has none; the programs of commit 0e4cae3e read it.
const FORMAT: u32 = 2;

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    pub preset: String,
    pub seed: u64,
    /// The run folder; none for weights that no run has trained.
    pub run: Option<String>,
    /// Id of that run, whatever folder it lies in. None as above, and where an older version evaluated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run_id: Option<String>,
    /// Manifest of the checkpoint; none for weights that no run has trained.
    pub checkpoint: Option<String>,
    pub frames: u64,
    /// SHA-256 of the weights, 64 hex digits.
    pub weights: String,
    pub parameters: u64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Conditions {
    /// Kitchens; train where they are scenes or procedural ones.
    pub split: Split,
    /// Procedural kitchens; none where it is a split or scenes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub procedural: Option<KitchenRange>,
    /// Scenes, as the evaluation's configuration names them; empty where kitchens are built in.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scenes: Vec<String>,
    pub objects: ObjectSet,
    /// Episodes of each kitchen and object set at most; 0 = all. Of fixed seeds: so many, 0 = 100.
    pub episodes: u32,
    #[serde(default)]
    pub distribution: Distribution,
    /// Robots started at most this far from the target, metres; 0 = anywhere in the kitchen, as in fixed episodes.
    #[serde(default)]
    pub start_distance_max_m: f32,
    /// Goals lay at most this far from the target's start, metres; 0 = anywhere in the kitchen.
    #[serde(default)]
    pub goal_distance_max_m: f32,
    /// The most probable action instead of a sampled one.
    pub deterministic: bool,
    /// Seed of the action noise.
    pub seed: u64,
    pub max_steps: u32,
    pub action_space: ActionSpace,
    pub actors: u32,
    pub environments_per_actor: u32,
    /// Device of the inference, e.g. `cpu, 1 thread` or `cuda:0, bfloat16 encoder`; float32 unless stated.
    pub device: String,
}

impl Conditions {
    /// Which episodes were played, as people read it.
    pub fn episodes_played(&self) -> String {
        describe(self.distribution, self.start_distance_max_m, self.goal_distance_max_m)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Cost {
    /// When it ended, seconds since 1970.
    pub at_unix_s: u64,
    /// From the first action to the last, seconds.
    pub wall_s: f64,
    pub steps: u64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KitchenFigures {
    pub kitchen: KitchenId,
    pub figures: Figures,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CategoryFigures {
    pub category: TargetCategory,
    pub figures: Figures,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObjectSetFigures {
    /// Novel or seen, never all.
    pub objects: ObjectSet,
    pub figures: Figures,
}

/// How often each action was taken at each step.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActionCounts {
    /// Names of the actions, in the order of the columns.
    pub actions: Vec<String>,
    /// \[`max_steps`\]\[actions\]: episodes in which that action was taken at that step. A row's sum is the number of
    /// episodes that had not ended before the step.
    pub by_step: Vec<Vec<u32>>,
}

/// The result file, `evaluation.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    format: u32,
    pub task: String,
    /// What its numbers are, of an episode and over episodes.
    pub described: Vec<Described>,
    pub subject: Subject,
    pub conditions: Conditions,
    pub cost: Cost,
    pub overall: Figures,
    /// 95% intervals of the means of each return and metric, by name: percentiles of a bootstrap over the episodes. Only of
    /// episodes of fixed seeds: those of a kitchen are not independent.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub intervals: BTreeMap<String, [f64; 2]>,
    /// Novel and seen, if requested; none of a task without targets.
    pub object_sets: Vec<ObjectSetFigures>,
    /// By kitchen, ascending; none of episodes of fixed seeds.
    pub kitchens: Vec<KitchenFigures>,
    /// By category, in wire order, for the requested ones.
    pub categories: Vec<CategoryFigures>,
    pub action_counts: ActionCounts,
}

impl Evaluation {
    /// Sums up: `records` in table order ([`super::Plan::episodes`]), with the actions taken in each (indices
    /// of the task's).
    pub fn of(
        spec: &Spec,
        subject: Subject,
        conditions: Conditions,
        cost: Cost,
        records: &[(EpisodeRecord, Vec<u8>)],
    ) -> Self {
        let figures = |test: &dyn Fn(&EpisodeRecord) -> bool| {
            Figures::of(spec, records.iter().map(|(record, _)| record).filter(|record| test(record)))
        };
        let object_sets = [ObjectSet::Novel, ObjectSet::Seen]
            .map(|objects| ObjectSetFigures { objects, figures: figures(&|record| record.is_in(objects)) });
        let in_kitchens = records.iter().filter(|_| conditions.distribution != Distribution::Seeds);
        let kitchens = in_kitchens.map(|(record, _)| record.kitchen).collect::<BTreeSet<_>>();
        let kitchens = kitchens
            .into_iter()
            .map(|kitchen| KitchenFigures { kitchen, figures: figures(&|record| record.kitchen == kitchen) });
        let categories = TargetCategory::ALL.map(|category| CategoryFigures {
            category,
            figures: figures(&|record| record.category == Some(category)),
        });
        Self {
            format: FORMAT,
            task: spec.name.clone(),
            described: spec.described(),
            overall: figures(&|_| true),
            intervals: match conditions.distribution {
                Distribution::Seeds => intervals(spec, records.iter().map(|(record, _)| record)),
                Distribution::Fixed | Distribution::Run => BTreeMap::new(),
            },
            object_sets: object_sets.into_iter().filter(|set| set.figures.episodes > 0).collect(),
            kitchens: kitchens.collect(),
            categories: categories.into_iter().filter(|category| category.figures.episodes > 0).collect(),
            action_counts: ActionCounts::of(
                spec,
                conditions.action_space,
                conditions.max_steps,
                records.iter().map(|(_, actions)| actions.as_slice()),
            ),
            subject,
            conditions,
            cost,
        }
    }

    pub fn read(file: impl Read) -> Result<Self, ResultError> {
        // The number first: a file of another form cannot be read by this one's rules.
        let value: serde_json::Value = serde_json::from_reader(file)?;
        match value["format"].as_u64() {
            Some(format) if format != u64::from(FORMAT) => Err(ResultError::Format(format)),
            // Older ones had the number of all files there.
            None if value["schema_version"].is_u64() => Err(ResultError::Older),
            _ => Ok(serde_json::from_value(value)?),
        }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum ResultError {
    #[error("it is the result of an older version, which the programs of commit 0e4cae3e read (evaluate again)")]
    Older,
    #[error("it has format {0}, and this program reads format {FORMAT} (evaluate again)")]
    Format(u64),
    #[error("it is damaged (delete its folder, and evaluate again)")]
    Json(#[from] serde_json::Error),
}

impl ActionCounts {
    /// Counts the actions of episodes of at most `max_steps` steps. What does not belong to the action space is left out:
    /// a policy cannot take it.
    fn of<'a>(spec: &Spec, space: ActionSpace, max_steps: u32, episodes: impl Iterator<Item = &'a [u8]>) -> Self {
        let actions = space.of(&spec.actions).unwrap_or_default();
        let mut by_step = vec![vec![0; actions.len()]; max_steps as usize];
        for episode in episodes {
            for (row, taken) in by_step.iter_mut().zip(episode) {
                if let Some(column) = actions.iter().position(|action| action == taken) {
                    row[column] += 1;
                }
            }
        }
        let name = |action: u8| spec.actions.names()[usize::from(action)].clone();
        Self { actions: actions.into_iter().map(name).collect(), by_step }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_of_every_episode_is_counted_once() {
        let (ahead, done) = (16, 20);
        let spec = Spec::named("arm_point_nav").unwrap();
        let episodes: [&[u8]; 2] = [&[ahead, ahead, done], &[done]];
        let counts = ActionCounts::of(spec, ActionSpace::default(), 5, episodes.into_iter());
        assert_eq!((counts.actions.len(), counts.by_step.len()), (21, 5));
        let sums: Vec<u32> = counts.by_step.iter().map(|row| row.iter().sum()).collect();
        assert_eq!(sums, [2, 1, 1, 0, 0]);
        assert_eq!((counts.by_step[0][16], counts.by_step[0][20], counts.by_step[2][20]), (1, 1, 1));
        let small = ActionCounts::of(spec, ActionSpace::named("small").unwrap(), 5, episodes.into_iter());
        assert_eq!((small.actions.len(), small.by_step[1].iter().sum::<u32>()), (13, 1));
    }
    #[test]
    fn a_result_of_another_form_is_refused_with_a_sentence() {
        let refused = |text: &str| Evaluation::read(text.as_bytes()).unwrap_err().to_string();
        assert!(refused("{\"schema_version\": 3}").contains("which the programs of commit 0e4cae3e read"));
        assert!(refused("{\"format\": 3}").contains("has format 3, and this program reads format 2"));
        for damaged in ["{", "{}", "[]", "{\"format\": 2}", "{\"format\": \"2\"}"] {
            assert!(refused(damaged).contains("it is damaged"), "{damaged}");
        }
    }
}
