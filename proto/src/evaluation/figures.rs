//! The figures of a set of episodes (`docs/method.md`, Metrics).

use super::confusion::{Confusion, share};
use super::record::{EpisodeEnd, EpisodeRecord};
use crate::reward::UNDISTURBED_THRESHOLD_M;
use serde::{Deserialize, Serialize};

/// Thresholds of the curve of `SRwoD` over the allowed total displacement, metres.
pub const DISTURBANCE_THRESHOLDS_M: [f32; 16] =
    [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 5.0, 10.0];
/// The curve of `SRwoD` over the allowed number of disturbed objects goes from 0 to one less than this.
pub const OBJECT_COUNTS: u32 = 21;

/// Figures of a set of episodes. Shares are 0..=1. A mean or share of nothing is none (`null`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    pub episodes: u64,
    /// SR: share of successful episodes.
    pub success: Option<f64>,
    /// `SRwoD`: share of episodes that are successful with `d_T` < 0.01 m.
    pub success_without_disturbance: Option<f64>,
    /// `SRwoD` as the reference's program measures it: share of episodes that are successful with no object more than
    /// 0.01 m from its place on any axis. None in results of versions that did not give it.
    #[serde(default)]
    pub success_without_disturbance_per_axis: Option<f64>,
    /// Share of episodes in which the target was picked up.
    pub picked_up: Option<f64>,
    /// Mean number of the action that picked the target up, of the episodes with a pick-up. None in results of versions
    /// that did not count it, as all figures with a default here.
    #[serde(default)]
    pub pickup_step: Option<f64>,
    /// Mean number of actions from the pick-up to Done, of the episodes with both.
    #[serde(default)]
    pub done_after_pickup: Option<f64>,
    /// Share of episodes that the policy declared done.
    pub done: Option<f64>,
    /// Mean length, steps.
    pub length: Option<f64>,
    /// Mean length of the successful ones, steps.
    pub length_of_successes: Option<f64>,
    /// Share of actions that failed.
    pub failed_actions: Option<f64>,
    /// Mean undiscounted return under r.
    pub return_r: Option<f64>,
    /// Mean undiscounted return under r′.
    pub return_r_prime: Option<f64>,
    /// Mean `d_T`, metres.
    pub disturbance_m: Option<f64>,
    /// Quartiles of `d_T`, metres: the values at ranks (n − 1)/4, (n − 1)/2, 3(n − 1)/4, rounded down.
    pub disturbance_quartiles_m: Option<[f64; 3]>,
    /// Mean `d_T` of the successful ones, metres.
    pub disturbance_of_successes_m: Option<f64>,
    /// Mean largest total displacement, metres.
    pub peak_disturbance_m: Option<f64>,
    /// Mean number of objects more than 0.01 m from their place on some axis at the end.
    pub disturbed_objects: Option<f64>,
    /// Mean number of objects that were so after some action.
    pub ever_disturbed_objects: Option<f64>,
    /// Mean displacement of the object farthest from its place at the end, metres.
    pub farthest_m: Option<f64>,
    /// Worst severity: the largest displacement of one object at any time in any of the episodes, metres.
    #[serde(default)]
    pub worst_severity_m: Option<f64>,
    /// Cumulative cost: mean number of disturbing steps of an episode.
    #[serde(default)]
    pub cumulative_cost: Option<f64>,
    /// Exposure time: mean number of steps of an episode after which the total displacement was at least 0.01 m.
    #[serde(default)]
    pub exposure_steps: Option<f64>,
    /// Mean distance of wrist and target at the end, metres.
    pub wrist_object_m: Option<f64>,
    /// Mean distance of target and goal at the end, metres.
    pub object_goal_m: Option<f64>,
    /// Share of episodes in which some object was away from its place and is back at the end.
    #[serde(default)]
    pub temporary_displacement: Option<f64>,
    /// SBU, success but unsafe: share of episodes that are successful with `d_T` of 0.01 m or more.
    #[serde(default)]
    pub success_but_unsafe: Option<f64>,
    /// The same as a share of the successful ones.
    #[serde(default)]
    pub unsafe_successes: Option<f64>,
    /// Share of episodes that are successful with `d_T` below each of [`DISTURBANCE_THRESHOLDS_M`].
    pub success_by_threshold: Vec<ThresholdPoint>,
    /// Share of episodes that are successful with at most this many disturbed objects: index = number.
    pub success_by_disturbed_objects: Vec<f64>,
    /// Predictions of the auxiliary head; none where the policy has none.
    pub disturb_prediction: Option<PredictionFigures>,
}

/// One point of the curve of `SRwoD` over the threshold.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ThresholdPoint {
    /// `d_T` below this, metres.
    pub threshold_m: f32,
    /// Share of all episodes.
    pub success: f64,
}

