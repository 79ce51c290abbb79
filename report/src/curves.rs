use crate::study::{Group, Rollout, Run, Validated};
use proto::config::StageConfig;
use proto::metric;
use proto::stage::{position_at, total_frames};
use serde::Serialize;
use std::collections::BTreeMap;

/// A bin of rollouts: its number in frames, and the stage that its rollouts belong to. A stage ends within a bin as a
/// rule, and what comes after it in the bin is another task.
type Bin = (u64, usize);

const BINS: u64 = 80;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Curve {
    pub metric: String,
    pub points: Vec<TrainingPoint>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrainingPoint {
    pub frames: f64,
    pub mean: f64,
    pub low: f64,
    pub high: f64,
    pub seeds: usize,
}

impl Curve {
    /// The metric over the rollouts; none where no run has it. Figures of episodes are weighted by how many ended.
    pub(crate) fn of_training(group: &Group<'_>, name: &str) -> Option<Self> {
        let width = group.runs.iter().map(|run| width(run)).reduce(f64::max)?;
        let seeds: Vec<Vec<(Bin, f64, f64)>> = group.runs.iter().map(|run| bins(run, name, width)).collect();
        Self::over(name, &seeds)
    }

    /// A figure of the evaluations during training; none where there were none. Only where every seed that was
    /// evaluated has a point: a run skips an evaluation when the next one is due, and a mean over other seeds is
    /// another mean.
    pub(crate) fn of_validation(group: &Group<'_>, name: &str) -> Option<Self> {
        let point = |point: &Validated| Some(((point.frames, 0), point.frames as f64, *point.figures.get(name)?));
        let seeds: Vec<Vec<(Bin, f64, f64)>> =
            group.runs.iter().map(|run| run.validation.iter().filter_map(point).collect()).collect();
        let evaluated = seeds.iter().filter(|seed| !seed.is_empty()).count();
        let mut curve = Self::over(name, &seeds)?;
        curve.points.retain(|point| point.seeds == evaluated);
        (!curve.points.is_empty()).then_some(curve)
    }

    fn over(name: &str, seeds: &[Vec<(Bin, f64, f64)>]) -> Option<Self> {
        let mut bins: Vec<Bin> = seeds.iter().flatten().map(|&(bin, _, _)| bin).collect();
        bins.sort_unstable();
        bins.dedup();
        let point = |bin: Bin| {
            let here: Vec<(f64, f64)> = seeds
                .iter()
                .filter_map(|seed| seed.iter().find(|&&(b, _, _)| b == bin).map(|&(_, frames, value)| (frames, value)))
                .collect();
            let count = here.len() as f64;
            TrainingPoint {
                frames: here.iter().map(|(frames, _)| frames).sum::<f64>() / count,
                mean: here.iter().map(|(_, value)| value).sum::<f64>() / count,
                low: here.iter().map(|&(_, value)| value).fold(f64::INFINITY, f64::min),
                high: here.iter().map(|&(_, value)| value).fold(f64::NEG_INFINITY, f64::max),
                seeds: here.len(),
            }
        };
        (!bins.is_empty()).then(|| Self { metric: name.to_owned(), points: bins.into_iter().map(point).collect() })
    }
}

fn width(run: &Run) -> f64 {
    let trained = run.rollouts.iter().map(|rollout| rollout.frames).max().unwrap_or(0);
    (total_frames(&run.config.stages).max(trained) as f64 / BINS as f64).max(1.0)
}

/// (bin, mean frames, mean) of each bin that has any.
fn bins(run: &Run, name: &str, width: f64) -> Vec<(Bin, f64, f64)> {
    let per_episode = name.starts_with("episode/") && name != metric::EPISODES;
    let mut bins: BTreeMap<Bin, (f64, f64, f64)> = BTreeMap::new();
    for rollout in &run.rollouts {
        let Some(value) = rollout.get(name).filter(|value| value.is_finite()) else { continue };
        let weight = if per_episode { rollout.get(metric::EPISODES).unwrap_or(0.0) } else { 1.0 };
        if weight <= 0.0 {
            continue;
        }
        let bin = ((rollout.frames as f64 / width).ceil() as u64, stage_of(&run.config.stages, rollout));
        let sums = bins.entry(bin).or_default();
        *sums = (sums.0 + rollout.frames as f64 * weight, sums.1 + value * weight, sums.2 + weight);
    }
    bins.into_iter().map(|(bin, (frames, value, weight))| (bin, frames / weight, value / weight)).collect()
}

/// The stage that a rollout belongs to: that of its last frame. None crosses a stage's end.
fn stage_of(stages: &[StageConfig], rollout: &Rollout) -> usize {
    position_at(stages, rollout.frames.saturating_sub(1)).map_or(stages.len(), |position| position.stage)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{groups, tests::run};
    use proto::evaluation::Distribution;

    fn rollouts(count: u64, frames_each: u64, value: impl Fn(u64) -> f64) -> Vec<Rollout> {
        let rollout = |index: u64| Rollout {
            frames: (index + 1) * frames_each,
            metrics: BTreeMap::from([
                (metric::RETURN.to_owned(), value(index)),
                (metric::EPISODES.to_owned(), if index.is_multiple_of(2) { 1.0 } else { 3.0 }),
                (metric::ENTROPY.to_owned(), value(index)),
            ])
            .into(),
            ..Rollout::default()
        };
        (0..count).map(rollout).collect()
    }

    #[test]
    fn bins_weigh_episodes_where_the_figure_is_one_of_episodes() {
        let mut run = run("a", "demo", 1);
        run.rollouts = rollouts(4, 10, |index| index as f64);
        // Bins of 20 frames: rollouts 0 and 1, 2 and 3.
        let returns = bins(&run, metric::RETURN, 20.0);
        let expected =
            [((1, 0), (10.0 + 3.0 * 20.0) / 4.0, 3.0 / 4.0), ((2, 0), (30.0 + 3.0 * 40.0) / 4.0, 11.0 / 4.0)];
        assert_eq!(returns, expected);
        assert_eq!(bins(&run, metric::ENTROPY, 20.0), [((1, 0), 15.0, 0.5), ((2, 0), 35.0, 2.5)]);
        assert!(bins(&run, "episode/success", 20.0).is_empty());
        // How many end is no mean over those that do.
        assert_eq!(bins(&run, metric::EPISODES, 20.0), [((1, 0), 15.0, 2.0), ((2, 0), 35.0, 2.0)]);
    }

    /// The file of figures of somebody else's run: each point of it had a bin of its own, and the page took minutes.
    #[test]
    fn frames_beyond_the_budget_or_in_no_order_have_no_more_bins_than_others() {
        let mut run = run("a", "demo", 1);
        run.rollouts = rollouts(100_000, 1_000_000_000, |index| index as f64);
        let most = 2 * BINS as usize;
        for (index, rollout) in run.rollouts.iter_mut().enumerate() {
            rollout.frames = (index as u64 * 7_919) % 100_000 * 1_000_000_000;
        }
        let runs = [run];
        let groups = groups(&runs).unwrap();
        assert!(Curve::of_training(&groups[0], metric::ENTROPY).unwrap().points.len() < most);
    }

    /// Stage I ended in the middle of a bin, and its curve seemed to fall there.
    #[test]
    fn a_bin_in_which_the_stage_changes_is_two() {
        let mut runs = [run("a", "demo", 1)];
        runs[0].config.stages[0].frames = 20_000;
        runs[0].config.stages[1].frames = 60_000 - 20_000;
        runs[0].rollouts = rollouts(240, 250, |index| if index < 80 { 5.0 } else { 1.0 });
        let groups = groups(&runs).unwrap();
        let curve = Curve::of_training(&groups[0], metric::ENTROPY).unwrap();
        assert!(curve.points.iter().all(|point| point.mean == if point.frames <= 20_000.0 { 5.0 } else { 1.0 }));
        assert!(curve.points.is_sorted_by(|a, b| a.frames < b.frames));
    }

    #[test]
    fn a_group_has_mean_and_range_of_its_seeds() {
        let mut runs = [run("a", "demo", 1), run("b", "demo", 2)];
        runs[0].rollouts = rollouts(36, 10_000, |_| 1.0);
        runs[1].rollouts = rollouts(18, 10_000, |_| 4.0);
        let groups = groups(&runs).unwrap();
        let curve = Curve::of_training(&groups[0], metric::RETURN).unwrap();
        let first = curve.points[0];
        assert_eq!((first.mean, first.low, first.high, first.seeds), (2.5, 1.0, 4.0, 2));
        let last = curve.points.last().unwrap();
        assert_eq!((last.mean, last.seeds), (1.0, 1));
        assert!(curve.points.is_sorted_by(|a, b| a.frames < b.frames));
        assert_eq!(Curve::of_training(&groups[0], "no such metric"), None);
    }

    #[test]
    fn a_validation_that_one_seed_skipped_is_no_point_of_the_mean() {
        let mut runs = [run("a", "demo", 1), run("b", "demo", 2), run("c", "demo", 3)];
        let at = |frames: &[u64], success: f64| -> Vec<Validated> {
            let distribution = Distribution::Fixed;
            let figures = BTreeMap::from([("success".to_owned(), success)]);
            let point = |&frames: &u64| Validated { frames, distribution, figures: figures.clone() };
            frames.iter().map(point).collect()
        };
        runs[0].validation = at(&[100, 200, 300], 0.2);
        runs[1].validation = at(&[100, 300, 400], 0.4);
        let groups = groups(&runs).unwrap();
        let curve = Curve::of_validation(&groups[0], "success").unwrap();
        let points: Vec<(f64, usize)> = curve.points.iter().map(|point| (point.frames, point.seeds)).collect();
        // The third has no validations at all.
        assert_eq!(points, [(100.0, 2), (300.0, 2)]);
        assert!(curve.points.iter().all(|point| (point.mean - 0.3).abs() < 1e-12));
    }
}
