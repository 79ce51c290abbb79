//! The supervisor's clock: the time that the orchestrator was able to act. Pure.
//!
//! While the orchestrator is stopped (SIGSTOP, Ctrl-Z) or gets no processor, what its children say waits in pipes. By
//! the time of the day their deadlines would all be over when it goes on, and it would kill children that work. So
//! such a time does not count.

use std::time::Duration;

/// The loop wakes four times a second. A longer pause is no pause of its own.
const LONGEST_TURN: Duration = Duration::from_secs(2);

/// A clock that stands still while nobody looks at it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Clock {
    looked: Duration,
    stood: Duration,
}

impl Clock {
    /// The time at `real`, and for how long the clock stood still since the last look, if it did.
    pub fn at(&mut self, real: Duration) -> (Duration, Option<Duration>) {
        let turn = real.saturating_sub(self.looked);
        self.looked = self.looked.max(real);
        let stood = turn.checked_sub(LONGEST_TURN).filter(|stood| !stood.is_zero());
        self.stood += stood.unwrap_or_default();
        (self.looked - self.stood, stood)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_pause_does_not_count() {
        let at = Duration::from_millis;
        let mut clock = Clock::default();
        assert_eq!(clock.at(at(250)), (at(250), None));
        assert_eq!(clock.at(at(2_250)), (at(2_250), None));
        assert_eq!(clock.at(at(102_250)), (at(4_250), Some(at(98_000))));
        assert_eq!(clock.at(at(102_500)), (at(4_500), None));
        assert_eq!(clock.at(at(102_400)), (at(4_500), None), "it never goes back");
    }
}
