//! How far the mean of independent episodes can be trusted.

use super::record::EpisodeRecord;
use crate::random::{Key, Purpose};
use crate::task::{Column, Spec};
use std::collections::BTreeMap;

const RESAMPLES: u32 = 10_000;
/// Of a thousand: below an interval, and above it.
const TAIL: usize = 25;

/// The 95% interval of the mean of each number that all episodes have. The same numbers have the same interval.
pub(super) fn intervals<'a>(
    spec: &Spec,
    records: impl Iterator<Item = &'a EpisodeRecord>,
) -> BTreeMap<String, [f64; 2]> {
    let records: Vec<&EpisodeRecord> = records.collect();
    let interval = |(index, name): (usize, String)| {
        let numbers: Option<Vec<f64>> = records.iter().map(|record| record.number(Column::Number(index))).collect();
        Some((name, of_mean(&numbers?)?))
    };
    spec.columns().into_iter().map(|column| column.name).enumerate().filter_map(interval).collect()
}

fn of_mean(numbers: &[f64]) -> Option<[f64; 2]> {
    let count = u32::try_from(numbers.len()).ok().filter(|&count| count > 0)?;
    let resampled = |resample: u32| {
        let key = Key { seed: 0, purpose: Purpose::Bootstrap, kitchen: 0, environment: 0, episode: resample, step: 0 };
        let mut random = key.stream();
        let sum: f64 = numbers.iter().map(|_| numbers[random.below(count) as usize]).sum();
        sum / f64::from(count)
    };
    let mut means: Vec<f64> = (0..RESAMPLES).map(resampled).collect();
    means.sort_unstable_by(f64::total_cmp);
    let last = means.len() - 1;
    Some([TAIL, 1000 - TAIL].map(|share| means[last * share / 1000]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_is_as_wide_as_the_episodes_differ() {
        assert_eq!(of_mean(&[]), None);
        assert_eq!(of_mean(&[3.0; 7]), Some([3.0; 2]));
        // A hundred coins: the mean's standard deviation is 0.05.
        let coins: Vec<f64> = (0..100).map(|coin| f64::from(coin % 2)).collect();
        let [low, high] = of_mean(&coins).unwrap();
        assert!((low - 0.402).abs() < 0.015 && (high - 0.598).abs() < 0.015, "{low} {high}");
    }
}
