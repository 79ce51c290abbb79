//! Figures as people read them. Pure functions.

use crate::statistics::Interval;

/// What stands for a figure that nothing can be said of.
pub const NOTHING: &str = "–";

/// A count with its thousands apart: `1 234 567`.
pub fn count(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(digit);
    }
    out
}

/// A share as a percentage with one decimal, without its sign, as the paper's tables have it.
pub fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

/// The same of a share that may be unknown: a dash for none.
pub fn share(share: Option<f64>) -> String {
    share.map_or_else(|| NOTHING.to_owned(), percent)
}

/// `[75.0, 81.2]`, percentages.
pub fn interval(interval: &Interval) -> String {
    format!("[{}, {}]", percent(interval.low), percent(interval.high))
}

/// A number with that many decimals, a dash for none.
pub fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| NOTHING.to_owned(), |value| format!("{value:.decimals$}"))
}
