use crate::format::counted;
use crate::statistics::{Aggregate, CURVE_RESAMPLES, Interval, RESAMPLES, Scores, wilson};
use crate::study::{Evaluated, Field, Group, Run};
use proto::evaluation::{EpisodeRecord, Figures};
use proto::kitchen::KitchenId;
use proto::task::{Column, Curve};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

#[derive(Debug, Clone, Serialize)]
pub struct FieldResult {
    pub field: String,
    /// The field in words.
    #[serde(skip)]
    pub name: String,
    pub kitchens: Vec<KitchenId>,
    pub seeds: Vec<SeedResult>,
    pub metrics: BTreeMap<String, Aggregate>,
    pub curves: BTreeMap<String, Vec<LimitPoint>>,
    pub pooled: Figures,
    /// Of each share that is printed, by name: that of all episodes of all seeds together.
    pub rates: BTreeMap<String, Rate>,
    /// Of one seed's episodes of fixed seeds: the intervals of its evaluation, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub intervals: BTreeMap<String, Interval>,
    /// How often each action was taken at each step, over all seeds together: names, and \[steps\]\[actions\] counts.
    pub actions: ActionShares,
}

#[derive(Debug, Clone)]
pub struct GroupResults<'a> {
    pub group: &'a Group<'a>,
    pub results: Vec<(Field, FieldResult)>,
}

impl GroupResults<'_> {
    pub(crate) fn in_field(&self, field: Field) -> Option<&FieldResult> {
        self.results.iter().find(|(found, _)| *found == field).map(|(_, result)| result)
    }
}

