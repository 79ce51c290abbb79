//! Means of the metrics of many rollouts: of a stage, and of the moment. Pure.

use proto::config::StageConfig;
use proto::event::Timing;
use proto::metric;
use proto::stage::total_frames;
use proto::task::Spec;
use proto::trained::{History, Trained};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct EpisodeMeans {
    pub episodes: u64,
    pub mean_return: Option<f64>,
    #[serde(flatten, deserialize_with = "known")]
    pub figures: BTreeMap<String, f64>,
}

/// Older versions wrote null for what is not known.
pub(super) fn known<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<String, f64>, D::Error> {
    let figures = BTreeMap::<String, Option<f64>>::deserialize(deserializer)?;
    Ok(figures.into_iter().filter_map(|(name, value)| Some((name, value?))).collect())
}

impl EpisodeMeans {
    /// All that is known, by name; the return by that of its curve.
    pub fn with_return(&self) -> BTreeMap<String, f64> {
        let with_name = |mean_return| (metric::RETURN.to_owned(), mean_return);
        self.figures.clone().into_iter().chain(self.mean_return.map(with_name)).collect()
    }

    /// With the quotients that tables show, for readers that compute none.
    fn with_quotients(self, task: &Spec) -> Self {
        Self { figures: task.with_quotients(self.figures), ..self }
    }

    pub fn over<'a>(rollouts: &(impl Iterator<Item = &'a Trained> + Clone)) -> Self {
        let episodes = |trained: &Trained| trained.metrics.get(metric::EPISODES).unwrap_or(0.0);
        let mean = |name: &str| {
            let (mut sum, mut weight) = (0.0, 0.0);
            for trained in rollouts.clone() {
                if let Some(value) = trained.metrics.get(name) {
                    sum += value * episodes(trained);
                    weight += episodes(trained);
                }
            }
            (weight > 0.0).then(|| sum / weight)
        };
        let names: BTreeSet<&str> = rollouts.clone().flat_map(|trained| trained.metrics.names()).collect();
        Self {
            episodes: rollouts.clone().map(episodes).sum::<f64>() as u64,
            mean_return: mean(metric::RETURN),
            figures: names
                .into_iter()
                .filter_map(|name| Some((metric::of_task(name)?.to_owned(), mean(name)?)))
                .collect(),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageMeans {
    pub name: String,
    pub reward: String,
    pub frames: u64,
    pub budget: u64,
    /// PPO-Lagrangian's multiplier after its newest update; none in other stages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub multiplier: Option<f64>,
    pub whole: EpisodeMeans,
    pub first_tenth: EpisodeMeans,
    /// Over the last tenth of its budget; of a stage that has not got there over its newest frames, as many. Over the whole
    /// stage where no episode ended there.
    pub last_tenth: EpisodeMeans,
}

impl StageMeans {
    pub fn with_quotients(self, task: &Spec) -> Self {
        let [whole, first_tenth, last_tenth] =
            [self.whole, self.first_tenth, self.last_tenth].map(|means| means.with_quotients(task));
        Self { whole, first_tenth, last_tenth, ..self }
    }
}

/// A rollout, and how many frames of its stage come before it and before the next one.
type Placed<'a> = (u64, u64, &'a Trained);

fn rollouts_of<'a>(stages: &[StageConfig], index: usize, history: &'a History) -> Vec<Placed<'a>> {
    let start = total_frames(&stages[..index]);
    let mut before = start;
    let of_stage = history.iter().filter(|trained| trained.stage as usize == index);
    let place = of_stage.map(|trained| {
        let begin = std::mem::replace(&mut before, trained.frames.max(start));
        (begin - start, trained.frames.saturating_sub(start), trained)
    });
    place.collect()
}

