//! How long a learner waits for its actors: when it says so, and when it gives up. Pure.

use std::time::Duration;

/// An actor that has not answered for this long is reported, and again after each [`NOTICE_INTERVAL`].
const FIRST_NOTICE: Duration = Duration::from_secs(2);
const NOTICE_INTERVAL: Duration = Duration::from_secs(10);

/// One wait.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    deadline: Duration,
    notice: Duration,
}

/// What a wait has come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Waited {
    /// Wait on, at most this long.
    Wait(Duration),
    /// Report those who are missing, then wait on, at most this long.
    Notice(Duration),
    /// Too long.
    Overdue,
}

impl Patience {
    /// A wait that ends after `deadline_s` seconds.
    pub fn new(deadline_s: f64) -> Self {
        let deadline = Duration::try_from_secs_f64(deadline_s).unwrap_or(Duration::MAX);
        Self { deadline, notice: FIRST_NOTICE }
    }

    /// Where the wait stands after this time.
    pub fn after(&mut self, waited: Duration) -> Waited {
        if waited >= self.deadline {
            return Waited::Overdue;
        }
        let noticed = waited >= self.notice;
        if noticed {
            self.notice = waited + NOTICE_INTERVAL;
        }
        let left = self.notice.min(self.deadline).saturating_sub(waited);
        if noticed { Waited::Notice(left) } else { Waited::Wait(left) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_late_is_reported_now_and_then_until_it_is_too_late() {
        let s = Duration::from_secs;
        let mut patience = Patience::new(20.0);
        assert_eq!(patience.after(s(0)), Waited::Wait(s(2)));
        assert_eq!(patience.after(s(1)), Waited::Wait(s(1)));
        assert_eq!(patience.after(s(3)), Waited::Notice(s(10)));
        assert_eq!(patience.after(s(4)), Waited::Wait(s(9)));
        assert_eq!(patience.after(s(13)), Waited::Notice(s(7)));
        assert_eq!(patience.after(s(19)), Waited::Wait(s(1)));
        assert_eq!(patience.after(s(20)), Waited::Overdue);
        assert_eq!(Patience::new(f64::INFINITY).after(s(1)), Waited::Wait(s(1)), "no deadline");
    }
}