#[derive(Debug, Clone, Serialize)]
pub struct SeedResult {
    pub seed: u64,
    pub run: String,
    pub evaluation: String,
    pub frames: u64,
    pub episodes: u64,
    pub deterministic: bool,
    pub weights: String,
    /// Of each metric that is printed, by name: its mean in each kitchen.
    pub by_kitchen: BTreeMap<String, Vec<f64>>,
    pub rates: BTreeMap<String, Rate>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rate {
    pub share: f64,
    pub interval: Interval,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LimitPoint {
    pub at: f64,
    pub mean: f64,
    pub interval: Option<Interval>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ActionShares {
    pub actions: Vec<String>,
    /// \[steps\]\[actions\]
    pub counts_by_step: Vec<Vec<u64>>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Missing {
    NotEvaluated,
    Unequal(String),
}

impl FieldResult {
    /// Of a group; with the names of runs that have no evaluation in the field. `limits`: of the task's first curve, instead
    /// of its own.
    pub(crate) fn of(group: &Group<'_>, field: Field, limits: Option<&[f32]>) -> Result<(Self, Vec<String>), Missing> {
        let evaluated = alike(&group.runs, field);
        if evaluated.is_empty() {
            return Err(Missing::NotEvaluated);
        }
        let without = group.runs.iter().filter(|run| run.evaluation_in(field).is_none());
        let without = without.map(|run| run.name.clone()).collect();
        let episodes = SeedEpisodes::of(&evaluated, field)?;
        let spec = group.runs[0].config.spec();
        let printed = || spec.columns().into_iter().enumerate().filter(|(_, column)| !column.label.is_empty());
        let scores: BTreeMap<String, Scores> = printed()
            .filter_map(|(index, one)| {
                Some((one.name, episodes.scores(&|record| record.number(Column::Number(index)))?))
            })
            .collect();
        let shares: Vec<(String, Column)> = printed()
            .filter(|(_, one)| one.is_share() && scores.contains_key(&one.name))
            .map(|(index, one)| (one.name, Column::Number(index)))
            .collect();
        let curve = |(place, curve): (usize, &Curve)| {
            let point = |&limit: &f32| {
                let within = spec.is_within(curve, limit);
                let scores = episodes.scores(&|record| Some(f64::from(u8::from(within(record)))))?;
                Some(LimitPoint::of(shortest(limit), &scores))
            };
            let limits = limits.filter(|_| place == 0).unwrap_or_else(|| curve.limits().0);
            (curve.name.clone(), limits.iter().filter_map(point).collect())
        };
        let rates_of = |episodes: &[&EpisodeRecord]| {
            shares.iter().map(|(name, column)| (name.clone(), rate(episodes, *column))).collect()
        };
        let seed = |(row, ((run, evaluated), episodes)): (usize, (&(&Run, &Evaluated), &Vec<&EpisodeRecord>))| {
            let by_kitchen = scores.iter().map(|(name, scores)| (name.clone(), scores.row(row).to_vec()));
            let subject = &evaluated.result.subject;
            SeedResult {
                seed: run.config.seed,
                run: run.name.clone(),
                evaluation: evaluated.name.clone(),
                frames: subject.frames,
                episodes: episodes.len() as u64,
                deterministic: evaluated.result.conditions.deterministic,
                weights: subject.weights.clone(),
                by_kitchen: by_kitchen.collect(),
                rates: rates_of(episodes),
            }
        };
        let result = Self {
            field: field.key(),
            name: field.name(),
            seeds: evaluated.iter().zip(&episodes.by_seed).enumerate().map(seed).collect(),
            metrics: scores.iter().map(|(name, scores)| (name.clone(), Aggregate::of(scores, RESAMPLES))).collect(),
            rates: rates_of(&episodes.by_seed.concat()),
            intervals: match &evaluated[..] {
                [(_, only)] => {
                    let interval = |(name, &[low, high]): (&String, &[f64; 2])| (name.clone(), Interval { low, high });
                    only.result.intervals.iter().map(interval).collect()
                }
                _ => BTreeMap::new(),
            },
            curves: spec.curves.iter().enumerate().map(curve).collect(),
            pooled: Figures::of(spec, episodes.by_seed.iter().flatten().copied()),
            actions: ActionShares::sum(evaluated.iter().map(|(_, evaluated)| *evaluated)),
            kitchens: episodes.kitchens,
        };
        Ok((result, without))
    }
}

impl LimitPoint {
    fn of(at: f64, scores: &Scores) -> Self {
        let mean = Aggregate::of(scores, CURVE_RESAMPLES).mean;
        Self { at, mean: mean.point, interval: mean.interval }
    }
}

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

    /// The mean of a number of each episode, \[seeds × kitchens\]; none where a kitchen's episodes do not have it.
    fn scores(&self, number: &dyn Fn(&EpisodeRecord) -> Option<f64>) -> Option<Scores> {
        let mean = |episodes: &[&EpisodeRecord], kitchen: KitchenId| {
            let here = episodes.iter().filter(|record| record.kitchen == kitchen);
            let numbers: Vec<f64> = here.filter_map(|record| number(record)).collect();
            (!numbers.is_empty()).then(|| numbers.iter().sum::<f64>() / numbers.len() as f64)
        };
        let row = |episodes: &Vec<&EpisodeRecord>| -> Option<Vec<f64>> {
            self.kitchens.iter().map(|&kitchen| mean(episodes, kitchen)).collect()
        };
        let rows: Vec<Vec<f64>> = self.by_seed.iter().map(row).collect::<Option<_>>()?;
        Some(Scores::new(&rows).expect("one row a seed, one column a kitchen, at least one of each"))
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

/// Of each run with an evaluation in the field that of its newest weights: on the most episodes that all have in common,
/// or, where no evaluations are of the same episodes, on the most.
fn alike<'a>(runs: &[&'a Run], field: Field) -> Vec<(&'a Run, &'a Evaluated)> {
    let ranked = runs.iter().map(|run| (*run, run.ranked_in(field))).filter(|(_, ranked)| !ranked.is_empty());
    let ranked: Vec<(&Run, Vec<&Evaluated>)> = ranked
        .map(|(run, mut ranked)| {
            let newest = ranked[0].result.subject.frames;
            ranked.retain(|evaluated| evaluated.result.subject.frames == newest);
            (run, ranked)
        })
        .collect();
    let episodes = |evaluated: &Evaluated| -> BTreeSet<(KitchenId, u32)> {
        evaluated.episodes_in(field).map(|record| (record.kitchen, record.episode)).collect()
    };
    let same_as = |one: &&Evaluated| {
        let wanted = episodes(one);
        let same = |ranked: &[&'a Evaluated]| ranked.iter().copied().find(|other| episodes(other) == wanted);
        ranked.iter().map(|(run, ranked)| Some((*run, same(ranked)?))).collect::<Option<Vec<_>>>()
    };
    let shared = ranked.first().and_then(|(_, first)| first.iter().find_map(same_as));
    shared.unwrap_or_else(|| ranked.iter().map(|(run, ranked)| (*run, ranked[0])).collect())
}

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

fn rate(episodes: &[&EpisodeRecord], column: Column) -> Rate {
    let (successes, trials) = (episodes.iter().filter(|record| record.has_all(&[column])).count(), episodes.len());
    let interval = wilson(successes as u64, trials as u64).expect("an evaluation in the field has episodes there");
    Rate { share: successes as f64 / trials as f64, interval }
}

/// The number that reads like the single-precision one: 0.01 and not 0.009999999776.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}
