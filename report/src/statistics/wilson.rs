//! The score interval of a share (Wilson, *Probable inference, the law of succession, and statistical inference*,
//! 1927): the interval of one policy's success rate over a number of episodes. It does not cover other seeds.

use super::bootstrap::Interval;

/// 97.5% point of the normal distribution.
const Z: f64 = 1.959_963_984_540_054;

pub fn wilson(successes: u64, trials: u64) -> Option<Interval> {
    if trials == 0 {
        return None;
    }
    let n = trials as f64;
    let rate = successes as f64 / n;
    let centre = rate + Z * Z / (2.0 * n);
    let half = Z * (rate * (1.0 - rate) / n + Z * Z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + Z * Z / n;
    Some(Interval { low: ((centre - half) / scale).max(0.0), high: ((centre + half) / scale).min(1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference values: `statsmodels.stats.proportion.proportion_confint(k, n, method="wilson")`, statsmodels 0.15.0.
    #[test]
    fn agrees_with_statsmodels() {
        for (successes, trials, low, high) in [
            (0, 10, 0.0, 0.2775327999),
            (848, 1800, 0.4481373074, 0.4942079583),
            (1800, 1800, 0.9978704011, 1.0),
            (1, 3, 0.0614919447, 0.7923403992),
        ] {
            let interval = wilson(successes, trials).unwrap();
            assert!((interval.low - low).abs() < 1e-9 && (interval.high - high).abs() < 1e-9, "{interval:?}");
        }
        assert_eq!(wilson(0, 0), None);
    }
}
