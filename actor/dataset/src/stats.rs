//! Statistics of a data set as `LeRobot` keeps them: of every episode exactly, and of all together as its own library
//! merges them. (Merged quantiles are means of the episodes' quantiles.)

use crate::episode::Frames;
use serde_json::{Value as Json, json};

/// Names of the quantiles, and their shares.
pub const QUANTILES: [(&str, f64); 5] = [("q01", 0.01), ("q10", 0.10), ("q50", 0.50), ("q90", 0.90), ("q99", 0.99)];

/// Statistics of one dimension.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figures {
    /// Least value.
    pub min: f64,
    /// Greatest value.
    pub max: f64,
    /// Mean.
    pub mean: f64,
    /// Standard deviation, of the values themselves.
    pub std: f64,
    /// As in [`QUANTILES`].
    pub quantiles: [f64; QUANTILES.len()],
}

/// Statistics of one feature.
#[derive(Debug, Clone, PartialEq)]
pub struct Stats {
    /// Steps.
    pub count: u64,
    /// How deep its lists are: those of pictures are channels × 1 × 1.
    pub depth: usize,
    /// Of each dimension or channel.
    pub figures: Vec<Figures>,
}

impl Figures {
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        let at = |rank: u64| values[rank as usize];
        let quantiles = QUANTILES.map(|(_, share)| quantile(values.len() as u64, share, at));
        Self { min: values[0], max: values[values.len() - 1], mean, std: variance.sqrt(), quantiles }
    }

    /// Of values that are there so often, each multiplied by `unit`.
    fn counted(counts: &[u64], unit: f64) -> Self {
        let there = || counts.iter().enumerate().filter(|(_, count)| **count > 0);
        let total: u64 = counts.iter().sum();
        let sum = |term: &dyn Fn(f64) -> f64| -> f64 {
            there().map(|(value, count)| term(value as f64) * *count as f64).sum::<f64>() / total as f64
        };
        let mean = sum(&|value| value);
        let variance = sum(&|value| (value - mean).powi(2));
        let mut ends = Vec::new();
        let mut before = 0;
        for (value, count) in there() {
            before += count;
            ends.push((before, value as f64));
        }
        let at = |rank: u64| ends[ends.partition_point(|(end, _)| *end <= rank)].1;
        let quantiles = QUANTILES.map(|(_, share)| unit * quantile(total, share, at));
        let (min, max) = (at(0), at(total - 1));
        Self { min: unit * min, max: unit * max, mean: unit * mean, std: unit * variance.sqrt(), quantiles }
    }

    /// A name, and where the figure is.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let quantiles = QUANTILES.iter().zip(self.quantiles).map(|((name, _), value)| (*name, value));
        [("min", self.min), ("max", self.max), ("mean", self.mean), ("std", self.std)].into_iter().chain(quantiles)
    }
}

/// Between the two nearest of `count` sorted values, as `NumPy` has it.
fn quantile(count: u64, share: f64, at: impl Fn(u64) -> f64) -> f64 {
    let place = share * (count - 1) as f64;
    let (below, part) = (place.floor(), place.fract());
    let low = at(below as u64);
    if part == 0.0 { low } else { low + part * (at(below as u64 + 1) - low) }
}

impl Stats {
    /// Of the values of steps, `dimensions` each.
    ///
    /// # Panics
    /// If there are none.
    pub fn of(values: &[f64], dimensions: usize) -> Self {
        let of = |dimension: usize| Figures::of(values.iter().skip(dimension).step_by(dimensions).copied().collect());
        let figures = (0..dimensions).map(of).collect();
        Self { count: (values.len() / dimensions) as u64, depth: 1, figures }
    }

    /// Of an episode's frames: depth in millimetres, colours from 0 to 1.
    pub fn of_frames(frames: &Frames, steps: usize) -> Self {
        let unit = if frames.is_depth { 1.0 } else { 1.0 / 255.0 };
        let figures = frames.counts().iter().map(|counts| Figures::counted(counts, unit)).collect();
        Self { count: steps as u64, depth: 3, figures }
    }

    /// Takes in those of another episode.
    pub fn merge(&mut self, other: &Self) {
        let (ours, theirs) = (self.count as f64, other.count as f64);
        let total = ours + theirs;
        let weighed = |a: f64, b: f64| (a * ours + b * theirs) / total;
        for (figures, other) in self.figures.iter_mut().zip(&other.figures) {
            let mean = weighed(figures.mean, other.mean);
            let spread = |figures: &Figures| figures.std.powi(2) + (figures.mean - mean).powi(2);
            figures.std = weighed(spread(figures), spread(other)).sqrt();
            figures.mean = mean;
            figures.min = figures.min.min(other.min);
            figures.max = figures.max.max(other.max);
            for (quantile, other) in figures.quantiles.iter_mut().zip(other.quantiles) {
                *quantile = weighed(*quantile, other);
            }
        }
        self.count += other.count;
    }

    /// Its figures by name, over all dimensions.
    pub fn named(&self) -> Vec<(&'static str, Vec<f64>)> {
        let Some(first) = self.figures.first() else { return Vec::new() };
        let mut named: Vec<(&str, Vec<f64>)> = first.named().map(|(name, _)| (name, Vec::new())).collect();
        for figures in &self.figures {
            for ((_, values), (_, value)) in named.iter_mut().zip(figures.named()) {
                values.push(value);
            }
        }
        named
    }

    /// As `stats.json` has it.
    pub fn json(&self) -> Json {
        let mut object = serde_json::Map::new();
        for (name, values) in self.named() {
            let deep = |value: f64| (1..self.depth).fold(json!(value), |inner, _| json!([inner]));
            object.insert(name.to_owned(), values.into_iter().map(deep).collect());
        }
        object.insert("count".to_owned(), json!([self.count]));
        Json::Object(object)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counted_values_have_the_figures_of_the_values() {
        let values = [0.0, 3.0, 3.0, 3.0, 7.0, 9.0, 9.0];
        let mut counts = vec![0; 16];
        for value in values {
            counts[value as usize] += 1;
        }
        let figures = Figures::of(values.to_vec());
        assert_eq!(figures.quantiles[2], 3.0);
        assert!((figures.quantiles[1] - 1.8).abs() < 1e-12, "as numpy.quantile has it: {figures:?}");
        let counted = Figures::counted(&counts, 1.0);
        for ((name, a), (_, b)) in figures.named().zip(counted.named()) {
            assert!((a - b).abs() < 1e-12, "{name}: {a} and {b}");
        }
    }

    #[test]
    fn merged_figures_are_those_of_all_values() {
        let (a, b) = ([1.0, 10.0, 2.0, 20.0], [6.0, 60.0]);
        let mut merged = Stats::of(&a, 2);
        merged.merge(&Stats::of(&b, 2));
        let all = Stats::of(&[a.as_slice(), &b].concat(), 2);
        assert_eq!((merged.count, all.count), (3, 3));
        for (merged, all) in merged.figures.iter().zip(&all.figures) {
            assert!((merged.mean - all.mean).abs() < 1e-12 && (merged.std - all.std).abs() < 1e-12);
            assert_eq!((merged.min, merged.max), (all.min, all.max));
        }
    }
}
