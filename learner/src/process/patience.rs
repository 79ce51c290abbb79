//! How long a learner waits for its actors: when it says so, and when it gives up. Pure.

use std::time::Duration;

/// The orchestrator kills an actor at its deadline; a learner gives up after as long again.
pub const DEADLINES: f64 = 2.0;

/// An actor that has not answered for this long is reported, and again after each [`NOTICE_INTERVAL`]. Both are at most
/// half of the actor's deadline.
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
    /// `actor_deadline_s`: after how long the orchestrator kills an actor.
    pub fn new(actor_deadline_s: f64) -> Self {
        let deadline = Duration::try_from_secs_f64(DEADLINES * actor_deadline_s).unwrap_or(Duration::MAX);
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
