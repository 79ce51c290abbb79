//! Warnings that somebody else can cause as often as he likes. The log of a run must not grow with them.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_mins(1);

/// Logs the first warning of a kind, and then one a minute with the number of those that were left out.
#[derive(Default)]
pub struct WarningLimiter(Mutex<BTreeMap<&'static str, Kind>>);

struct Kind {
    logged: Instant,
    left_out: u64,
}

impl WarningLimiter {
    /// Logs a warning of this kind if one is due. `kind` stands after a number, as in `12 more refused connections`.
    pub fn warn(&self, kind: &'static str, text: impl Display) {
        if let Some(more) = self.due(kind, Instant::now()) {
            tracing::warn!("{text}{more}");
        }
    }

    /// What a line at this moment says of those before it; none where it is left out, too.
    pub fn due(&self, kind: &'static str, now: Instant) -> Option<String> {
        let mut kinds = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(Kind { logged, left_out }) = kinds.get_mut(kind) else {
            kinds.insert(kind, Kind { logged: now, left_out: 0 });
            return Some(String::new());
        };
        if now.saturating_duration_since(*logged) < PERIOD {
            *left_out += 1;
            return None;
        }
        *logged = now;
        Some(more(kind, std::mem::take(left_out)))
    }
}

/// What was left out last is told at the end.
impl Drop for WarningLimiter {
    fn drop(&mut self) {
        let kinds = self.0.get_mut().unwrap_or_else(PoisonError::into_inner);
        for (kind, Kind { left_out, .. }) in kinds.iter().filter(|(_, kind)| kind.left_out > 0) {
            tracing::warn!("{left_out} more {kind}");
        }
    }
}

fn more(kind: &str, left_out: u64) -> String {
    if left_out == 0 { String::new() } else { format!(" ({left_out} more {kind} before)") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_each_kind_there_is_one_line_a_minute_with_a_count() {
        let (limiter, began) = (WarningLimiter::default(), Instant::now());
        let at = |ms| began + Duration::from_millis(ms);
        // A thousand a second for two and a half minutes.
        let lines: Vec<String> = (0..150_000).filter_map(|ms| limiter.due("refused connections", at(ms))).collect();
        let more = " (59999 more refused connections before)";
        assert_eq!(lines, ["", more, more]);
        assert_eq!(limiter.due("alien samples", at(1)).as_deref(), Some(""), "another kind has a line of its own");
        assert_eq!(limiter.due("alien samples", at(60_001)).as_deref(), Some(""), "nothing was left out");
        assert_eq!(limiter.0.lock().unwrap()["refused connections"].left_out, 29_999, "which the end tells");
    }
}
