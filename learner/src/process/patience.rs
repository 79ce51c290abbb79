//! How long a learner waits for its actors: when it says so, and when it gives up. Pure.

use std::time::Duration;

/// An actor that has not answered for this long is reported, and again after each [`NOTICE_INTERVAL`]. Both are at most
/// a quarter of the deadline: the orchestrator kills the actor at half of it.
const FIRST_NOTICE: Duration = Duration::from_secs(2);
const NOTICE_INTERVAL: Duration = Duration::from_secs(10);

#[derive(Debug, Clone, Copy)]
pub struct Patience {
    deadline: Duration,
    notice: Duration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Waited {
    Wait(Duration),
    /// Report those who are missing, then wait on, at most this long.
    Notice(Duration),
    Overdue,
}

impl Patience {
    pub fn new(deadline_s: f64) -> Self {
        let deadline = Duration::try_from_secs_f64(deadline_s).unwrap_or(Duration::MAX);
        Self { deadline, notice: FIRST_NOTICE.min(deadline / 4) }
    }

    pub fn after(&mut self, waited: Duration) -> Waited {
        if waited >= self.deadline {
            return Waited::Overdue;
        }
        let noticed = waited >= self.notice;
        if noticed {
            self.notice = waited + NOTICE_INTERVAL.min(self.deadline / 4);
        }
        let left = self.notice.min(self.deadline).saturating_sub(waited);
        if noticed { Waited::Notice(left) } else { Waited::Wait(left) }
    }
}
