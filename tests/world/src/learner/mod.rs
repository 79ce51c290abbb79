//! A learner: the real collector, announcements, patience and store in a shell that follows
//! `learner/src/process/training.rs` and `conversation.rs` turn by turn. In place of a network there is one number, the
//! weights, from which and from what is seen actions follow; an update makes the next number of everything that was
//! seen, done and got. So whatever is lost, doubled or taken in another order shows in all that follows.

mod sample;
mod save;
mod store;
mod training;

pub use store::tear_newest;

use crate::kernel::{MILLISECOND, Next, Program, SECOND, TORN, World};
use crate::meeting::{Lost, Meeting, Word};
use crate::service::{NoPlace, TaskId};
use crate::setup::{MAX_STEPS, Mutation, NOISE};
use learner::collector::{ActionBatch, Boundary, Collector, ColumnMap, Lane, Noise, Settings, Signals};
use learner::process::{Announcements, Patience};
use learner::shards::Shards;
use orchestrator::{Event, Exit};
use proto::event::LearnerEvent;
use proto::exit::EXIT_LOST_PEERS;
use sample::Sample;
use std::collections::VecDeque;
use std::ops::Range;
use std::rc::Rc;
use std::time::Duration;

/// Longest sleep without a look around.
const LOOK: u64 = 250 * MILLISECOND;

/// Why to save and leave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stop {
    Announced,
    OrchestratorGone,
}

/// Why a rollout is abandoned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CutShort {
    Stop(Stop),
    Fault,
}

/// What follows the end of an update.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum After {
    /// The next rollout.
    NextRollout,
    /// The agreement about the rollout that was collected beside it.
    Agreement(Option<CutShort>),
}

/// A rollout whose update has begun.
#[derive(Debug, Clone, Copy)]
struct InUpdate {
    rollout: u64,
    /// Frames trained on when the update is through.
    frames: u64,
    /// Of all that was seen, done and got in it.
    sum: u64,
    stage: u32,
    ends_stage: bool,
    /// When it is through.
    through: u64,
}

/// What follows when the state is saved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Then {
    /// The first rollout.
    Begin,
    /// What follows the update, also if it could not be saved.
    GoOn(After),
    /// The end, complete or not.
    Leave { complete: bool },
    /// The end with an error's status.
    Fail { status: i32 },
}

/// Where it stands.
enum Phase {
    /// It is starting, and waits for its lock.
    Starting,
    /// The others are being waited for.
    Meeting,
    /// The newest checkpoint is to be loaded.
    Loading,
    /// Whether all have loaded the same.
    Loaded,
    /// All have the same weights: the parts for the checkpoint follow.
    Agreeing(Then),
    /// The parts are on their way.
    Gathering(Then),
    /// Whether it was written.
    Writing(Then, bool),
    /// The actors are told where they stand, from this one on.
    Restoring(u32),
    /// The next rollout is to be announced.
    Announcing { began: u64 },
    /// Observations are to come.
    Collecting { patience: Patience, began: u64 },
    /// The recorder is to have what these actions answer.
    Receipting { lanes: Vec<Lane>, chosen: Chosen, patience: Patience, began: u64 },
    /// Actions are being sent.
    Answering(VecDeque<ActionBatch>),
    /// At the end of the rollout.
    Agreed(Option<CutShort>),
    /// The recording of the collected rollout is to be written: the first learner waits for it.
    Recording { sum: u64, collected: u64, began: u64 },
    /// Whether it is.
    Recorded { sum: u64, collected: u64 },
    /// The update is to be through.
    Updating(After),
    /// Whether a checkpoint is due.
    Due { ends_stage: bool, after: After },
}

/// What the policy has chosen for some columns.
type Chosen = Vec<Choice>;

/// What it has chosen for one at its row of the rollout.
#[derive(Debug, Clone, Copy)]
struct Choice {
    t: usize,
    column: usize,
    /// What it was given.
    seen: u64,
    action: u8,
}

/// Its open ports.
struct Ports {
    observations: u32,
    stage: u32,
    /// By its own actors: of actions and of restores.
    actors: Vec<(u32, u32)>,
}

pub struct Learner {
    session: usize,
    rank: u32,
    incarnation: u32,
    actors: Range<u32>,
    columns: Range<usize>,
    phase: Phase,
    ports: Option<Ports>,
    collector: Option<Collector<Sample>>,
    announcements: Announcements,
    rollout: u64,
    frames: u64,
    saved: Option<u64>,
    in_update: Option<InUpdate>,
    weights: u64,
    /// Those that choose actions.
    acting: u64,
    last_save: u64,
    /// By own column: what was seen, done and got in this rollout.
    digests: Vec<u64>,
    connected: bool,
    /// Actors that have been sent actions, and are to be woken.
    answered: Vec<u32>,
    gone: bool,
    gone_at: Option<u64>,
    twice: bool,
}