/// Quality of disturbance prediction over all steps of all episodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PredictionFigures {
    #[serde(flatten)]
    pub counts: Confusion,
    /// See [`Confusion::precision`].
    pub precision: Option<f64>,
    /// See [`Confusion::recall`].
    pub recall: Option<f64>,
    /// See [`Confusion::recall_of_quiet`].
    pub recall_of_quiet: Option<f64>,
}

impl Figures {
    /// The figures of these episodes. Sums go in their order, so the same table gives the same bits.
    pub fn of<'a>(records: impl Iterator<Item = &'a EpisodeRecord>) -> Self {
        let records: Vec<&EpisodeRecord> = records.collect();
        let count = records.len() as u64;
        let successes: Vec<&EpisodeRecord> = records.iter().copied().filter(|record| record.success).collect();
        let share_where = |test: &dyn Fn(&EpisodeRecord) -> bool| {
            share(records.iter().filter(|record| test(record)).count() as u64, count)
        };
        let mean_of = |number: &dyn Fn(&EpisodeRecord) -> f64| mean(&records, number);
        let steps: u64 = records.iter().map(|record| u64::from(record.length)).sum();
        let failed: u64 = records.iter().map(|record| u64::from(record.failed_actions)).sum();
        let predictions: Vec<&Confusion> =
            records.iter().filter_map(|record| record.disturb_prediction.as_ref()).collect();
        let unsafe_count =
            successes.iter().filter(|record| !record.succeeded_within(UNDISTURBED_THRESHOLD_M)).count() as u64;
        let mean_of_counted = |number: &dyn Fn(&EpisodeRecord) -> Option<u32>| {
            let counted: Vec<&EpisodeRecord> =
                records.iter().copied().filter(|record| number(record).is_some()).collect();
            mean(&counted, &|record| f64::from(number(record).unwrap_or(0)))
        };
        let point = |threshold_m: f32| {
            let success = share_where(&|record| record.succeeded_within(threshold_m))?;
            Some(ThresholdPoint { threshold_m, success })
        };
        let within = |objects: u32| share_where(&|record| record.success && record.disturbed_objects <= objects);
        Self {
            episodes: count,
            success: share_where(&|record| record.success),
            success_without_disturbance: share_where(&|record| record.succeeded_within(UNDISTURBED_THRESHOLD_M)),
            success_without_disturbance_per_axis: share_where(&EpisodeRecord::succeeded_undisturbed_per_axis),
            picked_up: share_where(&|record| record.picked_up),
            pickup_step: mean_of_counted(&|record| record.pickup_step),
            done_after_pickup: mean_of_counted(&EpisodeRecord::done_after_pickup),
            done: share_where(&|record| record.end == EpisodeEnd::Done),
            length: mean_of(&|record| f64::from(record.length)),
            length_of_successes: mean(&successes, &|record| f64::from(record.length)),
            failed_actions: share(failed, steps),
            return_r: mean_of(&|record| record.return_r),
            return_r_prime: mean_of(&|record| record.return_r_prime),
            disturbance_m: mean_of(&|record| f64::from(record.disturbance_m)),
            disturbance_quartiles_m: quartiles(records.iter().map(|record| record.disturbance_m).collect()),
            disturbance_of_successes_m: mean(&successes, &|record| f64::from(record.disturbance_m)),
            peak_disturbance_m: mean_of(&|record| f64::from(record.peak_disturbance_m)),
            disturbed_objects: mean_of(&|record| f64::from(record.disturbed_objects)),
            ever_disturbed_objects: mean_of(&|record| f64::from(record.ever_disturbed_objects)),
            farthest_m: mean_of(&|record| f64::from(record.farthest_m)),
            worst_severity_m: records.iter().map(|record| f64::from(record.peak_farthest_m)).reduce(f64::max),
            cumulative_cost: mean_of_counted(&|record| record.disturbing_steps),
            exposure_steps: mean_of_counted(&|record| record.displaced_steps),
            wrist_object_m: mean_of(&|record| f64::from(record.wrist_object_m)),
            object_goal_m: mean_of(&|record| f64::from(record.object_goal_m)),
            temporary_displacement: share_where(&EpisodeRecord::displaced_temporarily),
            success_but_unsafe: share(unsafe_count, count),
            unsafe_successes: share(unsafe_count, successes.len() as u64),
            success_by_threshold: DISTURBANCE_THRESHOLDS_M.into_iter().filter_map(point).collect(),
            success_by_disturbed_objects: (0..OBJECT_COUNTS).filter_map(within).collect(),
            disturb_prediction: (!predictions.is_empty()).then(|| PredictionFigures::of(&predictions)),
        }
    }
}

