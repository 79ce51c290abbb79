pub use proto::grouped::grouped as count;

use crate::statistics::Interval;

pub const NOTHING: &str = "–";

/// A count of things named in the singular: `1 run`, `1,234 runs`, `2 processes`.
pub fn counted(value: u64, thing: &str) -> String {
    let ending = match value {
        1 => "",
        _ if thing.ends_with('s') => "es",
        _ => "s",
    };
    format!("{} {thing}{ending}", count(value))
}

/// A reward as documents write it; `r_prime` is how a configuration names it.
pub fn reward(name: &str) -> &str {
    if name == "r_prime" { "r′" } else { name }
}

pub fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

pub fn share(share: Option<f64>) -> String {
    share.map_or_else(|| NOTHING.to_owned(), percent)
}

pub fn interval(interval: &Interval) -> String {
    format!("[{}, {}]", percent(interval.low), percent(interval.high))
}

pub fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| NOTHING.to_owned(), |value| format!("{value:.decimals$}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_no_plural() {
        let runs = [0, 1, 1234].map(|value| counted(value, "run"));
        assert_eq!(runs, ["0 runs", "1 run", "1,234 runs"]);
        assert_eq!([1, 2].map(|value| counted(value, "process")), ["1 process", "2 processes"]);
    }
}
