//! What a group of runs came to in one field: scores of every seed in every kitchen, and their aggregates.

use crate::format::counted;
use crate::statistics::{Aggregate, CURVE_RESAMPLES, Interval, RESAMPLES, Scores, wilson};
use crate::study::{Evaluated, Field, Group, Run};
use proto::evaluation::{EpisodeRecord, Figures, OBJECT_COUNTS};
use proto::kitchen::KitchenId;
use proto::reward::UNDISTURBED_THRESHOLD_M;
use serde::Serialize;
use std::collections::BTreeSet;

/// Everything about one group in one field. Rates are shares 0..=1.
#[derive(Debug, Clone, Serialize)]
pub struct FieldResult {
    /// `test-novel`, ...
    pub field: String,
    /// Kitchens, the columns of the score matrices.
    pub kitchens: Vec<KitchenId>,
    /// One a seed, the rows of the score matrices.
    pub seeds: Vec<SeedResult>,
    /// SR.
    pub success: Aggregate,
    /// `SRwoD`: d < 0.01 m.
    pub success_without_disturbance: Aggregate,
    /// `SRwoD` by the largest displacement on an axis: no object moved more than 0.01 m on any.
    pub success_without_disturbance_per_axis: Aggregate,
    /// `SRwoD` over the threshold.
    pub by_threshold: Vec<LimitPoint>,
    /// Success with at most so many disturbed objects.
    pub by_disturbed_objects: Vec<LimitPoint>,
    /// All other figures, over the episodes of all seeds together.
    pub pooled: Figures,
    /// How often each action was taken at each step, over all seeds together: names, and \[steps\]\[actions\] counts.
    pub actions: ActionShares,
}

/// A group with its results.
#[derive(Debug, Clone)]
pub struct GroupResults<'a> {
    pub group: &'a Group<'a>,
    /// In each field in which it was evaluated.
    pub results: Vec<(Field, FieldResult)>,
}

impl GroupResults<'_> {
    pub(crate) fn in_field(&self, field: Field) -> Option<&FieldResult> {
        self.results.iter().find(|(found, _)| *found == field).map(|(_, result)| result)
    }
}

/// One seed's part.
#[derive(Debug, Clone, Serialize)]
pub struct SeedResult {
    pub seed: u64,
    /// Its folder.
    pub run: String,
    /// The evaluation that counts.
    pub evaluation: String,
    /// Frames trained on.
    pub frames: u64,
    pub episodes: u64,
    /// The most probable action instead of a sampled one.
    pub deterministic: bool,
    /// SHA-256 of the weights.
    pub weights: String,
    /// SR by kitchen.
    pub success_by_kitchen: Vec<f64>,
    /// `SRwoD` by kitchen.
    pub success_without_disturbance_by_kitchen: Vec<f64>,
    /// SR over all its episodes.
    pub success: Rate,
    /// `SRwoD` over all its episodes.
    pub success_without_disturbance: Rate,
    /// `SRwoD` by the largest displacement on an axis, over all its episodes.
    pub success_without_disturbance_per_axis: Rate,
}

/// A rate over the episodes of one policy.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rate {
    pub share: f64,
    /// Its Wilson interval: sampling of episodes only.
    pub interval: Interval,
}

/// Success within one limit on the disturbance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LimitPoint {
    /// Threshold in metres, or number of objects.
    pub at: f64,
    /// Mean over seeds and kitchens.
    pub mean: f64,
    /// Its interval; none of one seed.
    pub interval: Option<Interval>,
}

/// Counts of actions by step.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ActionShares {
    /// Names.
    pub actions: Vec<String>,
    /// \[steps\]\[actions\]
    pub counts_by_step: Vec<Vec<u64>>,
}

/// What keeps a group from having a result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Missing {
    /// No run has an evaluation in the field.
    NotEvaluated,
    /// Evaluations cannot be put into one matrix.
    Unequal(String),
}

