//! The orchestrator's loop: the real supervisor in a shell that follows `orchestrator/src/supervisor/shell.rs`.

use crate::actor::Actor;
use crate::kernel::{Label, MILLISECOND, Next, Note, Program, SECOND, Shared, World};
use crate::learner::Learner;
use crate::recorder::Recorder;
use crate::service::TaskId;
use crate::setup::Mutation;
use crate::wire::Wire;
use orchestrator::{Action, Clock, Deadlines, Event, Exit, Outcome, Process, Supervisor};
use proto::event::LearnerEvent;
use std::collections::{BTreeMap, VecDeque};
use wire::message::StageAnnouncement;

/// Interval of looking at deadlines and of giving the announcement to those who have come.
const TICK: u64 = 250 * MILLISECOND;
/// Ticks after a death on which the dead are swept.
const SWEEPS_AFTER_DEATH: u32 = 4;

enum Phase {
    /// Its services are to be made.
    Starting,
    /// The recorder's ports are being waited for.
    Recorder,
    Running,
    /// The recorder finishes.
    Finishing(Outcome),
}

/// The orchestrator as a process.
pub struct Session {
    number: usize,
    phase: Phase,
    machine: Supervisor,
    pending: VecDeque<Action>,
    own_events: VecDeque<Event>,
    children: BTreeMap<Process, TaskId>,
    announcer: u32,
    begun: u64,
    /// Stands still while this process is stopped.
    clock: Clock,
    next_tick: u64,
    sweeps: u32,
    recording_failed: bool,
    /// The learners that are listened to.
    learner_incarnation: u32,
}

impl Session {
    /// The next session of the run.
    pub fn new(world: &World) -> Self {
        let config = &world.setup.config;
        Self {
            number: world.wires.len(),
            phase: Phase::Starting,
            machine: Supervisor::new(Deadlines::of(config), config.stages.clone()),
            pending: VecDeque::new(),
            own_events: VecDeque::new(),
            children: BTreeMap::new(),
            announcer: 0,
            begun: 0,
            clock: Clock::default(),
            next_tick: 0,
            sweeps: 0,
            recording_failed: false,
            learner_incarnation: 0,
        }
    }

    fn start(&mut self, world: &mut World, me: TaskId) -> Next {
        self.number = world.wires.len();
        let mut wire = Wire::new(world.setup.config.shares());
        self.announcer = wire.stage.publish(me).expect("nobody else announces");
        world.wires.push(wire);
        world.shared.push(Shared::default());
        let recorder = Recorder::new(world, self.number);
        world.spawn(Label::Recorder, Some(me), 1, Box::new(recorder), 200);
        self.phase = Phase::Recorder;
        Next::After(MILLISECOND)
    }

    fn begin(&mut self, world: &mut World) -> Next {
        if !world.shared[self.number].ready {
            self.phase = Phase::Recorder;
            return Next::After(MILLISECOND);
        }
        (self.begun, self.next_tick) = (world.now, world.now);
        self.pending = self.machine.start(world.since(self.begun)).into();
        self.phase = Phase::Running;
        Next::After(50)
    }

    /// One action, or one event: a kill can come in between.
    fn run(&mut self, world: &mut World, me: TaskId) -> Next {
        self.phase = Phase::Running;
        if let Some(action) = self.pending.pop_front() {
            return self.carry_out(world, me, action);
        }
        let tick_is_due = world.now >= self.next_tick;
        let heard = match self.own_events.pop_front() {
            Some(event) => Some(event),
            // Where both are ready, either may come first.
            None if tick_is_due && world.dice.once_in(2) => None,
            None => world.hear(me),
        };
        let event = match heard {
            Some(event) => event,
            None if tick_is_due => {
                self.next_tick = world.now + TICK;
                Event::Tick
            }
            None => return Next::Wait(self.next_tick - world.now),
        };
        self.take_note(world, &event);
        if event != Event::Tick {
            world.note(|| format!("orchestrator: {event:?}"));
        }
        let (now, _) = self.clock.at(world.since(self.begun));
        self.pending = self.machine.on_event(now, event).into();
        Next::After(world.dice.between(10, 100))
    }

