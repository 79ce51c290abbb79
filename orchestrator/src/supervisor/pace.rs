//! How long the learners take from one event of progress to the next, as measured in this session. Pure.
//!
//! What a machine needs for a rollout or an update spans four orders of magnitude, so no constant tells a learner that
//! hangs from one that works. The longest of the last times does: see [`super::deadlines::Deadlines::patience`].

use std::collections::VecDeque;
use std::fmt::{Display, Formatter};
use std::time::Duration;

/// How many of the last times count, of a kind of work. One long wait is forgotten after as many.
const WINDOW: usize = 16;
/// The same of episodes: dozens may end together, and then none for a whole episode's length.
const EPISODES: usize = 1024;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Work {
    #[default]
    Collect,
    Update,
    Save,
    Play,
}

impl Display for Work {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Collect => "rollout",
            Self::Update => "update",
            Self::Save => "checkpoint",
            Self::Play => "episode",
        })
    }
}

#[derive(Debug, Clone, Default)]
pub struct Pace {
    times: [VecDeque<Duration>; 4],
}

impl Pace {
    pub fn took(&mut self, work: Work, time: Duration) {
        let times = &mut self.times[work as usize];
        if times.len() == if work == Work::Play { EPISODES } else { WINDOW } {
            times.pop_front();
        }
        times.push_back(time);
    }

    pub fn longest(&self, work: Work) -> Option<Duration> {
        self.times[work as usize].iter().max().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_wait_is_forgotten_after_a_window() {
        let mut pace = Pace::default();
        assert_eq!(pace.longest(Work::Update), None);
        pace.took(Work::Update, Duration::from_secs(50));
        for _ in 1..WINDOW {
            pace.took(Work::Update, Duration::from_secs(2));
            assert_eq!(pace.longest(Work::Update), Some(Duration::from_secs(50)));
        }
        pace.took(Work::Update, Duration::from_secs(1));
        assert_eq!(pace.longest(Work::Update), Some(Duration::from_secs(2)));
        assert_eq!(pace.longest(Work::Save), None, "each kind has its own times");
    }
}