/// Over the rollouts whose middle frame is in this part of the stage's budget. Where rollouts are so long that none
/// is, one stands for them.
fn over_part(rollouts: &[Placed], budget: u64, part: Range<f64>, otherwise: Option<&Placed>) -> EpisodeMeans {
    let budget = budget as f64;
    let inside = |&&(first, end, _): &&Placed| {
        let middle = f64::midpoint(first as f64, end as f64);
        middle >= part.start * budget && middle < part.end * budget
    };
    let mut chosen: Vec<&Placed> = rollouts.iter().filter(inside).collect();
    if chosen.is_empty() {
        chosen.extend(otherwise);
    }
    EpisodeMeans::over(&chosen.iter().map(|&&(_, _, trained)| trained))
}

/// Over the newest tenth of the stage's budget that there is; over all of the stage where no episode ended there.
fn newest_tenth(rollouts: &[Placed], budget: u64) -> EpisodeMeans {
    let last = rollouts.last();
    let done = last.map_or(0.0, |&(_, reached, _)| reached as f64 / budget as f64);
    let newest = over_part(rollouts, budget, done - 0.1..1.0, last);
    if newest.episodes > 0 { newest } else { over_whole(rollouts) }
}

fn over_whole(rollouts: &[Placed]) -> EpisodeMeans {
    EpisodeMeans::over(&rollouts.iter().map(|&(_, _, trained)| trained))
}