impl Learner {
    /// A learner that has just been started.
    pub fn new(world: &World, session: usize, rank: u32, incarnation: u32) -> Self {
        let config = &world.setup.config;
        let actors = config.shares().actors_of(rank);
        let each = config.actors.environments_per_actor as usize;
        let columns = actors.start as usize * each..actors.end as usize * each;
        Self {
            session,
            rank,
            incarnation,
            digests: vec![0; columns.len()],
            actors,
            columns,
            phase: Phase::Starting,
            ports: None,
            collector: None,
            announcements: Announcements::default(),
            rollout: 0,
            frames: 0,
            saved: None,
            in_update: None,
            weights: crate::model::FIRST_WEIGHTS,
            acting: crate::model::FIRST_WEIGHTS,
            last_save: world.now,
            connected: false,
            answered: vec![],
            gone: false,
            gone_at: None,
            twice: false,
        }
    }

    fn collector(&mut self) -> &mut Collector<Sample> {
        self.collector.as_mut().expect("there is a collector once the state is loaded")
    }

    fn open(&self, world: &mut World, me: TaskId) -> Result<Ports, NoPlace> {
        let wire = &mut world.wires[self.session];
        let observations = wire.observations[self.rank as usize].subscribe(me)?;
        let stage = wire.stage.subscribe(me)?;
        let pair =
            |actor: u32| Ok((wire.actions[actor as usize].publish(me)?, wire.restores[actor as usize].publish(me)?));
        let actors = self.actors.clone().map(pair).collect::<Result<_, NoPlace>>()?;
        Ok(Ports { observations, stage, actors })
    }

    fn tell(&self, world: &mut World, me: TaskId, event: LearnerEvent) {
        world.note(|| format!("learner {}: {event:?}", self.rank));
        world.tell_parent(me, Event::Learner { incarnation: self.incarnation, event });
    }

    // With the other learners

    fn meeting<'a>(&self, world: &'a mut World) -> &'a mut Meeting {
        let learners = world.setup.config.learner.count;
        world.meetings.entry((self.session, self.incarnation)).or_insert_with(|| Meeting::new(learners))
    }

    /// Begins a collective operation; what follows is `phase`.
    fn begin(&mut self, world: &mut World, me: TaskId, word: Word, phase: Phase) -> Next {
        self.phase = phase;
        let awake = self.meeting(world).begin(self.rank, me, word);
        world.ring_all(awake);
        Next::Wait(60 * SECOND)
    }

    /// The words of all, once they are there; else what to do.
    fn ended(&self, world: &mut World) -> Result<Rc<Vec<Word>>, Next> {
        let now = world.now;
        match self.meeting(world).end(self.rank, now) {
            None => Err(Next::Wait(60 * SECOND)),
            Some(Ok(words)) => Ok(words),
            Some(Err(Lost)) => Err(Next::Exit(Exit::Code(EXIT_LOST_PEERS))),
        }
    }

    // Starting

    fn take_lock(&mut self, world: &mut World, me: TaskId) -> Next {
        if *world.locks.entry(self.rank).or_insert(me) != me {
            return if self.gone { Next::Exit(Exit::Code(1)) } else { Next::After(100 * MILLISECOND) };
        }
        self.begin(world, me, Word::Here, Phase::Meeting)
    }

    fn load(&mut self, world: &mut World, me: TaskId) -> Next {
        let loaded = match store::store_of(world).load() {
            Ok(loaded) => loaded,
            Err(error) => {
                world.violate(format!("learner {}: {error}", self.rank));
                return Next::Exit(Exit::Code(1));
            }
        };
        let found = loaded.as_ref().map(|loaded| loaded.snapshot.rollout);
        if found < world.saved {
            let saved = world.saved;
            world.violate(format!("checkpoint {saved:?} was saved, and the run goes on from {found:?}"));
        }
        let boundary = match loaded {
            None => Boundary::start(self.columns.len()),
            Some(loaded) => {
                let mut snapshot = loaded.snapshot;
                snapshot.keep(self.columns.clone());
                (self.rollout, self.frames) = (snapshot.rollout, snapshot.frames);
                self.saved = Some(snapshot.rollout);
                self.weights = snapshot.agent.adam_steps;
                let overlaps = world.setup.config.ppo.overlap && !world.setup.has(Mutation::ForgetsPolicies);
                self.acting = if overlaps { snapshot.agent.multiplier as u64 } else { self.weights };
                world.note(|| {
                    format!("learner {}: checkpoint {}, {:?} rejected", self.rank, loaded.path, loaded.rejected)
                });
                snapshot.boundary
            }
        };
        let config = &world.setup.config;
        let settings = Settings {
            column_map: ColumnMap::of(self.rank, config),
            seed: config.seed,
            noise: Noise::Gumbel(NOISE),
            max_episode_steps: MAX_STEPS,
            task: config.spec(),
            gamma: config.ppo.gamma,
            signals: Signals::of(config),
            learner_incarnation: self.incarnation,
            recorded: !world.setup.has(Mutation::IgnoresReceipts),
        };
        let shards = Shards::one(settings.column_map.columns());
        self.collector = Some(Collector::new(settings, &shards, boundary));
        let word = Word::Same(self.saved.map_or(0, |rollout| rollout + 1));
        self.begin(world, me, word, Phase::Loaded)
    }

    fn ready(&mut self, world: &mut World, me: TaskId) -> Next {
        let Ok(ports) = self.open(world, me) else {
            world.note(|| format!("learner {}: no place for its ports", self.rank));
            return Next::Exit(Exit::Code(1));
        };
        self.ports = Some(ports);
        let ready = LearnerEvent::Ready {
            rank: self.rank,
            rollout: self.rollout,
            frames: self.frames,
            device: "cpu".to_owned(),
            parameters: 1,
            checkpoint: self.saved.map(|rollout| rollout.to_string()),
        };
        self.tell(world, me, ready);
        if self.saved.is_none() {
            return self.save(world, me, Then::Begin);
        }
        self.phase = Phase::Restoring(self.actors.start);
        Next::After(10)
    }

    fn restore_next(&mut self, world: &mut World, actor: u32) -> Next {
        if actor == self.actors.end {
            return self.next_rollout(world);
        }
        self.restore(world, actor, 0);
        self.phase = Phase::Restoring(actor + 1);
        Next::After(10)
    }

    fn same(words: &[Word]) -> bool {
        let number = |word: &Word| if let Word::Same(number) = word { Some(*number) } else { None };
        words.iter().map(number).all(|value| value.is_some() && value == number(&words[0]))
    }
}