impl FieldResult {
    /// Of a group; with the names of runs that have no evaluation in the field.
    pub(crate) fn of(group: &Group<'_>, field: Field, thresholds_m: &[f32]) -> Result<(Self, Vec<String>), Missing> {
        let evaluated: Vec<(&Run, &Evaluated)> =
            group.runs.iter().filter_map(|run| Some((*run, run.evaluation_in(field)?))).collect();
        if evaluated.is_empty() {
            return Err(Missing::NotEvaluated);
        }
        let without = group.runs.iter().filter(|run| run.evaluation_in(field).is_none());
        let without = without.map(|run| run.name.clone()).collect();
        let episodes = SeedEpisodes::of(&evaluated, field)?;
        let success = episodes.scores(&|record| record.success);
        let undisturbed = episodes.scores(&|record| record.succeeded_within(UNDISTURBED_THRESHOLD_M));
        let undisturbed_per_axis = episodes.scores(&EpisodeRecord::succeeded_undisturbed_per_axis);
        let within = |&limit_m: &f32| {
            let scores = episodes.scores(&|record| record.succeeded_within(limit_m));
            LimitPoint::of(shortest(limit_m), &scores)
        };
        let at_most = |objects: u32| {
            let scores = episodes.scores(&|record| record.success && record.disturbed_objects <= objects);
            LimitPoint::of(f64::from(objects), &scores)
        };
        let seed = |(row, ((run, evaluated), episodes)): (usize, (&(&Run, &Evaluated), &Vec<&EpisodeRecord>))| {
            SeedResult::of(run, evaluated, episodes, [success.row(row), undisturbed.row(row)])
        };
        let result = Self {
            field: field.key(),
            seeds: evaluated.iter().zip(&episodes.by_seed).enumerate().map(seed).collect(),
            success: Aggregate::of(&success, RESAMPLES),
            success_without_disturbance: Aggregate::of(&undisturbed, RESAMPLES),
            success_without_disturbance_per_axis: Aggregate::of(&undisturbed_per_axis, RESAMPLES),
            by_threshold: thresholds_m.iter().map(within).collect(),
            by_disturbed_objects: (0..OBJECT_COUNTS).map(at_most).collect(),
            pooled: Figures::of(episodes.by_seed.iter().flatten().copied()),
            actions: ActionShares::sum(evaluated.iter().map(|(_, evaluated)| *evaluated)),
            kitchens: episodes.kitchens,
        };
        Ok((result, without))
    }
}

impl SeedResult {
    /// Of a run's episodes in the field, with its SR and `SRwoD` by kitchen.
    fn of(run: &Run, evaluated: &Evaluated, episodes: &[&EpisodeRecord], by_kitchen: [&[f64]; 2]) -> Self {
        let subject = &evaluated.result.subject;
        Self {
            seed: run.config.seed,
            run: run.name.clone(),
            evaluation: evaluated.name.clone(),
            frames: subject.frames,
            episodes: episodes.len() as u64,
            deterministic: evaluated.result.conditions.deterministic,
            weights: subject.weights.clone(),
            success_by_kitchen: by_kitchen[0].to_vec(),
            success_without_disturbance_by_kitchen: by_kitchen[1].to_vec(),
            success: rate(episodes, &|record| record.success),
            success_without_disturbance: rate(episodes, &|record| record.succeeded_within(UNDISTURBED_THRESHOLD_M)),
            success_without_disturbance_per_axis: rate(episodes, &EpisodeRecord::succeeded_undisturbed_per_axis),
        }
    }
}

impl LimitPoint {
    fn of(at: f64, scores: &Scores) -> Self {
        let mean = Aggregate::of(scores, CURVE_RESAMPLES).mean;
        Self { at, mean: mean.point, interval: mean.interval }
    }
}

/// The episodes of every seed, the same ones.
struct SeedEpisodes<'a> {
    kitchens: Vec<KitchenId>,
    by_seed: Vec<Vec<&'a EpisodeRecord>>,
}

