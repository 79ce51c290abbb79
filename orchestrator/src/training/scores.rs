//! `validation.jsonl`: one JSON object an evaluation of a checkpoint, in order of their rollouts.
//!
//! Each evaluation's result file lies in `RUN/validation/rollout-K/result/`, so a line that is missing or damaged is
//! made from it.

use crate::output::format::counted;
use crate::run::json_lines;
use crate::training::means::known;
use crate::training::metrics::left_out;
use anyhow::{Context, Result};
use proto::bounded::RESULT_BYTES_MOST;
use proto::evaluation::{Distribution, Evaluation, Figures, RESULT_FILE};
use proto::run_folder::{RolloutName, RunFolder};
use proto::task::{Metric, Spec};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// First rollout that is not in the checkpoint.
    pub rollout: u64,
    pub frames: u64,
    pub weights: String,
    pub result: String,
    pub episodes: u64,
    #[serde(default)]
    pub distribution: Distribution,
    pub length: f64,
    pub at_unix_s: u64,
    pub wall_s: f64,
    #[serde(flatten, deserialize_with = "known")]
    pub figures: BTreeMap<String, f64>,
}

impl Score {
    pub fn of(rollout: u64, evaluation: &Evaluation, task: &Spec) -> Self {
        let overall = &evaluation.overall;
        Self {
            rollout,
            frames: evaluation.subject.frames,
            weights: evaluation.subject.weights.clone(),
            result: format!("{}/result", RunFolder::relative_validation(rollout)),
            episodes: overall.episodes,
            distribution: evaluation.conditions.distribution,
            length: overall.get("length").unwrap_or(0.0),
            at_unix_s: evaluation.cost.at_unix_s,
            wall_s: evaluation.cost.wall_s,
            figures: figures_of(overall, task),
        }
    }

    /// At least as good: by the task's ranks, then the longer training.
    fn beats(&self, other: &Self, task: &Spec) -> bool {
        let key = |one: &Self| {
            task.ranking().into_iter().map(|metric| one.figures.get(&metric.name).copied()).collect::<Vec<_>>()
        };
        match key(self).partial_cmp(&key(other)) {
            Some(std::cmp::Ordering::Equal) | None => self.frames >= other.frames,
            Some(order) => order.is_gt(),
        }
    }
}

pub fn figures_of(overall: &Figures, task: &Spec) -> BTreeMap<String, f64> {
    let known = |metric: &Metric| Some((metric.name.clone(), overall.get(&metric.name)?));
    task.metrics.iter().filter_map(known).collect()
}

pub fn best<'a>(scored: &'a [Score], task: &Spec) -> Option<&'a Score> {
    scored.iter().reduce(|best, one| if one.beats(best, task) { one } else { best })
}

pub fn read_result(result: &RunFolder) -> Result<Evaluation> {
    let path = result.root().join(RESULT_FILE);
    let file = result.reader(&path, RESULT_BYTES_MOST).with_context(|| path.display().to_string())?;
    Evaluation::read(file).with_context(|| path.display().to_string())
}

pub fn result_folder(folder: &RunFolder, rollout: u64) -> RunFolder {
    folder.within(RunFolder::relative_validation(rollout)).within("result")
}

const EVALUATIONS_MOST: usize = 1000;

/// The evaluations in a run's folder that have a result; one that was cut off has none. What is left out is noted, as a
/// sentence without an end.
pub fn evaluations_below(folder: &RunFolder, notes: &mut Vec<String>) -> Result<Vec<RunFolder>> {
    let place = folder.root().join("evaluations");
    let items = folder.list(&place).with_context(|| place.display().to_string())?;
    let names = items.iter().filter(|item| item.is_folder).filter_map(|item| item.path.file_name());
    let folders = names.map(|name| folder.within("evaluations").within(name));
    let has_result = |one: &RunFolder| one.has(&one.root().join(RESULT_FILE));
    let mut below: Vec<RunFolder> = folders.filter(has_result).collect();
    let more = below.len().saturating_sub(EVALUATIONS_MOST);
    if more > 0 {
        let all = counted(below.len() as u64, "result");
        notes.push(format!("evaluations/ has {all}: only the last {EVALUATIONS_MOST} by name are read"));
    }
    Ok(below.split_off(more))
}

const RESULTS_BYTES_MOST: u64 = 64 << 20;

pub struct Scores {
    pub scores: Vec<Score>,
    pub notes: Vec<String>,
}