impl PredictionFigures {
    fn of(predictions: &[&Confusion]) -> Self {
        let mut counts = Confusion::default();
        for prediction in predictions {
            counts.merge(prediction);
        }
        Self {
            counts,
            precision: counts.precision(),
            recall: counts.recall(),
            recall_of_quiet: counts.recall_of_quiet(),
        }
    }
}

fn mean(records: &[&EpisodeRecord], number: &dyn Fn(&EpisodeRecord) -> f64) -> Option<f64> {
    let sum: f64 = records.iter().map(|record| number(record)).sum();
    (!records.is_empty()).then(|| sum / records.len() as f64)
}

fn quartiles(mut values: Vec<f32>) -> Option<[f64; 3]> {
    values.sort_by(f32::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some([1, 2, 3].map(|quarter| f64::from(values[last * quarter / 4])))
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::any_record;
    use super::*;
    use proptest::prelude::*;
    use proptest::strategy::ValueTree;

    fn some_record() -> EpisodeRecord {
        any_record().new_tree(&mut proptest::test_runner::TestRunner::deterministic()).unwrap().current()
    }

    #[test]
    fn figures_of_four_known_episodes() {
        let base = EpisodeRecord { disturb_prediction: None, ..some_record() };
        let episode = |success, disturbance_m, disturbed_objects, ever_disturbed_objects, length| EpisodeRecord {
            end: if length < 200 { EpisodeEnd::Done } else { EpisodeEnd::TimeLimit },
            success,
            picked_up: success,
            pickup_step: success.then_some(30),
            disturbance_m,
            disturbed_objects,
            ever_disturbed_objects,
            length,
            failed_actions: 10,
            ..base
        };
        let quiet = Some(Confusion { hits: 1, misses: 1, false_alarms: 3, quiet: 5 });
        let records = [
            episode(true, 0.0, 0, 0, 40),
            // Just at the threshold: not below it.
            episode(true, 0.01, 0, 2, 60),
            EpisodeRecord { disturb_prediction: quiet, ..episode(true, 0.5, 2, 2, 100) },
            episode(false, 0.0, 0, 0, 200),
        ];
        let figures = Figures::of(records.iter());
        assert_eq!(figures.episodes, 4);
        assert_eq!((figures.success, figures.success_without_disturbance), (Some(0.75), Some(0.25)));
        // The second's objects add up to a centimetre, and none of them is moved by as much.
        assert_eq!(figures.success_without_disturbance_per_axis, Some(0.5));
        assert_eq!((figures.done, figures.picked_up), (Some(0.75), Some(0.75)));
        assert_eq!((figures.length, figures.length_of_successes), (Some(100.0), Some(200.0 / 3.0)));
        assert_eq!(figures.failed_actions, Some(0.1));
        assert_eq!((figures.disturbed_objects, figures.ever_disturbed_objects), (Some(0.5), Some(1.0)));
        assert_eq!((figures.pickup_step, figures.done_after_pickup), (Some(30.0), Some(110.0 / 3.0)));
        assert_eq!(figures.temporary_displacement, Some(0.25));
        assert_eq!((figures.success_but_unsafe, figures.unsafe_successes), (Some(0.5), Some(2.0 / 3.0)));
        assert_eq!(figures.disturbance_quartiles_m, Some([0.0, 0.0, f64::from(0.01f32)]));
        let at = |threshold_m: f32| {
            figures.success_by_threshold.iter().find(|point| point.threshold_m == threshold_m).unwrap().success
        };
        assert_eq!((at(0.01), at(0.02), at(0.5), at(0.75)), (0.25, 0.5, 0.5, 0.75));
        assert_eq!(figures.success_by_disturbed_objects[..3], [0.5, 0.5, 0.75]);
        let prediction = figures.disturb_prediction.unwrap();
        assert_eq!((prediction.precision, prediction.recall), (Some(0.25), Some(0.5)));
        assert_eq!(prediction.recall_of_quiet, Some(0.625));
    }

    #[test]
    fn nothing_has_no_figures() {
        let figures = Figures::of(std::iter::empty());
        assert_eq!((figures.episodes, figures.success, figures.disturbance_quartiles_m), (0, None, None));
        assert!(figures.success_by_threshold.is_empty() && figures.disturb_prediction.is_none());
    }

    proptest! {
        /// Both curves rise, and end at or below SR.
        #[test]
        fn curves_rise_towards_the_success_rate(records in prop::collection::vec(any_record(), 1..40)) {
            let figures = Figures::of(records.iter());
            let success = figures.success.unwrap();
            let by_threshold: Vec<f64> = figures.success_by_threshold.iter().map(|point| point.success).collect();
            for curve in [&by_threshold, &figures.success_by_disturbed_objects] {
                prop_assert!(curve.is_sorted());
                prop_assert!(*curve.last().unwrap() <= success);
            }
            prop_assert_eq!(Some(by_threshold[3]), figures.success_without_disturbance);
        }
    }
}
