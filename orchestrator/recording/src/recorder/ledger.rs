//! Which samples are new: the pure core of the recorder.
//!
//! Every frame trained on must be recorded once. But a restarted actor sends its last observation again, a restarted
//! learner takes all actors back to its checkpoint, and an older sample may still be in flight. The headers distinguish
//! all these cases.
//!
//! The ledger is also where the receipts come from that a learner waits for ([`wire::Receipt`]).

use std::ops::Range;
use wire::Receipt;
use wire::message::{ObservationHeader, can_follow};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The next observations: record what was done and what is seen.
    News,
    /// The first observations under a learner incarnation. What is seen is news; the transition describes the action
    /// before the point that the learner went back to, which was recorded when it was taken.
    RestorePoint,
    /// Sent before: a restarted actor repeats where it stands.
    Repeated,
    Stale,
    /// It names an actor, a half or a learner that does not exist, or an exchange far ahead.
    Alien,
}

const AHEAD_MOST: u64 = 1 << 20;

pub struct Ledger {
    actors: Vec<Seen>,
    missed: u64,
}

/// What has been seen of one actor. Its samples come in order; those of several learners' actors do not.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    learner_incarnation: u32,
    last_step: [Option<u64>; 2],
    /// Samples that were not sent before, under any learner incarnation.
    samples: u64,
}

impl Ledger {
    pub fn new(actors: u32) -> Self {
        Self { actors: vec![Seen::default(); actors as usize], missed: 0 }
    }

    pub fn has(&self, actor: u32) -> bool {
        (actor as usize) < self.actors.len()
    }

    pub fn judge(&mut self, header: &ObservationHeader) -> Verdict {
        let Some(seen) = self.actors.get_mut(header.actor as usize).filter(|_| header.half < 2) else {
            return Verdict::Alien;
        };
        if header.learner_incarnation < seen.learner_incarnation {
            return Verdict::Stale;
        }
        if !can_follow(seen.learner_incarnation, header.learner_incarnation) {
            return Verdict::Alien;
        }
        if header.learner_incarnation > seen.learner_incarnation {
            (seen.learner_incarnation, seen.last_step) = (header.learner_incarnation, [None; 2]);
        }
        let last = &mut seen.last_step[header.half as usize];
        match *last {
            None => {
                *last = Some(header.step);
                seen.samples += 1;
                Verdict::RestorePoint
            }
            Some(newest) if header.step <= newest => Verdict::Repeated,
            Some(newest) if header.step - newest > AHEAD_MOST => Verdict::Alien,
            Some(newest) => {
                self.missed += header.step - newest - 1;
                *last = Some(header.step);
                seen.samples += 1;
                Verdict::News
            }
        }
    }

    /// The exchange up to which the samples of this half have come from every one of `actors`; none while some are at
    /// different learner incarnations.
    ///
    /// # Panics
    /// If there is no such actor or half.
    pub fn complete(&self, actors: Range<u32>, half: u32) -> Option<Receipt> {
        let seen = &self.actors[actors.start as usize..actors.end as usize];
        let learner_incarnation = seen.first()?.learner_incarnation;
        let steps = seen
            .iter()
            .map(|seen| seen.last_step[half as usize].filter(|_| seen.learner_incarnation == learner_incarnation));
        let step = steps.min().flatten()?;
        Some(Receipt { learner_incarnation, step })
    }

    /// Samples of `actors` that were not sent before: as many receipts have been given for them.
    ///
    /// # Panics
    /// If there is no such actor.
    pub fn news(&self, actors: Range<u32>) -> u64 {
        self.actors[actors.start as usize..actors.end as usize].iter().map(|seen| seen.samples).sum()
    }