impl Scores {
    /// Reads a run's folder. `at_rest`: nobody works on the run, so every result should have its line. A file that cannot
    /// be read is left out, and named.
    pub fn read(folder: &RunFolder, task: &Spec, at_rest: bool) -> Self {
        let path = folder.validation_log();
        let mut notes = Vec::new();
        let (lines, damaged) = json_lines::read::<Score>(folder, &path, RESULT_BYTES_MOST).unwrap_or_else(|error| {
            notes.push(left_out("validation.jsonl", &error));
            (Vec::new(), 0)
        });
        if damaged > 0 {
            notes.push(format!("validation.jsonl has {}", counted(damaged as u64, "damaged line")));
        }
        let is_missing = !path.exists();
        // One that was evaluated twice, because a crash came between the result and its line, counts once.
        let mut scores: BTreeMap<u64, Score> = lines.into_iter().map(|score| (score.rollout, score)).collect();
        let mut added = 0;
        let evaluated = evaluated(folder).unwrap_or_else(|error| {
            notes.push(left_out("validation/", &error));
            Vec::new()
        });
        let mut bytes = 0;
        // The newest first.
        for (rollout, length) in evaluated.into_iter().rev() {
            if scores.contains_key(&rollout) {
                continue;
            }
            if bytes > RESULTS_BYTES_MOST {
                notes.push(format!(
                    "validation/ has more than {RESULTS_BYTES_MOST} bytes of results without a line in validation.jsonl: \
                     those before rollout {} are left out",
                    rollout + 1
                ));
                break;
            }
            // One that is refused costs little, and its sentence a little.
            bytes += length.min(RESULT_BYTES_MOST / 4);
            match read_result(&result_folder(folder, rollout)) {
                Ok(evaluation) => {
                    scores.insert(rollout, Score::of(rollout, &evaluation, task));
                    added += 1;
                }
                Err(error) => notes.push(format!("the result of a validation cannot be used: {error:#}")),
            }
        }
        if added > 0 && at_rest {
            let missing = if is_missing { "validation.jsonl is missing: " } else { "" };
            let lines = counted(added, "validation");
            notes.push(format!("{missing}{lines} without a line in it are taken from their results"));
        }
        Self { scores: scores.into_values().collect(), notes }
    }
}

fn evaluated(folder: &RunFolder) -> std::io::Result<Vec<(u64, u64)>> {
    let items = folder.list(&folder.validations())?;
    let rollouts = items.iter().filter_map(|item| RolloutName::Folder.rollout_of(&item.path));
    let with_length = |rollout: u64| {
        let result = result_folder(folder, rollout);
        Some((rollout, result.open(&result.root().join(RESULT_FILE)).ok()?.metadata().ok()?.len()))
    };
    Ok(rollouts.filter_map(with_length).collect())
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A checkpoint of 100 frames a rollout that was evaluated so.
    pub fn validated(rollout: u64, undisturbed: f64, success: f64) -> Score {
        Score {
            rollout,
            frames: rollout * 100,
            weights: "00".repeat(32),
            result: String::new(),
            episodes: 10,
            distribution: Distribution::Fixed,
            length: 1.0,
            at_unix_s: 0,
            wall_s: 1.0,
            figures: [("success", success), ("success_without_disturbance", undisturbed)]
                .map(|(name, value)| (name.to_owned(), value))
                .into(),
        }
    }

    fn task() -> &'static Spec {
        proto::config::Config::default().spec()
    }

    #[test]
    fn the_best_is_undisturbed_then_successful_then_trained_longer() {
        let mut scored = vec![validated(1, 0.1, 0.9), validated(2, 0.2, 0.3), validated(3, 0.2, 0.4)];
        assert_eq!(best(&scored, task()).unwrap().rollout, 3);
        scored.push(validated(4, 0.2, 0.4));
        scored.push(validated(5, 0.2, 0.3));
        assert_eq!(best(&scored, task()).unwrap().rollout, 4);
        assert!(best(&[], task()).is_none());
    }

    /// The others were left out in silence.
    #[test]
    fn of_more_evaluations_than_are_read_a_sentence_says_so() {
        let temporary = tempfile::tempdir().unwrap();
        for number in 0..=EVALUATIONS_MOST {
            let one = temporary.path().join(format!("evaluations/{number}"));
            std::fs::create_dir_all(&one).unwrap();
            std::fs::write(one.join(RESULT_FILE), "").unwrap();
        }
        let mut notes = Vec::new();
        let below = evaluations_below(&RunFolder::new(temporary.path()), &mut notes).unwrap();
        assert!(below.len() == EVALUATIONS_MOST && below[0].root().ends_with("evaluations/1"));
        assert_eq!(notes, ["evaluations/ has 1,001 results: only the last 1000 by name are read"]);
    }

    #[test]
    fn damaged_lines_and_results_are_told_of() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        let read = || {
            let Scores { scores, notes } = Scores::read(&folder, task(), true);
            (scores.iter().map(|score| score.rollout).collect::<Vec<_>>(), notes.join(". "))
        };
        assert_eq!(read(), (vec![], String::new()));
        let line = |rollout| serde_json::to_string(&validated(rollout, 0.0, 0.0)).unwrap();
        // Evaluated twice, in the wrong order, and one cut off by a kill, which is nobody's fault.
        std::fs::write(folder.validation_log(), [line(5), line(3), line(5), "{\"roll".into()].join("\n")).unwrap();
        assert_eq!(read(), (vec![3, 5], String::new()));
        std::fs::write(folder.validation_log(), [line(5), "garbage".into(), line(3) + "\n"].join("\n")).unwrap();
        assert_eq!(read(), (vec![3, 5], "validation.jsonl has 1 damaged line".into()));
        let result = result_folder(&folder, 8);
        std::fs::create_dir_all(result.root()).unwrap();
        std::fs::write(result.root().join(RESULT_FILE), "{}").unwrap();
        let (rollouts, notes) = read();
        assert!(
            rollouts == [3, 5] && notes.contains("cannot be used") && notes.contains("rollout-00000008"),
            "{notes}"
        );
    }
}
