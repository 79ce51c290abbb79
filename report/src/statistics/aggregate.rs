use super::bootstrap::{Interval, intervals};
use super::scores::{Scores, interquartile_mean};
use serde::Serialize;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    pub point: f64,
    /// Its 95% interval; none where there is one seed only, and where seeds agree so much that it would have no width.
    pub interval: Option<Interval>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Aggregate {
    pub seeds: usize,
    pub mean: Estimate,
    /// Interquartile mean over all entries of the seeds × kitchens matrix, as rliable has it.
    pub iqm: Estimate,
    /// Interquartile mean over the seeds' own means, as the paper has it: of five seeds the middle three.
    pub iqm_of_seeds: f64,
}

impl Aggregate {
    pub fn of(scores: &Scores, resamples: u32) -> Self {
        let found = (scores.seeds() > 1).then(|| intervals(scores, resamples));
        let [mean, iqm] = [0, 1].map(|which| found.map(|found| found[which]).filter(Interval::has_width));
        let per_seed: Vec<f64> =
            scores.values.chunks_exact(scores.kitchens).map(|row| row.iter().sum::<f64>() / row.len() as f64).collect();
        Self {
            seeds: scores.seeds(),
            mean: Estimate { point: scores.mean(), interval: mean },
            iqm: Estimate { point: scores.interquartile_mean(), interval: iqm },
            iqm_of_seeds: interquartile_mean(&per_seed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::intervals_over;
    use proptest::prelude::*;

    #[test]
    fn one_seed_has_no_interval() {
        let aggregate = Aggregate::of(&Scores::new(&[vec![0.25, 0.75]]).unwrap(), 10);
        assert_eq!(aggregate.mean, Estimate { point: 0.5, interval: None });
        assert_eq!(aggregate.iqm.interval, None);
    }

    /// A resample of equal scores says nothing of others.
    #[test]
    fn seeds_that_agree_have_no_interval() {
        let same = [vec![0.1, 0.0], vec![0.1, 0.0], vec![0.1, 0.0]];
        let aggregate = Aggregate::of(&Scores::new(&same).unwrap(), 100);
        assert_eq!((aggregate.mean.interval, aggregate.iqm.interval), (None, None));
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
