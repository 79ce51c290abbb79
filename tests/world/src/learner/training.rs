//! Rollouts: announced, collected, agreed on, trained.

use super::sample::Sample;
use super::{After, Choice, Chosen, CutShort, InUpdate, LOOK, Learner, Phase, Stop, Then};
use crate::kernel::{MILLISECOND, Next, SECOND, World};
use crate::meeting::Word;
use crate::model::{choose, look, of_action, of_bootstrap, of_outcome, updated};
use crate::service::TaskId;
use crate::setup::{Mutation, NOISE};
use learner::collector::{ActionBatch, Collector, Lane, Missing, Received, Reward, Task};
use learner::process::{Patience, Permission, Waited};
use orchestrator::Exit;
use proto::event::{LearnerEvent, Timing};
use proto::exit::EXIT_LOST_PEERS;
use proto::stage::{RolloutShape, position_at};
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;
use wire::{Receipt, Written};

/// Longest wait for a rollout's announcement.
const ANNOUNCEMENT_DEADLINE: u64 = 60 * SECOND;
/// Longest wait until a collected rollout's recording is written.
const WRITING_DEADLINE: u64 = 60 * SECOND;
/// The same once a stop is announced.
const WRITING_PATIENCE: u64 = 5 * SECOND;

/// The first learner's word about the recording of a rollout.
const WRITTEN: u8 = 0;
const STOP_ANNOUNCED: u8 = 1;
const ORCHESTRATOR_GONE: u8 = 2;
const FAULT: u8 = 3;

impl Learner {
    /// The head of the loop.
    pub(super) fn next_rollout(&mut self, world: &mut World) -> Next {
        self.phase = Phase::Announcing { began: world.now };
        Next::After(10)
    }

    pub(super) fn await_announcement(&mut self, world: &mut World, me: TaskId, began: u64) -> Next {
        let (rollout, frames) = self.next();
        let Some(position) = position_at(&world.setup.config.stages, frames) else {
            return self.save_unsaved(world, me, Then::Leave { complete: true });
        };
        if let Err(next) = self.receive_all(world) {
            return next;
        }
        if let Some(stop) = self.stop_asked(world) {
            return self.finish_update(world, me, After::Agreement(Some(CutShort::Stop(stop))));
        }
        let left = (began + ANNOUNCEMENT_DEADLINE).saturating_sub(world.now);
        let config = &world.setup.config;
        match self.announcements.permission(&config.stages, rollout, frames) {
            Ok(Permission::Begin { version }) => {
                let composition = config.reward(&config.stages[position.stage].reward);
                let reward = Reward { composition, multiplier: 0.0 };
                let steps = config.ppo.rollout_steps as usize;
                let shape = RolloutShape::next(position.frames_left, steps, config.environments());
                let shape = shape.part(self.columns.clone());
                let deadline_s = config.learner.actor_deadline_s;
                self.digests.fill(0);
                let pace = world.setup.paces[(rollout % 2) as usize];
                self.collector().go_at(pace);
                self.collector().begin(shape, reward, version);
                self.phase = Phase::Collecting { patience: Patience::new(deadline_s), began: world.now };
                Next::After(10)
            }
            Ok(Permission::Stop) => {
                self.finish_update(world, me, After::Agreement(Some(CutShort::Stop(Stop::Announced))))
            }
            Ok(Permission::Wait) if left == 0 => {
                world.note(|| format!("learner {}: rollout {rollout} was not announced", self.rank));
                if !world.may_hang() {
                    world.violate(format!("rollout {rollout} was not announced to learner {}", self.rank));
                }
                self.finish_update(world, me, After::Agreement(Some(CutShort::Fault)))
            }
            Ok(Permission::Wait) => {
                self.phase = Phase::Announcing { began };
                Next::Wait(left.min(LOOK))
            }
            Err(error) => {
                world.violate(format!("learner {}: {error}", self.rank));
                Next::Exit(Exit::Code(1))
            }
        }
    }