    /// Exchanges that never arrived. Learners answer what was judged here and nothing else, so anything but 0 is a
    /// fault.
    pub fn missed(&self) -> u64 {
        self.missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn header(actor: u32, half: u32, learner_incarnation: u32, step: u64) -> ObservationHeader {
        ObservationHeader { actor, half, learner_incarnation, step, ..Default::default() }
    }

    #[test]
    fn a_rewind_is_recorded_again_and_what_was_on_the_way_is_not() {
        use Verdict::{News, Repeated, RestorePoint, Stale};
        let mut ledger = Ledger::new(1);
        let verdicts = [(1, 0), (1, 1), (1, 2), (2, 1), (1, 3), (2, 2), (2, 2), (2, 3)]
            .map(|(incarnation, step)| ledger.judge(&header(0, 0, incarnation, step)));
        assert_eq!(verdicts, [RestorePoint, News, News, RestorePoint, Stale, News, Repeated, News]);
        assert_eq!(ledger.missed(), 0);
    }

    #[test]
    fn what_one_learners_actors_sent_before_a_fall_is_news_also_after_anothers_came_back() {
        use Verdict::{News, RestorePoint};
        let mut ledger = Ledger::new(2);
        let verdicts = [(0, 1, 0), (1, 1, 0), (0, 2, 0), (1, 1, 1), (1, 2, 0), (1, 2, 1)]
            .map(|(actor, incarnation, step)| ledger.judge(&header(actor, 0, incarnation, step)));
        assert_eq!(verdicts, [RestorePoint, RestorePoint, RestorePoint, News, RestorePoint, News]);
    }

    #[test]
    fn numbers_that_cannot_be_do_not_silence_what_comes_after() {
        use Verdict::{Alien, News, RestorePoint};
        let mut ledger = Ledger::new(1);
        let verdicts = [(u32::MAX, 0), (1, 0), (u32::MAX, 1), (1, 1), (1, u64::MAX), (1, 2)]
            .map(|(incarnation, step)| ledger.judge(&header(0, 0, incarnation, step)));
        assert_eq!(verdicts, [Alien, RestorePoint, Alien, News, Alien, News]);
        assert_eq!(ledger.missed(), 0);
    }

    #[test]
    fn what_is_complete_has_come_from_all_under_one_learner() {
        let mut ledger = Ledger::new(3);
        let receipt = |learner_incarnation, step| Some(Receipt { learner_incarnation, step });
        let mut after = |actor, incarnation, step| {
            ledger.judge(&header(actor, 1, incarnation, step));
            (ledger.complete(0..2, 1), ledger.complete(2..3, 1), ledger.complete(0..3, 0))
        };
        assert_eq!(after(0, 1, 4), (None, None, None));
        assert_eq!(after(1, 1, 4), (receipt(1, 4), None, None));
        assert_eq!(after(1, 1, 5), (receipt(1, 4), None, None));
        assert_eq!(after(2, 1, 9), (receipt(1, 4), receipt(1, 9), None));
        assert_eq!(after(0, 2, 4), (None, receipt(1, 9), None), "one has gone back, the other not yet");
        assert_eq!(after(1, 2, 4), (receipt(2, 4), receipt(1, 9), None));
    }

    #[test]
    fn nobody_can_make_it_index_out_of_bounds() {
        let mut ledger = Ledger::new(2);
        assert_eq!(ledger.judge(&header(2, 0, 1, 0)), Verdict::Alien);
        assert_eq!(ledger.judge(&header(0, 2, 1, 0)), Verdict::Alien);
    }

    proptest! {
        /// However often samples are repeated and halves interleave, every exchange is news exactly once.
        #[test]
        fn every_exchange_is_news_once(order in prop::collection::vec((0u32..3, 0u32..2, 0u64..3), 0..200)) {
            let mut ledger = Ledger::new(3);
            let mut next = [[0u64; 2]; 3];
            let mut news = 0;
            let mut sent = 0;
            for (actor, half, back) in order {
                let position = &mut next[actor as usize][half as usize];
                // `back` = 0 is the next one, anything else a repetition.
                let step = position.saturating_sub(back);
                if step == *position { *position += 1; sent += u64::from(step > 0); }
                if ledger.judge(&header(actor, half, 1, step)) == Verdict::News { news += 1; }
            }
            prop_assert_eq!(news, sent);
            let begun: u64 = next.as_flattened().iter().map(|&position| u64::from(position > 0)).sum();
            prop_assert_eq!(ledger.news(0..3), sent + begun, "and has a receipt");
            prop_assert_eq!(ledger.missed(), 0);
        }
    }
}
