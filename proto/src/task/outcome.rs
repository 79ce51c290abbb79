//! How an episode ended, in words.

use super::metric::Over;
use super::spec::Spec;
use crate::record::End;

impl Spec {
    /// The metrics that say that an episode ended well, by index: the one that demands most first. They are among those of
    /// training.
    pub fn successes(&self) -> impl DoubleEndedIterator<Item = usize> {
        let is_one = |at: &usize| {
            let metric = &self.metrics[*at];
            metric.curve && metric.over == Over::Last && !metric.all_of.is_empty()
        };
        (0..self.metrics.len()).rev().filter(is_one)
    }

    /// How an episode ended, as names of files and tables have it: `success-without-disturbance`, `failure`,
    /// `ended` in a task without successes, `time-limit`, `unfinished`. `metrics`: the task's, as far as they are known.
    pub fn outcome(&self, metrics: &[Option<f64>], end: Option<End>) -> String {
        let Some(end) = end else { return UNFINISHED.to_owned() };
        let good = self.successes().find(|&at| metrics.get(at) == Some(&Some(1.0)));
        let word = match end {
            End::Terminated if self.successes().next().is_none() => "ended",
            End::Terminated => "failure",
            End::Truncated => "time-limit",
        };
        good.map_or_else(|| word.to_owned(), |at| self.metrics[at].name.replace('_', "-"))
    }

    /// The words of [`Self::outcome`] that stand for a success.
    pub fn good_outcomes(&self) -> impl Iterator<Item = String> {
        self.successes().map(|at| self.metrics[at].name.replace('_', "-"))
    }
}

/// The outcome of an episode whose recording stops before its end.
pub const UNFINISHED: &str = "unfinished";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episode_ends_as_the_metric_says_that_demands_most() {
        let arm = Spec::named("arm_point_nav").unwrap();
        let outcome = |held: &[&str], end| {
            let held = |metric: &super::super::Metric| Some(f64::from(u8::from(held.contains(&&*metric.name))));
            arm.outcome(&arm.metrics.iter().map(held).collect::<Vec<_>>(), end)
        };
        let (done, limit) = (Some(End::Terminated), Some(End::Truncated));
        assert_eq!(
            outcome(&["success", "success_without_disturbance", "picked_up"], done),
            "success-without-disturbance"
        );
        assert_eq!([outcome(&["success"], done), outcome(&["picked_up"], done)], ["success", "failure"]);
        assert_eq!([outcome(&["picked_up"], limit), outcome(&["success"], None)], ["time-limit", "unfinished"]);
        assert_eq!(arm.good_outcomes().collect::<Vec<_>>(), ["success-without-disturbance", "success"]);
    }
}