    fn carry_out(&mut self, world: &mut World, me: TaskId, action: Action) -> Next {
        world.note(|| format!("orchestrator: {action:?}"));
        match action {
            Action::Spawn { process, incarnation } => self.spawn(world, me, process, incarnation),
            Action::CloseLifeline(process) => {
                if let Some(&task) = self.children.get(&process) {
                    world.let_go(task);
                }
            }
            Action::Kill(process) => {
                if let Some(&task) = self.children.get(&process) {
                    world.finish(task, &Exit::Signal(9));
                }
            }
            Action::Announce(announcement) => self.announce(world, &announcement),
            Action::Report(_, text) => {
                // Nobody who lives is silent, if nobody was stopped.
                let words = ["has not answered for", "have finished no ", "has finished no "];
                let hung = words.iter().any(|words| text.contains(words));
                if hung && !world.may_hang() {
                    world.violate(text);
                }
            }
            Action::SwitchStage(_) => {}
            Action::Finish(outcome) => {
                world.shared[self.number].finish = true;
                for recorder in world.tasks(|label| label == Label::Recorder) {
                    world.ring(recorder);
                }
                self.phase = Phase::Finishing(outcome);
            }
        }
        Next::After(world.dice.between(10, 100))
    }

    fn spawn(&mut self, world: &mut World, me: TaskId, process: Process, incarnation: u32) {
        if world.take_no_process() {
            let exit = Exit::NotStarted("no process is left".to_owned());
            self.own_events.push_back(Event::Exited { process, incarnation, exit, last_words: vec![] });
            return;
        }
        let (program, delay): (Box<dyn Program>, u64) = match process {
            Process::Learner(rank) => {
                self.learner_incarnation = incarnation;
                let delay = world.dice.spread(20 * MILLISECOND, SECOND);
                (Box::new(Learner::new(world, self.number, rank, incarnation)), delay)
            }
            Process::Actor(actor) => {
                let delay = world.dice.spread(20 * MILLISECOND, SECOND);
                (Box::new(Actor::new(world, self.number, actor, incarnation)), delay)
            }
        };
        let task = world.spawn(Label::Child(process), Some(me), incarnation, program, delay);
        self.children.insert(process, task);
    }

    fn announce(&mut self, world: &mut World, announcement: &StageAnnouncement) {
        let stage = &mut world.wires[self.number].stage;
        stage.update(self.announcer);
        if !world.setup.has(Mutation::ForgetsHistory) {
            stage.remember(announcement);
        }
        for place in 0..stage.places() {
            stage.deliver(self.announcer, 0, place, announcement);
        }
        self.ring_learners(world);
    }

    fn ring_learners(&self, world: &mut World) {
        for task in world.wires[self.number].stage.listeners() {
            world.ring(task);
        }
    }

    fn sweep(&self, world: &mut World) {
        if world.setup.has(Mutation::NeverSweeps) {
            return;
        }
        let now = world.now;
        for task in world.wires[self.number].sweep(now) {
            world.ring(task);
        }
    }

    /// What the recorder is told of a learner.
    fn tell_recorder(&self, world: &mut World, event: &LearnerEvent) {
        let learner_incarnation = self.learner_incarnation;
        let note = match *event {
            LearnerEvent::Ready { rank: 0, frames, .. } => Note::Began { learner_incarnation, frames },
            LearnerEvent::RolloutCollected { rollout, frames, here, .. } => {
                Note::Collected { learner_incarnation, rollout, frames, here }
            }
            _ => return,
        };
        world.shared[self.number].notes.push_back(note);
        for recorder in world.tasks(|label| label == Label::Recorder) {
            world.ring(recorder);
        }
    }

    fn take_note(&mut self, world: &mut World, event: &Event) {
        match event {
            Event::Exited { process, .. } => {
                self.children.remove(process);
                self.sweep(world);
                self.sweeps = SWEEPS_AFTER_DEATH;
            }
            Event::Learner { incarnation, event } if *incarnation == self.learner_incarnation => {
                self.tell_recorder(world, event);
            }
            Event::Tick => {
                world.wires[self.number].stage.update(self.announcer);
                self.ring_learners(world);
                if self.sweeps > 0 {
                    self.sweeps -= 1;
                    self.sweep(world);
                }
                let failure = world.shared[self.number].failure.clone();
                if let Some(failure) = failure.filter(|_| !std::mem::replace(&mut self.recording_failed, true)) {
                    self.own_events.push_back(Event::CannotWrite(failure));
                }
            }
            _ => {}
        }
    }
}

impl Program for Session {
    fn turn(&mut self, world: &mut World, me: TaskId) -> Next {
        match std::mem::replace(&mut self.phase, Phase::Starting) {
            Phase::Starting => self.start(world, me),
            Phase::Recorder => self.begin(world),
            Phase::Running => self.run(world, me),
            Phase::Finishing(outcome) => {
                if !world.shared[self.number].finished {
                    self.phase = Phase::Finishing(outcome);
                    return Next::After(20 * MILLISECOND);
                }
                world.outcomes.push((self.number, outcome));
                Next::Exit(Exit::Code(0))
            }
        }
    }
}
