//! Least-squares lines, without keeping the samples.

use std::fmt::{Display, Formatter};

/// Fewer samples say nothing of an hour.
const SAMPLES_MIN: f64 = 20.0;

/// Sums over samples (x, y).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Slope {
    count: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    least: f64,
    most: f64,
}

/// A slope with its standard error, and the range of the samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    slope: f64,
    error: f64,
    least: f64,
    most: f64,
    count: f64,
}

impl Slope {
    /// Takes in a sample.
    pub fn add(&mut self, x: f64, y: f64) {
        let is_first = self.count == 0.0;
        self.least = if is_first { y } else { self.least.min(y) };
        self.most = if is_first { y } else { self.most.max(y) };
        self.count += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
    }

    /// The line through these samples alone.
    pub fn line(&self) -> Line {
        Self::pooled([self])
    }

    /// One slope for several groups of samples, each of which has a level of its own.
    pub fn pooled<'a>(groups: impl IntoIterator<Item = &'a Self>) -> Line {
        let groups: Vec<&Self> = groups.into_iter().filter(|group| group.count >= 2.0).collect();
        let sum = |of: fn(&Self) -> f64| groups.iter().map(|group| of(group)).sum::<f64>();
        let xx = sum(|group| group.xx - group.x * group.x / group.count);
        let xy = sum(|group| group.xy - group.x * group.y / group.count);
        let yy = sum(|group| group.yy - group.y * group.y / group.count);
        let count = sum(|group| group.count);
        let slope = if xx > 0.0 { xy / xx } else { 0.0 };
        let free = count - groups.len() as f64 - 1.0;
        let error =
            if free > 0.0 && xx > 0.0 { ((yy - slope * xy).max(0.0) / free / xx).sqrt() } else { f64::INFINITY };
        let least = groups.iter().map(|group| group.least).fold(f64::INFINITY, f64::min);
        let most = groups.iter().map(|group| group.most).fold(0.0, f64::max);
        Line { slope, error, least, most, count }
    }
}

impl Line {
    /// Whether it rises by more than this, beyond what two standard errors explain.
    pub fn exceeds(&self, limit: f64) -> bool {
        self.count >= SAMPLES_MIN && self.slope - 2.0 * self.error > limit
    }
}

impl Display for Line {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Self { slope, error, least, most, count } = self;
        if *count < 3.0 {
            return write!(f, "(too few samples)");
        }
        write!(f, "{slope:+8.2}/h ± {error:.2} ({least:.1} to {most:.1}, {count:.0} samples)")
    }
}