pub fn by_stage(stages: &[StageConfig], history: &History) -> Vec<StageMeans> {
    let means = stages.iter().enumerate().filter_map(|(index, stage)| {
        let rollouts = rollouts_of(stages, index, history);
        let &(_, frames, newest) = rollouts.last()?;
        Some(StageMeans {
            name: stage.name.clone(),
            reward: stage.reward.clone(),
            frames,
            budget: stage.frames,
            multiplier: newest.metrics.get(metric::MULTIPLIER),
            whole: over_whole(&rollouts),
            first_tenth: over_part(&rollouts, stage.frames, 0.0..0.1, rollouts.first()),
            last_tenth: newest_tenth(&rollouts, stage.frames),
        })
    });
    means.collect()
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recent {
    pub frames: u64,
    pub budget: u64,
    pub stage: Option<usize>,
    #[serde(default)]
    pub stage_name: Option<String>,
    pub frames_per_s: Option<f64>,
    pub simulate: f64,
    pub infer: f64,
    pub update: f64,
    /// Time left at this rate, seconds; none of a run at rest.
    pub left_s: Option<f64>,
    /// Over the newest tenth of the newest rollout's stage, as in [`StageMeans::last_tenth`]: one quantity has one
    /// figure, wherever it is shown.
    pub episodes: EpisodeMeans,
}

impl Recent {
    pub fn with_quotients(self, task: &Spec) -> Self {
        Self { episodes: self.episodes.with_quotients(task), ..self }
    }
}

/// The mean over all rollouts, updates included.
pub fn frames_per_s(history: &History) -> Option<f64> {
    let training_s: f64 = history.iter().map(|trained| trained.timing.total_s()).sum();
    (training_s > 0.0).then(|| history.frames() as f64 / training_s)
}

/// Rollouts over which a run at work has a rate.
const RECENT: usize = 8;

/// The figures of the moment. Rates are over the newest rollouts of any stage, of a run at rest, or with all its frames,
/// over all.
pub fn recent(stages: &[StageConfig], history: &History, at_rest: bool) -> Recent {
    let (frames, budget) = (history.frames(), total_frames(stages));
    let at_rest = at_rest || frames >= budget;
    let window = if at_rest { history.len() } else { RECENT };
    let newest: Vec<&Trained> = history.iter().rev().take(window).collect();
    let stage = newest.first().map(|trained| trained.stage as usize);
    let before = history.iter().rev().nth(window).map_or(0, |trained| trained.frames);
    let sum = |part: fn(&Timing) -> f64| newest.iter().map(|trained| part(&trained.timing)).sum::<f64>();
    let total = sum(Timing::total_s);
    let share = |part: f64| if total > 0.0 { part / total } else { 0.0 };
    let frames_per_s = (total > 0.0).then(|| (frames - before.min(frames)) as f64 / total);
    Recent {
        frames,
        budget,
        stage,
        stage_name: stage.and_then(|stage| stages.get(stage)).map(|stage| stage.name.clone()),
        frames_per_s,
        simulate: share(sum(|timing| timing.simulate_s)),
        infer: share(sum(|timing| timing.infer_s)),
        update: share(sum(|timing| timing.update_s)),
        left_s: frames_per_s
            .filter(|&rate| rate > 0.0 && !at_rest)
            .map(|rate| budget.saturating_sub(frames) as f64 / rate),
        episodes: stage
            .filter(|&stage| stage < stages.len())
            .map(|stage| newest_tenth(&rollouts_of(stages, stage, history), stages[stage].frames))
            .unwrap_or_default(),
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Two stages of 1000 and 500 frames.
    pub fn stages() -> Vec<StageConfig> {
        let stage = |name: &str, reward: &str, frames| StageConfig { name: name.into(), reward: reward.into(), frames };
        vec![stage("I", "r", 1000), stage("II", "r_prime", 500)]
    }

    /// Rollouts of 50 frames whose return is their number, in two seconds each.
    pub fn history(rollouts: u64) -> History {
        let mut history = History::default();
        for rollout in 0..rollouts {
            let frames = (rollout + 1) * 50;
            let metrics = BTreeMap::from([
                // Episode counts differ, so that a plain mean would be caught.
                (metric::EPISODES.to_owned(), if rollout % 2 == 0 { 1.0 } else { 3.0 }),
                (metric::RETURN.to_owned(), rollout as f64),
                ("episode/success".to_owned(), 0.5),
                ("episode/disturbance_m".to_owned(), 0.25),
            ]);
            history.insert(Trained {
                rollout,
                frames,
                stage: u32::from(frames > 1000),
                at_unix_s: rollout * 2,
                incarnation: 1,
                wall_s: Some(rollout as f64 * 2.0),
                timing: Timing { simulate_s: 0.8, infer_s: 0.4, update_s: 0.6, exchange_s: 0.0, other_s: 0.2 },
                metrics: metrics.into(),
            });
        }
        history
    }

    #[test]
    fn a_reader_of_the_files_finds_what_tables_compute() {
        let means = |success| EpisodeMeans {
            figures: [("success", success), ("disturbance_m", 0.5)].map(|(name, mean)| (name.to_owned(), mean)).into(),
            ..EpisodeMeans::default()
        };
        let task = &Spec::built_in()[0];
        let stage = StageMeans { last_tenth: means(0.25), ..by_stage(&stages(), &history(10)).remove(0) };
        let figures = stage.with_quotients(task).last_tenth.figures;
        assert_eq!(figures.get("disturbance_per_success_m"), Some(&2.0));
        let recent = Recent { episodes: means(0.0), ..recent(&stages(), &history(30), true) }.with_quotients(task);
        assert_eq!((recent.episodes.figures.len(), recent.stage_name.as_deref()), (2, Some("II")));
    }

    #[test]
    fn tenths_are_of_the_stage_and_weighted_by_episodes() {
        let figures = by_stage(&stages(), &history(30));
        assert_eq!(figures.len(), 2);
        // Stage I: rollouts 0 to 19; its first tenth is 0 and 1, its last 18 and 19.
        assert_eq!(figures[0].first_tenth.mean_return, Some((3.0 * 1.0) / 4.0));
        assert_eq!(figures[0].last_tenth.mean_return, Some((18.0 + 3.0 * 19.0) / 4.0));
        assert_eq!(figures[0].whole.episodes, 40);
        // Stage II: rollouts 20 to 29, a tenth is one rollout.
        assert_eq!(figures[1].frames, 500);
        assert_eq!(figures[1].first_tenth.mean_return, Some(20.0));
        assert_eq!(figures[1].last_tenth.mean_return, Some(29.0));
        let known = BTreeMap::from([("disturbance_m".to_owned(), 0.25), ("success".to_owned(), 0.5)]);
        assert_eq!(figures[1].last_tenth.figures, known, "what was never reported stays unknown");

        let figures = by_stage(&stages(), &history(10));
        assert_eq!((figures.len(), figures[0].frames), (1, 500), "a stage that has not got there");
        assert_eq!(figures[0].last_tenth.mean_return, Some((8.0 + 3.0 * 9.0) / 4.0), "rollouts 8 and 9 of ten");
        let short = [StageConfig { frames: 100, ..stages().remove(0) }];
        let figures = by_stage(&short, &history(2));
        let tenths = [&figures[0].first_tenth, &figures[0].last_tenth].map(|tenth| tenth.mean_return);
        assert_eq!(tenths, [Some(0.0), Some(1.0)], "long rollouts stand for their tenth");
    }

    #[test]
    fn older_means_are_read() {
        let older = r#"{"episodes":3,"mean_return":null,"success":0.5,"success_without_disturbance":null}"#;
        let read: EpisodeMeans = serde_json::from_str(older).unwrap();
        assert_eq!(read.figures, BTreeMap::from([("success".to_owned(), 0.5)]));
        let written = r#"{"episodes":3,"mean_return":null,"success":0.5}"#;
        assert_eq!(serde_json::to_string(&read).unwrap(), written);
    }

    /// As in a complete run of long episodes.
    #[test]
    fn a_stage_without_an_episode_in_its_newest_tenth_has_means_over_all_of_it() {
        let mut history = history(29);
        let mut last = super::tests::history(30).iter().next_back().unwrap().clone();
        last.metrics = BTreeMap::from([(metric::EPISODES.to_owned(), 0.0)]).into();
        history.insert(last);
        let stages = stages();
        let second = &by_stage(&stages, &history)[1];
        assert_eq!((second.frames, second.whole.episodes), (500, 17));
        assert_eq!(second.last_tenth, second.whole);
        assert_eq!(recent(&stages, &history, true).episodes, second.whole);
    }

    #[test]
    fn rates_are_of_the_last_few_rollouts_and_episodes_of_the_newest_tenth() {
        let mut history = History::default();
        for trained in super::tests::history(22).iter() {
            let mut slower = trained.clone();
            slower.timing.other_s += if trained.rollout < 14 { 2.0 } else { 0.0 };
            history.insert(slower);
        }
        let recent = |at_rest| super::recent(&stages(), &history, at_rest);
        // A run at rest has the rate of its summary, and nothing is left.
        assert!((recent(true).frames_per_s.unwrap() - 1100.0 / 72.0).abs() < 1e-9 && recent(true).left_s.is_none());
        let recent = recent(false);
        assert_eq!((recent.frames, recent.budget, recent.stage), (1100, 1500, Some(1)));
        assert!((recent.frames_per_s.unwrap() - 25.0).abs() < 1e-9);
        assert!((recent.left_s.unwrap() - 16.0).abs() < 1e-9);
        assert!((recent.simulate - 0.4).abs() < 1e-9 && (recent.update - 0.3).abs() < 1e-9);
        // As on the line of its stage in the table: rollout 21 is a tenth of stage II.
        assert_eq!(recent.episodes.mean_return, Some(21.0));
        assert_eq!(recent.episodes, by_stage(&stages(), &history)[1].last_tenth);
    }

    #[test]
    fn nothing_trained_is_no_division_by_zero() {
        let recent = recent(&stages(), &History::default(), false);
        assert_eq!((recent.frames_per_s, recent.left_s, recent.stage), (None, None, None));
        assert!(by_stage(&stages(), &History::default()).is_empty());
    }
}