    /// Receives every waiting sample; an error of the protocol ends the process.
    fn receive_all(&mut self, world: &mut World) -> Result<(), Next> {
        let Some(port) = self.ports.as_ref().map(|ports| ports.observations) else { return Ok(()) };
        loop {
            let service = &mut world.wires[self.session].observations[self.rank as usize];
            let (sample, awake) = service.receive(port, &mut world.dice);
            world.ring_all(awake);
            let Some(sample) = sample else { break };
            let header = sample.value.0;
            let received = self.collector().receive(&header, Sample(sample));
            world.note(|| format!("learner {}: {header:?}: {received:?}", self.rank));
            match received {
                Ok(Received::Hello { .. }) if world.setup.has(Mutation::ForgetsRestores) => {}
                Ok(Received::Hello { actor, actor_incarnation }) => self.restore(world, actor, actor_incarnation),
                Ok(Received::Kept | Received::Duplicate | Received::Foreign) => {}
                Err(error) => {
                    world.violate(format!("learner {}: {error}", self.rank));
                    return Err(Next::Exit(Exit::Code(1)));
                }
            }
        }
        let actors = self.actors.clone();
        let own = |(&(actor, half), &receipt): (&(u32, u32), &Receipt)| {
            actors.contains(&actor).then_some((actor, half, receipt))
        };
        let receipts: Vec<_> = world.shared[self.session].receipts.iter().filter_map(own).collect();
        for (actor, half, receipt) in receipts {
            self.collector().recorded(actor, half, receipt);
        }
        Ok(())
    }

    pub(super) fn restore(&mut self, world: &mut World, actor: u32, actor_incarnation: u32) {
        let (header, states) = self.collector().restore(actor, actor_incarnation);
        let Some(ports) = &self.ports else { return };
        let (_, port) = ports.actors[(actor - self.actors.start) as usize];
        let service = &mut world.wires[self.session].restores[actor as usize];
        let sample = (header, Rc::new(states));
        service.update(port);
        for place in 0..service.places() {
            service.deliver(port, 0, place, &sample);
        }
        let listeners = service.listeners();
        world.ring_all(listeners);
    }

    fn stop_asked(&mut self, world: &mut World) -> Option<Stop> {
        if let Some(ports) = &self.ports {
            while let Some(word) = world.wires[self.session].stage.receive(ports.stage, &mut world.dice).0 {
                self.announcements.hear(word.value);
            }
        }
        if self.gone { Some(Stop::OrchestratorGone) } else { self.announcements.stop().then_some(Stop::Announced) }
    }

    /// Receives; an error with what is to be done, or with nothing if there is only to wait, while actors are missing.
    fn await_actors(
        &mut self,
        world: &mut World,
        me: TaskId,
        waits_for: impl Fn(&Collector<Sample>) -> Missing,
        (patience, began): (&mut Patience, u64),
    ) -> Result<(), Option<Next>> {
        self.receive_all(world).map_err(Some)?;
        let Missing { actors: missing, .. } = waits_for(self.collector());
        if let Some(stop) = self.stop_asked(world) {
            return Err(Some(self.finish_update(world, me, After::Agreement(Some(CutShort::Stop(stop))))));
        }
        if missing.is_empty() {
            return Ok(());
        }
        let waited = world.since(began);
        match patience.after(waited) {
            Waited::Overdue => {
                return Err(Some(self.finish_update(world, me, After::Agreement(Some(CutShort::Fault)))));
            }
            Waited::Wait(_) => {}
            Waited::Notice(_) => {
                for actor in missing {
                    let (rank, waited_s) = (self.rank, waited.as_secs_f64());
                    self.tell(world, me, LearnerEvent::WaitingForActor { rank, actor, waited_s });
                }
            }
        }
        Err(None)
    }

    /// Waits until the recorder has the observations of some lanes; then their actions follow.
    pub(super) fn await_receipts(
        &mut self,
        world: &mut World,
        me: TaskId,
        (lanes, chosen): (Vec<Lane>, Chosen),
        (mut patience, began): (Patience, u64),
    ) -> Next {
        let unrecorded = |collector: &Collector<Sample>| collector.unrecorded(&lanes);
        match self.await_actors(world, me, unrecorded, (&mut patience, began)) {
            Err(Some(next)) => next,
            Err(None) => self.stay(Phase::Receipting { lanes, chosen, patience, began }, Next::Wait(LOOK)),
            Ok(()) => {
                let batches = self.act(&lanes, &chosen);
                self.stay(Phase::Answering(batches.into()), Next::After(10))
            }
        }
    }

