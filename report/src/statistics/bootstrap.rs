//! Percentile intervals by a stratified bootstrap: a resample takes, for each entry of the seeds × kitchens matrix, the
//! score of a seed drawn with replacement in the same kitchen. That is rliable's `get_interval_estimates` with
//! `method='percentile'` and without resampling of tasks.

use super::scores::Scores;
use proto::random::{Key, Purpose};
use serde::Serialize;

/// Resamples behind each interval of a table; rliable's default.
pub(crate) const RESAMPLES: u32 = 50_000;
/// Resamples behind each point of a curve; rliable's default for profiles.
pub(crate) const CURVE_RESAMPLES: u32 = 2_000;

const TAIL: f64 = 0.025;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    pub low: f64,
    pub high: f64,
}

impl Interval {
    /// More than sums round.
    pub(super) fn has_width(&self) -> bool {
        self.high - self.low > 1e-9
    }
}

/// Intervals of the mean and of the interquartile mean over this many resamples. The draws are a function of the
/// matrix's shape, so the same scores always have the same interval.
pub(super) fn intervals(scores: &Scores, resamples: u32) -> [Interval; 2] {
    let (entries, seeds) = (scores.values.len(), scores.seeds() as u32);
    let draws = (0..resamples).map(|resample| {
        let key =
            Key { seed: 0, purpose: Purpose::Bootstrap, kitchen: 0, environment: seeds, episode: resample, step: 0 };
        let mut random = key.stream();
        (0..entries).map(|_| random.below(seeds) as usize).collect()
    });
    intervals_over(scores, draws)
}

/// The same over given resamples. Each holds, for every entry of the matrix, the seed whose score it takes.
///
/// # Panics
/// If there are no resamples, or one does not have the matrix's shape.
pub fn intervals_over(scores: &Scores, resamples: impl Iterator<Item = Vec<usize>>) -> [Interval; 2] {
    let kitchens = scores.kitchens;
    let (mut means, mut iqms) = (Vec::new(), Vec::new());
    let mut resampled = scores.clone();
    for seeds in resamples {
        assert_eq!(seeds.len(), scores.values.len(), "a resample is a matrix of the same shape");
        for (entry, seed) in seeds.into_iter().enumerate() {
            resampled.values[entry] = scores.values[seed * kitchens + entry % kitchens];
        }
        means.push(resampled.mean());
        iqms.push(resampled.interquartile_mean());
    }
    [means, iqms].map(|mut values| {
        values.sort_unstable_by(f64::total_cmp);
        Interval { low: quantile(&values, TAIL), high: quantile(&values, 1.0 - TAIL) }
    })
}

fn quantile(sorted: &[f64], share: f64) -> f64 {
    assert!(!sorted.is_empty(), "a quantile of nothing");
    let place = share * (sorted.len() - 1) as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (sorted[above] - sorted[below]) * (place - below as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_seeds_have_an_interval_of_no_width() {
        let scores = Scores::new(&[vec![0.5, 0.25], vec![0.5, 0.25], vec![0.5, 0.25]]).unwrap();
        for interval in intervals(&scores, RESAMPLES) {
            assert!((interval.low - 0.375).abs() < 1e-12 && (interval.high - 0.375).abs() < 1e-12);
        }
    }

    /// Over two seeds in one kitchen a resample's mean is a, b or between them with shares 1/4, 1/4, 1/2: both ends
    /// are reached.
    #[test]
    fn draws_cover_all_seeds() {
        let scores = Scores::new(&[vec![0.0], vec![1.0]]).unwrap();
        assert_eq!(intervals(&scores, RESAMPLES)[0], Interval { low: 0.0, high: 1.0 });
        // The mean of many kitchens drawn independently is narrow: the strata are resampled one by one.
        let scores = Scores::new(&[vec![0.0; 200], vec![1.0; 200]]).unwrap();
        let [mean, _] = intervals(&scores, RESAMPLES);
        assert!(mean.low > 0.42 && mean.high < 0.58, "{mean:?}");
    }
}
