//! Means over seeds and kitchens, and how far they can be trusted, as Agarwal et al., *Deep Reinforcement Learning at
//! the Edge of the Statistical Precipice* (2021) recommend and the rliable library computes them.

mod bootstrap;
mod wilson;

pub use bootstrap::{CURVE_RESAMPLES, Interval, RESAMPLES, intervals, intervals_over};
pub use wilson::wilson;

use serde::Serialize;

/// Scores that are no matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ScoresError {
    /// Nothing to average over.
    #[error("no scores: at least one seed and one kitchen are needed")]
    Empty,
    /// Seeds that were not scored in the same kitchens.
    #[error("seed {seed} has {found} scores, the first has {expected}")]
    Ragged {
        /// Place of the seed, from 0.
        seed: usize,
        /// Scores of the first seed.
        expected: usize,
        /// Scores of this one.
        found: usize,
    },
}

/// One score for every seed in every kitchen.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    kitchens: usize,
    /// \[seeds × kitchens\], seed by seed.
    values: Vec<f64>,
}

impl Scores {
    /// One row a seed, all of them over the same kitchens in the same order.
    pub fn new(rows: &[Vec<f64>]) -> Result<Self, ScoresError> {
        let kitchens = rows.first().map_or(0, Vec::len);
        if kitchens == 0 {
            return Err(ScoresError::Empty);
        }
        if let Some(seed) = rows.iter().position(|row| row.len() != kitchens) {
            return Err(ScoresError::Ragged { seed, expected: kitchens, found: rows[seed].len() });
        }
        Ok(Self { kitchens, values: rows.concat() })
    }

    /// Rows.
    pub fn seeds(&self) -> usize {
        self.values.len() / self.kitchens
    }

    /// The scores of one seed.
    pub fn row(&self, seed: usize) -> &[f64] {
        &self.values[seed * self.kitchens..][..self.kitchens]
    }

    /// The mean over the kitchens of each one's mean over seeds.
    pub fn mean(&self) -> f64 {
        let mut sums = vec![0.0; self.kitchens];
        for row in self.values.chunks_exact(self.kitchens) {
            for (sum, score) in sums.iter_mut().zip(row) {
                *sum += score;
            }
        }
        let seeds = self.seeds() as f64;
        sums.iter().map(|sum| sum / seeds).sum::<f64>() / self.kitchens as f64
    }

    /// The interquartile mean over all entries.
    pub fn interquartile_mean(&self) -> f64 {
        interquartile_mean(&self.values)
    }
}

/// The mean of what is left when a quarter of the values, rounded down to whole ones, is cut off at either end.
///
/// # Panics
/// If there are no values.
pub fn interquartile_mean(values: &[f64]) -> f64 {
    assert!(!values.is_empty(), "a mean over nothing");
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let cut = sorted.len() / 4;
    let middle = &sorted[cut..sorted.len() - cut];
    middle.iter().sum::<f64>() / middle.len() as f64
}

/// A mean with what may be said about it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The figure itself.
    pub point: f64,
    /// Its 95% interval; none where there is one seed only.
    pub interval: Option<Interval>,
}

/// Both aggregates of a score matrix.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Aggregate {
    /// Number of seeds.
    pub seeds: usize,
    /// Mean over seeds and kitchens.
    pub mean: Estimate,
    /// Interquartile mean over all entries of the seeds × kitchens matrix, as rliable has it.
    pub iqm: Estimate,
    /// Interquartile mean over the seeds' own means, as the paper has it: of five seeds the middle three.
    pub iqm_of_seeds: f64,
}

impl Aggregate {
    /// Of these scores, with intervals over this many resamples.
    pub fn of(scores: &Scores, resamples: u32) -> Self {
        let found = (scores.seeds() > 1).then(|| intervals(scores, resamples));
        let per_seed: Vec<f64> =
            scores.values.chunks_exact(scores.kitchens).map(|row| row.iter().sum::<f64>() / row.len() as f64).collect();
        Self {
            seeds: scores.seeds(),
            mean: Estimate { point: scores.mean(), interval: found.map(|[mean, _]| mean) },
            iqm: Estimate { point: scores.interquartile_mean(), interval: found.map(|[_, iqm]| iqm) },
            iqm_of_seeds: interquartile_mean(&per_seed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_no_matrix_is_refused() {
        assert_eq!(Scores::new(&[]), Err(ScoresError::Empty));
        assert_eq!(Scores::new(&[vec![]]), Err(ScoresError::Empty));
        let ragged = ScoresError::Ragged { seed: 1, expected: 2, found: 1 };
        assert_eq!(Scores::new(&[vec![0.0, 1.0], vec![0.0]]), Err(ragged));
    }

    #[test]
    fn of_five_seeds_the_middle_three_count() {
        assert_eq!(interquartile_mean(&[9.0, 1.0, 2.0, 3.0, -5.0]), 2.0);
        let rows: Vec<Vec<f64>> = [9.0, 1.0, 2.0, 3.0, -5.0].map(|score| vec![score - 1.0, score + 1.0]).to_vec();
        assert_eq!(Aggregate::of(&Scores::new(&rows).unwrap(), 10).iqm_of_seeds, 2.0);
    }

    #[test]
    fn one_seed_has_no_interval() {
        let aggregate = Aggregate::of(&Scores::new(&[vec![0.25, 0.75]]).unwrap(), 10);
        assert_eq!(aggregate.mean, Estimate { point: 0.5, interval: None });
        assert_eq!(aggregate.iqm.interval, None);
    }

    proptest! {
        #[test]
        fn aggregates_lie_inside_the_scores_and_intervals_too(
            rows in (2usize..6, 1usize..6).prop_flat_map(|(seeds, kitchens)| {
                prop::collection::vec(prop::collection::vec(0.0f64..1.0, kitchens), seeds)
            })
        ) {
            let scores = Scores::new(&rows).unwrap();
            let (low, high) = rows.concat().iter().fold((1.0f64, 0.0f64), |(low, high), &x| (low.min(x), high.max(x)));
            let inside = |x: f64| x >= low - 1e-12 && x <= high + 1e-12;
            prop_assert!(inside(scores.mean()) && inside(scores.interquartile_mean()));
            let draws = (0..50).map(|i| (0..rows.concat().len()).map(|k| (i + k) % rows.len()).collect::<Vec<_>>());
            for interval in intervals_over(&scores, draws) {
                prop_assert!(interval.low <= interval.high && inside(interval.low) && inside(interval.high));
            }
        }
    }
}
