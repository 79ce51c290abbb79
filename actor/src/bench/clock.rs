//! Time that this thread has spent on a processor, so that other programs of the machine do not count.

use rustix::time::{ClockId, clock_gettime};
use std::time::Duration;

/// Calls between two readings of the clock, which costs about a hundredth of a frame.
const CALLS_PER_LOOK: usize = 16;

fn processor_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    let (seconds, nanoseconds) = (now.tv_sec.unsigned_abs(), now.tv_nsec.unsigned_abs());
    Duration::from_secs(seconds) + Duration::from_nanos(nanoseconds)
}

/// Calls for at least `span` of processor time; returns seconds of it for each call.
pub fn seconds_per_call(span: Duration, mut call: impl FnMut()) -> f64 {
    let started = processor_time();
    let mut calls = 0usize;
    loop {
        for _ in 0..CALLS_PER_LOOK {
            call();
        }
        calls += CALLS_PER_LOOK;
        let elapsed = processor_time().saturating_sub(started);
        if elapsed >= span {
            return elapsed.as_secs_f64() / calls as f64;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeping_takes_no_processor_time() {
        let before = processor_time();
        std::thread::sleep(Duration::from_millis(50));
        assert!(processor_time().saturating_sub(before) < Duration::from_millis(40));
    }

    #[test]
    fn calls_are_counted() {
        let mut calls = 0;
        let span = Duration::from_millis(5);
        let seconds = seconds_per_call(span, || calls += 1);
        assert_eq!(calls % CALLS_PER_LOOK, 0);
        assert!(seconds * f64::from(calls as u32) >= span.as_secs_f64() * 0.999);
    }
}
