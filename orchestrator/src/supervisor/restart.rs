//! How often a process may die. Pure.
//!
//! A process that dies is started again, at first at once and then with growing pauses. It is given up when it dies
//! too often without the run getting any further: in a short time (a crash loop) or over any time (a process that
//! always lives just long enough). Progress means that the run reached a frame count it had never reached before, so
//! a learner that falls back to the same checkpoint again and again does not count as progress.

use std::collections::VecDeque;
use std::time::Duration;

#[derive(Debug, Clone, Copy)]
pub struct RestartPolicy {
    pub in_window: usize,
    pub window: Duration,
    pub in_all: usize,
    /// Pause before the second restart; doubles with each further one. The first is at once.
    pub first_pause: Duration,
    pub longest_pause: Duration,
}

impl Default for RestartPolicy {
    fn default() -> Self {
        Self {
            in_window: 5,
            window: Duration::from_mins(1),
            in_all: 20,
            first_pause: Duration::from_millis(250),
            longest_pause: Duration::from_secs(4),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    RestartAt(Duration),
    GiveUp { deaths: usize },
}

#[derive(Debug, Clone, Default)]
pub struct RestartHistory {
    recent: VecDeque<Duration>,
    deaths: usize,
    last_error: Option<String>,
}

impl RestartHistory {
    pub fn progress(&mut self) {
        self.recent.clear();
        self.deaths = 0;
        self.last_error = None;
    }

    /// Notes the error that a process died of; whether it died of the same one before, without progress between.
    pub fn failed_again(&mut self, error: Option<&str>) -> bool {
        let again = error.is_some() && self.last_error.as_deref() == error;
        self.last_error = error.map(str::to_owned);
        again
    }

    pub fn died(&mut self, now: Duration, deadlines: &RestartPolicy) -> Verdict {
        self.deaths += 1;
        self.recent.push_back(now);
        while self.recent.front().is_some_and(|&first| now.saturating_sub(first) > deadlines.window) {
            self.recent.pop_front();
        }
        if self.recent.len() > deadlines.in_window || self.deaths > deadlines.in_all {
            return Verdict::GiveUp { deaths: self.deaths };
        }
        let pause = match self.recent.len() {
            0 | 1 => Duration::ZERO,
            recent => deadlines.first_pause.saturating_mul(1 << (recent - 2).min(16)).min(deadlines.longest_pause),
        };
        Verdict::RestartAt(now + pause)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(value: f64) -> Duration {
        Duration::from_secs_f64(value)
    }

    #[test]
    fn a_crash_loop_is_given_up_after_growing_pauses() {
        let deadlines = RestartPolicy::default();
        let mut history = RestartHistory::default();
        let mut now = seconds(10.0);
        let mut pauses = vec![];
        loop {
            match history.died(now, &deadlines) {
                Verdict::RestartAt(at) => {
                    pauses.push(at.saturating_sub(now).as_millis());
                    now = at;
                }
                Verdict::GiveUp { deaths } => {
                    assert_eq!(deaths, 6);
                    break;
                }
            }
        }
        assert_eq!(pauses, [0, 250, 500, 1000, 2000]);
    }

    #[test]
    fn only_the_same_error_without_progress_comes_again() {
        let mut history = RestartHistory::default();
        let again =
            ["a", "b", "b", ""].map(|error| history.failed_again(Some(error).filter(|error| !error.is_empty())));
        assert_eq!(again, [false, false, true, false]);
        assert!(!history.failed_again(Some("b")), "a death of another kind lies between");
        history.progress();
        assert!(!history.failed_again(Some("b")));
    }

    #[test]
    fn slow_deaths_are_bounded_too_and_progress_forgives() {
        let deadlines = RestartPolicy::default();
        let restarts = |pause_s: f64, progress: bool| {
            let mut history = RestartHistory::default();
            let verdicts = (0..1000).map(|i| {
                let verdict = history.died(seconds(pause_s * f64::from(i)), &deadlines);
                if progress {
                    history.progress();
                }
                verdict
            });
            verdicts.take_while(|verdict| matches!(verdict, Verdict::RestartAt(_))).count()
        };
        assert_eq!([restarts(30.0, false), restarts(1.0, true)], [deadlines.in_all, 1000]);
    }
}
