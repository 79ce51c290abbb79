//! Saving: the order of `Training::save`, `save_or_go_on` and `leave`, with the real store on the world's disk.

use super::store::store_of;
use super::{Learner, Phase, Then};
use crate::kernel::{MILLISECOND, Next, World};
use crate::meeting::Word;
use crate::service::TaskId;
use learner::agent::AgentState;
use learner::checkpoint::{CheckpointError, Snapshot};
use orchestrator::Exit;
use proto::event::LearnerEvent;
use proto::exit::{EXIT_LOST_PEERS, EXIT_UNSAVED};
use proto::trained::History;
use std::collections::BTreeMap;

impl Learner {
    /// Begins to save.
    pub(super) fn save(&mut self, world: &mut World, me: TaskId, then: Then) -> Next {
        let word = Word::Same(self.weights);
        self.begin(world, me, word, Phase::Agreeing(then))
    }

    /// Saves, unless this very boundary is on disk.
    pub(super) fn save_unsaved(&mut self, world: &mut World, me: TaskId, then: Then) -> Next {
        if self.saved == Some(self.rollout) { self.saved_all(world, me, then) } else { self.save(world, me, then) }
    }

    pub(super) fn gather(&mut self, world: &mut World, me: TaskId, then: Then) -> Next {
        let word = Word::Part(self.collector().boundary());
        self.begin(world, me, word, Phase::Gathering(then))
    }

    /// The first learner writes; then all hear whether it could.
    pub(super) fn write(&mut self, world: &mut World, me: TaskId, then: Then, words: &[Word]) -> Next {
        let mut good = true;
        if self.rank == 0 {
            let snapshot = self.snapshot(words, world);
            let cut = world.take_cut();
            if let Some((operations, _)) = cut {
                world.disk.crash_in(operations);
            }
            let saved = store_of(world).save(&snapshot, &History::default(), false);
            if world.disk.take_crash() {
                world.power_fails = cut.is_some_and(|(_, power)| power);
                world.note(|| format!("learner 0 dies while it saves rollout {}", self.rollout));
                return Next::Exit(Exit::Signal(9));
            }
            if saved.is_ok() {
                world.saved = world.saved.max(Some(self.rollout));
            }
            if let Err(error) = saved {
                good = false;
                if !matches!(error, CheckpointError::Write { .. } | CheckpointError::Recording { .. }) {
                    world.violate(format!("learner 0: {error}"));
                }
                world.note(|| format!("learner 0: {error}"));
            }
        }
        self.begin(world, me, Word::First(u8::from(good)), Phase::Writing(then, good))
    }

    fn snapshot(&self, words: &[Word], world: &mut World) -> Snapshot {
        let mut parts = words.iter().filter_map(|word| if let Word::Part(part) = word { Some(part) } else { None });
        let mut boundary = parts.next().expect("the first learner has a part").clone();
        // As `Snapshot::append` does it, without the beliefs' tensor.
        for part in parts {
            boundary.exchange = boundary.exchange.max(part.exchange);
            boundary.environments.extend(part.environments.iter().cloned());
            boundary.running.extend_from_slice(&part.running);
        }
        let agent = AgentState {
            tensors: BTreeMap::new(),
            adam_steps: self.weights,
            // In its place, which holds every such number: the weights that act.
            multiplier: self.acting as f64,
            carried_goal: world.setup.config.network.carried_goal,
        };
        Snapshot { rollout: self.rollout, frames: self.frames, agent, boundary, weights: self.digest() }
    }

    pub(super) fn written(&mut self, world: &mut World, me: TaskId, then: Then, words: &[Word]) -> Next {
        self.last_save = world.now;
        if !matches!(words[0], Word::First(1)) {
            return match then {
                Then::GoOn(after) => self.after_update(world, me, after),
                _ if self.rank == 0 => Next::Exit(Exit::Code(EXIT_UNSAVED)),
                _ => Next::Exit(Exit::Code(EXIT_LOST_PEERS)),
            };
        }
        self.saved = Some(self.rollout);
        if self.rank == 0 {
            let path = self.rollout.to_string();
            let written = LearnerEvent::CheckpointWritten { rank: 0, rollout: self.rollout, frames: self.frames, path };
            self.tell(world, me, written);
        }
        self.saved_all(world, me, then)
    }

    fn saved_all(&mut self, world: &mut World, me: TaskId, then: Then) -> Next {
        match then {
            Then::Begin => {
                self.phase = Phase::Restoring(self.actors.start);
                Next::After(world.dice.spread(100, MILLISECOND))
            }
            Then::GoOn(after) => self.after_update(world, me, after),
            Then::Leave { complete } => {
                let (rank, frames, weights) = (self.rank, self.frames, self.digest());
                self.tell(world, me, LearnerEvent::Finished { rank, frames, weights, complete });
                Next::Exit(Exit::Code(0))
            }
            Then::Fail { status } => Next::Exit(Exit::Code(status)),
        }
    }

    /// The weights as 64 hex digits.
    fn digest(&self) -> String {
        format!("{:064x}", self.weights)
    }
}