    /// The rollout in progress, up to what takes time.
    pub(super) fn collect(&mut self, world: &mut World, me: TaskId, mut patience: Patience, began: u64) -> Next {
        match self.collector().task() {
            Task::Await => match self.await_actors(world, me, Collector::missing, (&mut patience, began)) {
                Ok(()) => self.go_on(world, 5),
                Err(Some(next)) => next,
                Err(None) => self.stay(Phase::Collecting { patience, began }, Next::Wait(LOOK)),
            },
            Task::Act(lanes) => {
                if !self.connected && self.collector().all_seen() {
                    self.connected = true;
                    self.tell(world, me, LearnerEvent::ActorsConnected { rank: self.rank });
                }
                self.settle(&lanes);
                let chosen = self.look(&lanes);
                let patience = Patience::new(world.setup.config.learner.actor_deadline_s);
                self.phase = Phase::Receipting { lanes, chosen, patience, began: world.now };
                Next::After(world.dice.spread(200, 4 * MILLISECOND))
            }
            Task::Finish => self.finish_update(world, me, After::Agreement(None)),
        }
    }

    /// The next task, with a new wait.
    fn go_on(&mut self, world: &World, micros: u64) -> Next {
        let patience = Patience::new(world.setup.config.learner.actor_deadline_s);
        self.phase = Phase::Collecting { patience, began: world.now };
        Next::After(micros)
    }

    fn digest_of(&mut self, column: usize, more: u64) {
        self.digests[column] = self.digests[column].wrapping_add(more);
    }

    fn settle(&mut self, lanes: &[Lane]) {
        for settled in self.collector().settle(lanes) {
            let outcome = settled.outcome;
            let flags = [outcome.ended, outcome.time_limit, outcome.label];
            let more = of_outcome(settled.t, self.columns.start + settled.column, outcome.reward, flags);
            self.digest_of(settled.column, more);
        }
    }

    /// What the policy is given for each column of some lanes, and what it chooses.
    fn look(&mut self, lanes: &[Lane]) -> Chosen {
        let weights = self.acting;
        let batch = self.collector().batch(lanes);
        let input = batch.input();
        let seen = |(i, (&column, t)): (usize, (&usize, usize))| {
            let noise = &input.gumbel[i * NOISE..][..NOISE];
            let seen = look(&input.numbers[3 * i..][..3], noise, input.previous_action[i], input.episode_start[i]);
            Choice { t, column, seen, action: choose(weights, seen) }
        };
        input.columns.iter().zip(batch.rows()).enumerate().map(seen).collect()
    }

    /// Answers some lanes. Of those whose last action is taken, what is seen is for the bootstrap.
    fn act(&mut self, lanes: &[Lane], chosen: &[Choice]) -> Vec<ActionBatch> {
        let actions: Vec<u8> = chosen.iter().map(|choice| choice.action).collect();
        let batches = self.collector().answer(lanes, &actions);
        // What the collector has made of the agent's choice: HOLD where a column does not act.
        let mut sent = batches.iter().flat_map(|batch| batch.actions.clone());
        let steps = self.collector().steps();
        for &Choice { t, column, seen, action } in chosen {
            let place = self.columns.start + column;
            if t == steps {
                self.digest_of(column, of_bootstrap(place, seen));
            } else if sent.next() == Some(action) {
                self.digest_of(column, of_action(t, place, action, seen));
            }
        }
        batches
    }