impl<'a> SeedEpisodes<'a> {
    fn of(evaluated: &[(&'a Run, &'a Evaluated)], field: Field) -> Result<Self, Missing> {
        let by_seed: Vec<Vec<&EpisodeRecord>> =
            evaluated.iter().map(|(_, evaluated)| evaluated.episodes_in(field).collect()).collect();
        Ok(Self { kitchens: same_kitchens(evaluated, &by_seed)?, by_seed })
    }

    /// The share of good episodes, \[seeds × kitchens\].
    fn scores(&self, good: &dyn Fn(&EpisodeRecord) -> bool) -> Scores {
        let row = |episodes: &Vec<&EpisodeRecord>| -> Vec<f64> {
            self.kitchens.iter().map(|&kitchen| rate_in(episodes, kitchen, good)).collect()
        };
        let rows: Vec<Vec<f64>> = self.by_seed.iter().map(row).collect();
        Scores::new(&rows).expect("one row a seed, one column a kitchen, at least one of each")
    }
}

impl ActionShares {
    /// Over several evaluations; those with other actions than the first are left out.
    fn sum<'a>(evaluations: impl Iterator<Item = &'a Evaluated>) -> Self {
        let mut sum = Self::default();
        for evaluated in evaluations {
            let counts = &evaluated.result.action_counts;
            if sum.actions.is_empty() {
                sum.actions.clone_from(&counts.actions);
            }
            if sum.actions != counts.actions {
                continue;
            }
            let steps = sum.counts_by_step.len().max(counts.by_step.len());
            sum.counts_by_step.resize(steps, vec![0; sum.actions.len()]);
            for (into, from) in sum.counts_by_step.iter_mut().zip(&counts.by_step) {
                for (into, from) in into.iter_mut().zip(from) {
                    *into += u64::from(*from);
                }
            }
        }
        sum
    }
}

/// The kitchens of all evaluations, which must be the same with equally many episodes.
fn same_kitchens(evaluated: &[(&Run, &Evaluated)], by_seed: &[Vec<&EpisodeRecord>]) -> Result<Vec<KitchenId>, Missing> {
    let chosen = |episodes: &[&EpisodeRecord]| -> BTreeSet<(KitchenId, u32)> {
        episodes.iter().map(|record| (record.kitchen, record.episode)).collect()
    };
    let (first_run, first) = (evaluated[0].0, chosen(&by_seed[0]));
    for ((run, evaluated), episodes) in evaluated.iter().zip(by_seed) {
        let these = chosen(episodes);
        if these.len() != episodes.len() {
            let problem = format!("{}: an episode stands twice in the table of {}", run.name, evaluated.name);
            return Err(Missing::Unequal(problem));
        }
        if these != first {
            let problem = format!(
                "{} was evaluated on {}, {} on {}: seeds are compared on the same episodes only",
                first_run.name,
                counted(first.len() as u64, "episode"),
                run.name,
                these.len()
            );
            return Err(Missing::Unequal(problem));
        }
    }
    Ok(first.into_iter().map(|(kitchen, _)| kitchen).collect::<BTreeSet<_>>().into_iter().collect())
}

fn rate_in(episodes: &[&EpisodeRecord], kitchen: KitchenId, good: &dyn Fn(&EpisodeRecord) -> bool) -> f64 {
    let here: Vec<_> = episodes.iter().filter(|record| record.kitchen == kitchen).collect();
    here.iter().filter(|record| good(record)).count() as f64 / here.len() as f64
}

fn rate(episodes: &[&EpisodeRecord], good: &dyn Fn(&EpisodeRecord) -> bool) -> Rate {
    let (successes, trials) = (episodes.iter().filter(|record| good(record)).count() as u64, episodes.len() as u64);
    let interval = wilson(successes, trials).expect("an evaluation in the field has episodes there");
    Rate { share: successes as f64 / trials as f64, interval }
}

/// The number that reads like the single-precision one: 0.01 and not 0.009999999776.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}
