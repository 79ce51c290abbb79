//! Which actors act together, measured while a run trains.
//!
//! A pace changes no bit of a run, only its time. Which one is faster depends on the machine, the kitchens and the
//! policy (BENCHMARKS.md, Batching by readiness): where actors set the pace it is better that the fast run ahead, where
//! the GPU does it is better that all go together. So both are timed, now and then, and the faster one is kept. Learners
//! wait for each other, so all get the mean of their times, and decide alike.

use crate::collector::Pace;
use std::time::Duration;

/// Rollouts of a trial. The first does not count: what runs beside it is of another pace.
const TRIAL: usize = 6;
/// Both trials, one after the other.
const TRIALS: usize = 2 * TRIAL;
/// Rollouts from one trial to the next.
const PERIOD: usize = 120;
/// What the other pace may take at most, as a share of the present one's time, to take its place.
const FASTER: f64 = 0.98;

#[derive(Debug)]
pub(super) struct Pacing {
    /// The one that was faster.
    present: Pace,
    /// What is tried beside it.
    other: Option<Pace>,
    /// What the rollouts since the last trial began took.
    took: Vec<Duration>,
}

impl Pacing {
    pub(super) fn fixed(pace: Pace) -> Self {
        Self { present: pace, other: None, took: Vec::new() }
    }

    /// Whichever is faster; this one at first.
    pub(super) fn faster_than(first: Pace) -> Self {
        Self { other: Some(first.other()), ..Self::fixed(first) }
    }

    /// The pace of the next rollout. `took`: what the one before took as a whole; none before there was one, and none of
    /// the first.
    pub(super) fn next(&mut self, took: Option<Duration>) -> Pace {
        let Some(other) = self.other else { return self.present };
        self.took.extend(took);
        match self.took.len() {
            TRIAL..TRIALS => return other,
            TRIALS => self.compare(other),
            PERIOD => self.took.clear(),
            _ => {}
        }
        self.present
    }

    /// After both were tried.
    fn compare(&mut self, other: Pace) {
        let [present_s, other_s] = [0, TRIAL].map(|first| median_s(&self.took[first + 1..first + TRIAL]));
        if other_s < FASTER * present_s {
            tracing::info!("a rollout takes {other_s:.2} s in place of {present_s:.2} s if its actors go {other}");
            self.other = Some(std::mem::replace(&mut self.present, other));
        }
    }
}

/// Checkpoints and other processes make some rollouts long.
fn median_s(times: &[Duration]) -> f64 {
    let mut sorted = times.to_vec();
    sorted.sort_unstable();
    sorted[sorted.len() / 2].as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;
    use Pace::{Lockstep, Ready};

    /// Rollouts take this long at each pace: the paces chosen.
    fn run(pacing: &mut Pacing, rollouts: usize, milliseconds: impl Fn(usize, Pace) -> u64) -> Vec<Pace> {
        let mut chosen: Vec<Pace> = Vec::new();
        for rollout in 0..rollouts {
            let before = rollout.checked_sub(1).map(|n| Duration::from_millis(milliseconds(n, chosen[n])));
            chosen.push(pacing.next(before));
        }
        chosen
    }

    #[test]
    fn the_faster_pace_is_kept_and_the_other_tried_again() {
        let mut pacing = Pacing::faster_than(Lockstep);
        // Then the actors become slow.
        let chosen = run(&mut pacing, 3 * PERIOD, |n, pace| match pace {
            Lockstep if n < PERIOD => 500,
            Lockstep => 600,
            Ready => 550,
        });
        let (first, second) = (&chosen[..PERIOD], &chosen[PERIOD..2 * PERIOD]);
        assert!((0..PERIOD).all(|n| (first[n] == Ready) == (TRIAL..TRIALS).contains(&n)), "{first:?}");
        assert!((0..PERIOD).all(|n| (second[n] == Ready) == (n >= TRIAL)), "{second:?}");
        let third = &chosen[2 * PERIOD..];
        assert!((0..PERIOD).all(|n| (third[n] == Lockstep) == (TRIAL..TRIALS).contains(&n)), "{third:?}");
    }

    #[test]
    fn neither_a_small_difference_nor_single_long_rollouts_change_the_pace() {
        let mut pacing = Pacing::faster_than(Ready);
        // Checkpoints, and the first rollout of a pace.
        let long = |n: usize| if n.is_multiple_of(TRIAL) || n == 2 || n == 4 { 400 } else { 0 };
        let chosen = run(&mut pacing, PERIOD, |n, pace| long(n) + if pace == Ready { 500 } else { 495 });
        assert_eq!(chosen[TRIALS..], [Ready; PERIOD - TRIALS]);
        assert_eq!(run(&mut Pacing::fixed(Lockstep), 2 * PERIOD, |_, _| 1), [Lockstep; 2 * PERIOD]);
    }
}