    /// Sends one batch after the other, then has all actors woken; a kill can come in between.
    pub(super) fn answer(&mut self, world: &mut World, mut batches: VecDeque<ActionBatch>) -> Next {
        while let Some(ActionBatch { actor, mut header, actions }) = batches.pop_front() {
            let Some(ports) = &self.ports else { break };
            let (port, _) = ports.actors[(actor - self.actors.start) as usize];
            self.answered.push(actor);
            let actions = Rc::new(actions);
            let twice = world.setup.has(Mutation::AnswersTwice) && world.dice.once_in(20);
            for again in 0..if twice { 3 } else { 1 } {
                let service = &mut world.wires[self.session].actions[actor as usize];
                service.update(port);
                for place in 0..service.places() {
                    service.deliver(port, 0, place, &(header, Rc::clone(&actions)));
                }
                header.step += u64::from(again == 1);
            }
            if world.dice.once_in(16) {
                self.phase = Phase::Answering(batches);
                return Next::After(world.dice.between(5, 50));
            }
        }
        // Another thread rings them.
        for actor in std::mem::take(&mut self.answered) {
            let listeners = world.wires[self.session].actions[actor as usize].listeners();
            world.ring_all(listeners);
        }
        self.go_on(world, 10)
    }

    /// Agrees with the others at the end of a rollout.
    fn meet(&mut self, world: &mut World, me: TaskId, own: Option<CutShort>) -> Next {
        let flag = |cut| u64::from(own == Some(cut));
        let numbers = vec![
            self.collector().collected(),
            flag(CutShort::Stop(Stop::Announced)),
            flag(CutShort::Stop(Stop::OrchestratorGone)),
            flag(CutShort::Fault),
        ];
        let digest = self.digests.iter().fold(0, |sum: u64, digest| sum.wrapping_add(*digest));
        self.begin(world, me, Word::Sum(numbers, digest), Phase::Agreed(own))
    }

