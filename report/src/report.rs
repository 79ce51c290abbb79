use crate::comparison::{Comparison, comparisons};
use crate::curves::Curve;
use crate::format::{count, counted};
use crate::paper::paper;
use crate::results::{FieldResult, GroupResults, Missing};
use crate::statistics::{CURVE_RESAMPLES, RESAMPLES};
use crate::study::{Evaluated, Field, Group, Origin, Rollout, Run, Source, StudyError, groups};
use crate::sweep::{Sweep, sweeps};
use proto::config::{EpisodeConfig, StageConfig};
use proto::evaluation::{Distribution, ObjectSet, describe};
use proto::task::{Curve as TaskCurve, Described, Spec};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

#[derive(Debug, Clone, Serialize)]
pub struct Report {
    pub schema_version: u32,
    pub paper: String,
    pub statistics: IntervalMethod,
    pub episodes: Vec<String>,
    pub tasks: BTreeMap<String, TaskReport>,
    pub groups: Vec<GroupReport>,
    pub comparisons: Vec<Comparison>,
    pub sweeps: Vec<Sweep>,
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IntervalMethod {
    pub interval: f64,
    pub resamples: u32,
    pub curve_resamples: u32,
}

#[derive(Debug, Clone, Serialize)]
pub struct TaskReport {
    pub described: Vec<Described>,
    pub shown: Vec<Described>,
    pub ranking: Vec<String>,
    pub curves: Vec<TaskCurve>,
}

#[derive(Debug, Clone, Serialize)]
pub struct GroupReport {
    pub label: String,
    pub task: String,
    pub preset: String,
    pub differences: Vec<String>,
    pub stages: Vec<StageReport>,
    pub metrics: Vec<Described>,
    pub runs: Vec<RunReport>,
    pub results: Vec<FieldResult>,
    pub training: Vec<Curve>,
    pub validation: Vec<Curve>,
}

#[derive(Debug, Clone, Serialize)]
pub struct StageReport {
    pub name: String,
    pub reward: String,
    pub begins_at: u64,
    /// Over its newest tenth, means over the runs.
    pub figures: BTreeMap<String, f64>,
}

#[derive(Debug, Clone, Serialize)]
pub struct RunReport {
    pub name: String,
    pub state: Origin,
    pub seed: u64,
    pub frames: u64,
    pub budget: u64,
    /// The mean over its training, updates included.
    pub frames_per_s: Option<f64>,
    pub evaluations: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// Limits of the task's first curve, ascending; none: its own.
    pub limits: Option<Vec<f32>>,
}

impl Report {
    pub fn of(runs: &[Run], options: &Options, mut notes: Vec<String>) -> Result<Self, StudyError> {
        let groups = groups(runs)?;
        notes.extend(groups.iter().filter(|group| group.unknown()).map(|group| {
            let names: Vec<&str> = group.runs.iter().map(|run| run.name.as_str()).collect();
            let why = match &group.runs[0].origin {
                Origin::Policy(_) => "a policy file does not say how its weights were trained",
                _ => "the run is not where it was: give its folder, too. How the weights were trained is not known",
            };
            format!("{} ({}): {why}, so the paper's tables leave them out.", group.label, names.join(", "))
        }));
        let results = |group| GroupResults { group, results: results(group, options, &mut notes) };
        let entries: Vec<GroupResults<'_>> = groups.iter().map(results).collect();
        Ok(Self {
            schema_version: proto::SCHEMA_VERSION,
            paper: paper().source.clone(),
            statistics: IntervalMethod { interval: 0.95, resamples: RESAMPLES, curve_resamples: CURVE_RESAMPLES },
            episodes: episodes_of(&groups),
            tasks: groups.iter().map(|group| TaskReport::of(group.runs[0].config.spec())).collect(),
            groups: entries.iter().map(GroupReport::of).collect(),
            comparisons: comparisons(&entries),
            sweeps: sweeps(&entries),
            notes,
        })
    }
}

fn episodes_of(groups: &[Group<'_>]) -> Vec<String> {
    let mut found: BTreeMap<(bool, String), BTreeSet<&str>> = BTreeMap::new();
    for group in groups {
        for run in &group.runs {
            for conditions in run.evaluations.iter().map(|evaluated| &evaluated.result.conditions) {
                let drawn = conditions.distribution == Distribution::Run;
                found.entry((drawn, conditions.episodes_played())).or_default().insert(group.label.as_str());
            }
            let EpisodeConfig { start_distance_max_m, goal_distance_max_m, .. } = run.config.episode;
            for distribution in run.validation.iter().map(|point| point.distribution) {
                let drawn = distribution == Distribution::Run;
                let played = describe(distribution, start_distance_max_m, goal_distance_max_m);
                found
                    .entry((drawn, format!("{played}, in validation during training")))
                    .or_default()
                    .insert(group.label.as_str());
            }
        }
    }
    let sentence = |((drawn, played), labels): ((bool, String), BTreeSet<&str>)| {
        let labels = labels.into_iter().collect::<Vec<_>>().join(", ");
        let apart = if drawn { " Not the paper's episodes: its tables leave these figures out." } else { "" };
        // Of what was played a part may follow a colon of its own.
        format!("{labels}: figures of {}.{apart}", played.replacen(": ", ", ", 1))
    };
    found.into_iter().map(sentence).collect()
}

fn results(group: &Group<'_>, options: &Options, notes: &mut Vec<String>) -> Vec<(Field, FieldResult)> {
    let mut results = Vec::new();
    for field in Field::all() {
        match FieldResult::of(group, field, options.limits.as_deref()) {
            Ok((result, without)) => {
                if !without.is_empty() {
                    let (label, field, without) = (&group.label, field.name(), without.join(", "));
                    notes
                        .push(format!("{label}: not evaluated on {field}, and therefore not in its means: {without}."));
                }
                note_left_out(group, field, &result, notes);
                note_conditions(group, field, &result, notes);
                results.push((field, result));
            }
            Err(Missing::NotEvaluated) => {}
            Err(Missing::Unequal(problem)) => {
                notes.push(format!("{}: no result on {}. {problem}.", group.label, field.name()));
            }
        }
    }
    results
}

/// What no figure is of: evaluations of older checkpoints, and others of the same.
fn note_left_out(group: &Group<'_>, field: Field, result: &FieldResult, notes: &mut Vec<String>) {
    let counts = |run: &Run, one: &Evaluated| {
        result.seeds.iter().any(|seed| (&seed.run, &seed.evaluation) == (&run.name, &one.name))
    };
    let named = |run: &Run, one: &Evaluated| {
        let episodes = counted(one.episodes_in(field).count() as u64, "episode");
        format!("{} of {}, after {} frames, {episodes}", one.name, run.name, count(one.result.subject.frames))
    };
    let of = |run: &&Run| -> Vec<String> {
        let others = run.evaluations_in(field).filter(|one| !counts(run, one));
        others.map(|one| named(run, one)).collect()
    };
    let others: Vec<String> = group.runs.iter().flat_map(of).collect();
    if !others.is_empty() {
        notes.push(format!(
            "{}: on {}, one evaluation of each run counts: of its newest checkpoint, then with the episodes that all seeds \
             have, then with most episodes, then the newest. Left out: {}.",
            group.label,
            field.name(),
            others.join("; ")
        ));
    }
}

fn note_conditions(group: &Group<'_>, field: Field, result: &FieldResult, notes: &mut Vec<String>) {
    let is_papers = field.source == Source::Fixed && field.objects != ObjectSet::NoTargets;
    let (label, field) = (&group.label, field.name());
    let frames: BTreeSet<u64> = result.seeds.iter().map(|seed| seed.frames).collect();
    if frames.len() > 1 {
        notes.push(format!("{label}: on {field}, seeds were evaluated after different numbers of frames."));
    }
    let full = result.kitchens.len() as u64 * 360;
    let episodes = result.seeds.first().map_or(0, |seed| seed.episodes);
    if is_papers && (episodes < full || result.kitchens.len() < 5) {
        notes.push(format!(
            "{label}: on {field}, {} in {} instead of the paper's 1800 in 5.",
            counted(episodes, "episode"),
            counted(result.kitchens.len() as u64, "kitchen")
        ));
    }
}

fn ranking(spec: &Spec) -> Vec<String> {
    let ranking = spec.ranking();
    spec.metrics.iter().filter(|metric| ranking.contains(metric)).map(|metric| metric.name.clone()).collect()
}

impl TaskReport {
    fn of(spec: &Spec) -> (String, Self) {
        let (described, shown, ranking) = (spec.described(), spec.shown(), ranking(spec));
        (spec.name.clone(), Self { described, shown, ranking, curves: spec.curves.clone() })
    }
}

impl GroupReport {
    fn of(entry: &GroupResults<'_>) -> Self {
        let group = entry.group;
        let metrics: BTreeSet<&str> =
            group.runs.iter().flat_map(|run| &run.rollouts).flat_map(Rollout::names).collect();
        let ranking = ranking(group.runs[0].config.spec());
        Self {
            label: group.label.clone(),
            task: group.runs[0].config.task.clone(),
            preset: group.preset.clone(),
            differences: group.differences.clone(),
            stages: stages(group),
            metrics: group.runs[0].config.spec().charted(),
            runs: group.runs.iter().map(|run| RunReport::of(run)).collect(),
            results: entry.results.iter().map(|(_, result)| result.clone()).collect(),
            training: metrics.into_iter().filter_map(|name| Curve::of_training(group, name)).collect(),
            validation: ranking.iter().filter_map(|name| Curve::of_validation(group, name)).collect(),
        }
    }
}

fn newest_tenth(group: &Group<'_>, stage: usize) -> BTreeMap<String, f64> {
    let mut of_runs: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (name, mean) in group.runs.iter().filter_map(|run| run.stages.get(stage)).flatten() {
        of_runs.entry(name.clone()).or_default().push(*mean);
    }
    let mean = |(name, means): (String, Vec<f64>)| (name, means.iter().sum::<f64>() / means.len() as f64);
    group.runs[0].config.spec().with_quotients(of_runs.into_iter().map(mean).collect())
}

fn stages(group: &Group<'_>) -> Vec<StageReport> {
    let stage = |begins_at: &mut u64, (index, stage): (usize, &StageConfig)| {
        let (name, reward) = (stage.name.clone(), stage.reward.clone());
        let report = StageReport { name, reward, begins_at: *begins_at, figures: newest_tenth(group, index) };
        *begins_at += stage.frames;
        Some(report)
    };
    group.runs[0].config.stages.iter().enumerate().scan(0, stage).collect()
}

fn evaluated_frames(run: &Run) -> u64 {
    run.evaluations.iter().map(|evaluated| evaluated.result.subject.frames).max().unwrap_or(0)
}

impl RunReport {
    fn of(run: &Run) -> Self {
        Self {
            name: run.name.clone(),
            state: run.origin.clone(),
            seed: run.config.seed,
            frames: run.rollouts.last().map_or_else(|| evaluated_frames(run), |rollout| rollout.frames),
            budget: proto::stage::total_frames(&run.config.stages),
            frames_per_s: run
                .rollouts
                .last()
                .map(|last| last.frames as f64 / last.elapsed_s)
                .filter(|rate| rate.is_finite()),
            evaluations: run.evaluations.iter().map(|evaluated| evaluated.name.clone()).collect(),
        }
    }
}
