//! Count, mean and variance of vectors that come in parts (Chan, Golub and `LeVeque` 1979), and rewards divided by
//! such a deviation: `RunningMeanStd` and `NormalizeReward` of Gymnasium.

use crate::network::VARIANCE_EPSILON;

/// Count, means, and sums of squared deviations from them.
#[derive(Debug, Clone, PartialEq)]
pub struct Moments {
    count: f64,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

/// Of so many vectors consists what is known before the first one: mean 0 and deviation 1 (Gymnasium).
const BEFORE: f64 = 1e-4;

impl Moments {
    pub fn before(width: usize) -> Self {
        Self { count: BEFORE, mean: vec![0.0; width], squares: vec![BEFORE; width] }
    }

    /// Of `rows` vectors, of which number `i` of row `row` is `number(row, i)`.
    pub fn of(rows: usize, width: usize, number: impl Fn(usize, usize) -> f64) -> Self {
        let count = rows as f64;
        let sum = |of: &dyn Fn(usize) -> f64| (0..rows).fold(0.0, |sum, row| sum + of(row));
        let mean: Vec<f64> = (0..width).map(|i| sum(&|row| number(row, i)) / count.max(1.0)).collect();
        let squares = (0..width).map(|i| sum(&|row| (number(row, i) - mean[i]).powi(2))).collect();
        Self { count, mean, squares }
    }

    /// With other vectors. Panics if those are of another width.
    pub fn merge(&mut self, other: &Self) {
        assert_eq!(self.width(), other.width(), "vectors of one width");
        if other.count == 0.0 {
            return;
        }
        let total = self.count + other.count;
        for i in 0..self.width() {
            let apart = other.mean[i] - self.mean[i];
            self.mean[i] += apart * other.count / total;
            self.squares[i] += other.squares[i] + apart * apart * self.count * other.count / total;
        }
        self.count = total;
    }

    pub fn width(&self) -> usize {
        self.mean.len()
    }

    pub(crate) fn of_number(&self, i: usize) -> [f64; 2] {
        [self.mean[i], self.squares[i] / self.count]
    }

    /// All of them: `1 + 2 * width` numbers.
    pub(crate) fn to_numbers(&self) -> Vec<f64> {
        [&[self.count][..], &self.mean, &self.squares].concat()
    }

    /// What [`Self::to_numbers`] gave. Panics if there are no numbers.
    pub(crate) fn from_numbers(numbers: &[f64]) -> Self {
        let (count, rest) = numbers.split_first().expect("moments have a count");
        let (mean, squares) = rest.split_at(rest.len() / 2);
        Self { count: *count, mean: mean.to_vec(), squares: squares.to_vec() }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RewardScale {
    divisor: f64,
    clip: f64,
}

impl RewardScale {
    /// Rewards stay as they are.
    pub const NONE: Self = Self { divisor: 1.0, clip: f64::INFINITY };

    /// Divided by the deviation of discounted returns with these moments, then clipped.
    pub fn of(returns: &Moments, clip: f64) -> Self {
        let [_, variance] = returns.of_number(0);
        Self { divisor: (variance + VARIANCE_EPSILON).sqrt(), clip }
    }

    pub fn apply(self, reward: f32) -> f64 {
        (f64::from(reward) / self.divisor).clamp(-self.clip, self.clip)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Some numbers far from 0, as of an observation in other units.
    fn number(row: usize, i: usize) -> f64 {
        1e4 * i as f64 + ((row * 37 + i * 11) % 23) as f64 * 0.1
    }

    #[test]
    fn parts_make_the_moments_of_the_whole() {
        let parts = [0..7, 7..7, 7..8, 8..40];
        let mut merged = Moments::of(0, 3, number);
        merged.count = 0.0;
        let mut merged = parts.into_iter().fold(Moments { squares: vec![0.0; 3], ..merged }, |mut all, rows| {
            all.merge(&Moments::of(rows.len(), 3, |row, i| number(rows.start + row, i)));
            all
        });
        for i in 0..3 {
            let all: Vec<f64> = (0..40).map(|row| number(row, i)).collect();
            let mean = all.iter().sum::<f64>() / 40.0;
            let variance = all.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / 40.0;
            let [found_mean, found] = merged.of_number(i);
            assert!((found_mean - mean).abs() < 1e-9 && (found - variance).abs() < 1e-9 * variance, "{i}");
        }
        assert_eq!(Moments::from_numbers(&merged.to_numbers()), merged);
        let same = merged.clone();
        merged.merge(&Moments::of(0, 3, number));
        assert_eq!(merged, same, "nothing changes nothing");
    }

    #[test]
    fn a_reward_is_divided_and_then_clipped() {
        let mut returns = Moments::before(1);
        assert_eq!(returns.of_number(0), [0.0, 1.0]);
        returns.merge(&Moments::of(1000, 1, |row, _| if row % 2 == 0 { -4.0 } else { 4.0 }));
        let scale = RewardScale::of(&returns, 1.5);
        assert!((scale.apply(2.0) - 0.5).abs() < 1e-6, "{}", scale.apply(2.0));
        assert_eq!([scale.apply(-100.0), scale.apply(7.0)], [-1.5, 1.5]);
        assert_eq!(RewardScale::NONE.apply(-1e30), f64::from(-1e30f32));
    }
}