    pub(super) fn agreed(&mut self, world: &mut World, me: TaskId, own: Option<CutShort>, words: &[Word]) -> Next {
        let mut sums = [0_u64; 4];
        let mut sum = 0_u64;
        for word in words {
            let Word::Sum(numbers, digest) = word else { continue };
            sums.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number);
            sum = sum.wrapping_add(*digest);
        }
        let [collected, announced, gone, faults] = sums;
        if faults > 0 {
            let here = own == Some(CutShort::Fault);
            world.note(|| format!("learner {}: cannot go on (its own fault: {here})", self.rank));
            let status = if here { 1 } else { EXIT_LOST_PEERS };
            return self.save_unsaved(world, me, Then::Fail { status });
        }
        if announced + gone > 0 {
            return self.save_unsaved(world, me, Then::Leave { complete: false });
        }
        let (rollout, frames) = (self.rollout, self.frames + collected);
        if self.rank == 0 {
            self.tell(world, me, LearnerEvent::RolloutCollected { rank: 0, rollout, frames, here: collected });
        }
        if world.setup.has(Mutation::IgnoresReceipts) {
            return self.train(world, me, [sum, collected]);
        }
        if self.rank > 0 {
            return self.begin(world, me, Word::First(0), Phase::Recorded { sum, collected });
        }
        self.stay(Phase::Recording { sum, collected, began: world.now }, Next::After(10))
    }

    /// Until the recording of the collected rollout is written. The first learner waits for all.
    pub(super) fn await_written(&mut self, world: &mut World, me: TaskId, numbers: [u64; 3]) -> Next {
        let [sum, collected, began] = numbers;
        if let Err(next) = self.receive_all(world) {
            return next;
        }
        let stop = self.stop_asked(world);
        let shared = &world.shared[self.session];
        let is_written =
            |written: &Written| written.learner_incarnation == self.incarnation && written.rollout > self.rollout;
        let waited = world.now - began;
        let word = match stop {
            _ if shared.written.as_ref().is_some_and(is_written) => WRITTEN,
            Some(Stop::OrchestratorGone) => ORCHESTRATOR_GONE,
            Some(Stop::Announced) if shared.failure.is_some() || waited >= WRITING_PATIENCE => STOP_ANNOUNCED,
            _ if waited >= WRITING_DEADLINE => FAULT,
            _ => return self.stay(Phase::Recording { sum, collected, began }, Next::Wait(LOOK)),
        };
        self.begin(world, me, Word::First(word), Phase::Recorded { sum, collected })
    }

    pub(super) fn recorded(&mut self, world: &mut World, me: TaskId, numbers: [u64; 2], words: &[Word]) -> Next {
        match words[0] {
            Word::First(WRITTEN) => self.train(world, me, numbers),
            Word::First(FAULT) => {
                let status = if self.rank == 0 { 1 } else { EXIT_LOST_PEERS };
                self.save_unsaved(world, me, Then::Fail { status })
            }
            _ => self.save_unsaved(world, me, Then::Leave { complete: false }),
        }
    }

    /// Begins the update. The next rollout is collected meanwhile, or follows it.
    fn train(&mut self, world: &mut World, me: TaskId, [sum, collected]: [u64; 2]) -> Next {
        let config = &world.setup.config;
        let (overlap, position) = (config.ppo.overlap, position_at(&config.stages, self.frames));
        let Some(position) = position else { return Next::Exit(Exit::Code(EXIT_LOST_PEERS)) };
        self.collector().finish();
        self.compare(world, collected);
        self.in_update = Some(InUpdate {
            rollout: self.rollout,
            frames: self.frames + collected,
            sum,
            stage: position.stage as u32,
            ends_stage: collected == position.frames_left,
            through: world.now + world.dice.spread(2 * MILLISECOND, 60 * MILLISECOND),
        });
        if overlap {
            self.acting = self.weights;
        }
        if collected == position.frames_left || !overlap {
            return self.finish_update(world, me, After::NextRollout);
        }
        self.next_rollout(world)
    }

    /// The next rollout to be collected, and the frames before it.
    fn next(&self) -> (u64, u64) {
        self.in_update.map_or((self.rollout, self.frames), |update| (update.rollout + 1, update.frames))
    }

    /// What is trained on is what an undisturbed run trains on.
    fn compare(&self, world: &mut World, collected: u64) {
        let (rank, rollout) = (self.rank, self.rollout);
        let Some(expected) = world.model.rollouts.get(rollout as usize) else {
            return world.violate(format!("learner {rank} trains on rollout {rollout}, which is beyond the budget"));
        };
        let next = world.model.rollouts.get(rollout as usize + 1).map_or(world.model.frames, |next| next.before);
        if expected.before != self.frames || next - expected.before != collected {
            let (before, frames) = (expected.before, self.frames);
            world.violate(format!(
                "rollout {rollout} has {collected} frames from {frames} on, not {} from {before}",
                next - before
            ));
        } else if expected.digests[self.columns.clone()] != self.digests[..] {
            world.violate(format!(
                "learner {rank}, rollout {rollout}: what is trained on differs from the undisturbed run"
            ));
        }
    }

    /// Waits for the update that has begun, if there is one.
    pub(super) fn finish_update(&mut self, world: &mut World, me: TaskId, after: After) -> Next {
        match self.in_update {
            None => self.after_update(world, me, after),
            Some(update) if update.through > world.now => {
                self.stay(Phase::Updating(after), Next::After(update.through - world.now))
            }
            Some(update) => {
                self.in_update = None;
                self.updated(world, me, update, after)
            }
        }
    }

    pub(super) fn after_update(&mut self, world: &mut World, me: TaskId, after: After) -> Next {
        match after {
            After::NextRollout => self.next_rollout(world),
            After::Agreement(own) => self.meet(world, me, own),
        }
    }

    fn updated(&mut self, world: &mut World, me: TaskId, update: InUpdate, after: After) -> Next {
        let InUpdate { rollout, frames, sum, stage, ends_stage, through: _ } = update;
        self.weights = updated(self.weights, sum);
        if world.setup.has(Mutation::TrainsTwice) && rollout == 1 && !std::mem::replace(&mut self.twice, true) {
            self.weights = updated(self.weights, sum);
        }
        if !world.setup.config.ppo.overlap {
            self.acting = self.weights;
        }
        (self.rollout, self.frames) = (rollout + 1, frames);
        if self.rank == 0 {
            let (timing, metrics) = (Timing::default(), BTreeMap::new());
            let trained = LearnerEvent::RolloutTrained { rank: 0, rollout, frames, stage, timing, metrics };
            self.tell(world, me, trained);
        }
        let due = world.since(self.last_save).as_secs_f64() >= world.setup.config.checkpoint.interval_s;
        self.begin(world, me, Word::First(u8::from(due)), Phase::Due { ends_stage, after })
    }
}