impl Program for Learner {
    fn turn(&mut self, world: &mut World, me: TaskId) -> Next {
        if self.gone {
            let since = *self.gone_at.get_or_insert(world.now);
            let longest = Duration::from_secs_f64(world.setup.config.longest_update_s());
            if world.since(since) > longest {
                return Next::Exit(Exit::Signal(6));
            }
        }
        match std::mem::replace(&mut self.phase, Phase::Starting) {
            Phase::Starting => self.take_lock(world, me),
            Phase::Meeting => {
                if let Err(next) = self.ended(world) {
                    return self.stay(Phase::Meeting, next);
                }
                self.stay(Phase::Loading, Next::After(world.dice.spread(MILLISECOND, 100 * MILLISECOND)))
            }
            Phase::Loading => self.load(world, me),
            Phase::Loaded => match self.ended(world) {
                Err(next) => self.stay(Phase::Loaded, next),
                Ok(words) if Self::same(&words) => self.ready(world, me),
                Ok(words) => {
                    // One that is torn while they load is still whole to some: they end, and start again together.
                    if !world.faults.contains_key(TORN) {
                        world.violate(format!("the learners' checkpoints differ: {words:?}"));
                    }
                    Next::Exit(Exit::Code(1))
                }
            },
            Phase::Agreeing(then) => match self.ended(world) {
                Err(next) => self.stay(Phase::Agreeing(then), next),
                Ok(words) if Self::same(&words) => self.gather(world, me, then),
                Ok(words) => {
                    world.violate(format!("the learners' weights differ: {words:?}"));
                    Next::Exit(Exit::Code(1))
                }
            },
            Phase::Gathering(then) => match self.ended(world) {
                Err(next) => self.stay(Phase::Gathering(then), next),
                Ok(words) => self.write(world, me, then, &words),
            },
            Phase::Writing(then, good) => match self.ended(world) {
                Err(next) => self.stay(Phase::Writing(then, good), next),
                Ok(words) => self.written(world, me, then, &words),
            },
            Phase::Restoring(actor) => self.restore_next(world, actor),
            Phase::Announcing { began } => self.await_announcement(world, me, began),
            Phase::Collecting { patience, began } => self.collect(world, me, patience, began),
            Phase::Receipting { lanes, chosen, patience, began } => {
                self.await_receipts(world, me, (lanes, chosen), (patience, began))
            }
            Phase::Answering(batches) => self.answer(world, batches),
            Phase::Agreed(own) => match self.ended(world) {
                Err(next) => self.stay(Phase::Agreed(own), next),
                Ok(words) => self.agreed(world, me, own, &words),
            },
            Phase::Recording { sum, collected, began } => self.await_written(world, me, [sum, collected, began]),
            Phase::Recorded { sum, collected } => match self.ended(world) {
                Err(next) => self.stay(Phase::Recorded { sum, collected }, next),
                Ok(words) => self.recorded(world, me, [sum, collected], &words),
            },
            Phase::Updating(after) => self.finish_update(world, me, after),
            Phase::Due { ends_stage, after } => match self.ended(world) {
                Err(next) => self.stay(Phase::Due { ends_stage, after }, next),
                Ok(words) if ends_stage || matches!(words[0], Word::First(1)) => {
                    self.save(world, me, Then::GoOn(after))
                }
                Ok(_) => self.after_update(world, me, after),
            },
        }
    }

    fn let_go(&mut self) -> Option<Exit> {
        self.gone = true;
        None
    }
}

impl Learner {
    fn stay(&mut self, phase: Phase, next: Next) -> Next {
        self.phase = phase;
        next
    }
}
