//! A recorder in the collector's simulated world: it takes samples in its own time, and what it has not taken of an
//! actor is lost when that actor dies.

use super::{HalfSample, Message};
use proto::record::flag;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use wire::Receipt;
use wire::message::observation_kind;

/// The recorder.
#[derive(Debug, Default)]
pub struct Taker {
    pub queue: VecDeque<Message>,
    /// The newest sample taken of each half of each actor: learner incarnation and exchange.
    newest: BTreeMap<(u32, u32), (u32, u64)>,
    /// Steps taken: actor, environment, episode, step.
    pub steps: BTreeSet<(u32, u32, u32, u32)>,
}

impl Taker {
    /// Takes one sample, if one waits, and gives a receipt: actor, half, receipt. Outcomes at the point that a learner
    /// goes back to are taken to be known, as the ledger does.
    #[allow(clippy::option_option)]
    pub fn take(&mut self) -> Option<Option<(u32, u32, Receipt)>> {
        let (header, sample) = self.queue.pop_front()?;
        if header.kind != observation_kind::OBSERVATIONS {
            return Some(None);
        }
        let at = (header.learner_incarnation, header.step);
        let before = self.newest.get(&(header.actor, header.half)).copied();
        if before.is_some_and(|before| at <= before) {
            return Some(None);
        }
        self.newest.insert((header.actor, header.half), at);
        if before.is_some_and(|(learner_incarnation, _)| learner_incarnation == header.learner_incarnation) {
            for record in (0..sample.len()).map(|i| sample.header(i)) {
                if record.has(flag::ACTED) {
                    self.steps.insert((header.actor, record.environment, record.acted_episode, record.acted_step));
                }
            }
        }
        let receipt = Receipt { learner_incarnation: header.learner_incarnation, step: header.step };
        Some(Some((header.actor, header.half, receipt)))
    }

    /// An actor dies in the middle of sending: the recorder has none of what it has not taken.
    pub fn lose(&mut self, actor: u32) {
        self.queue.retain(|(header, _)| header.actor != actor);
    }
}
