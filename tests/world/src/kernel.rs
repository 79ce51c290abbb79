//! The machine that the world runs on: a clock, a queue of what happens when, and a table of processes.
//!
//! A process is one task or more (the orchestrator has two: its loop and the recorder's thread). A task is a
//! [`Program`] that takes turns. In one turn it does what a real process does between two moments at which anything
//! else could be noticed; between its turns it can be stopped or killed.

use crate::dice::Dice;
use crate::disk::SimulatedDisk;
use crate::meeting::Meeting;
use crate::model::Model;
use crate::service::TaskId;
use crate::setup::Setup;
use crate::wire::Wire;
use ::wire::{Receipt, Written};
use orchestrator::{Event, Exit, Outcome, Process};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// A second of the world's clock, which counts microseconds.
pub const SECOND: u64 = 1_000_000;
pub const MILLISECOND: u64 = 1_000;

/// What a task does after a turn.
#[derive(Debug)]
pub enum Next {
    /// It is busy, and takes its next turn after this many microseconds.
    After(u64),
    /// It sleeps until somebody rings, at most this long.
    Wait(u64),
    /// Its process ends.
    Exit(Exit),
}

/// A program, as the processor sees it.
pub trait Program {
    fn turn(&mut self, world: &mut World, me: TaskId) -> Next;
    /// Its lifeline has closed. The end of its process, if that is what follows.
    fn let_go(&mut self) -> Option<Exit> {
        None
    }
}

/// Who a task is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Label {
    /// Who starts the run, and resumes it.
    User,
    /// The orchestrator's loop.
    Orchestrator,
    /// The recorder's thread.
    Recorder,
    /// A child of an orchestrator.
    Child(Process),
}

struct Task {
    label: Label,
    /// The first task of its process.
    process: TaskId,
    /// Who hears of its end.
    parent: Option<TaskId>,
    incarnation: u32,
    program: Option<Box<dyn Program>>,
    /// Number of its next wake-up: others are out of date.
    wake: u64,
    asleep: bool,
    rung: bool,
    /// When it was stopped, that it missed its turn meanwhile.
    stopped: Option<bool>,
    /// Nothing that it says arrives before what it said earlier.
    said: u64,
}

enum Happening {
    Wake(TaskId, u64),
    Ring(TaskId),
    Hear(TaskId, Event),
    Continue(TaskId),
    LetGo(TaskId),
}

/// What the recorder is told of a learner.
#[derive(Debug, Clone, Copy)]
pub enum Note {
    /// One goes on from this many frames.
    Began { learner_incarnation: u32, frames: u64 },
    /// A rollout is collected.
    Collected {
        /// By this incarnation.
        learner_incarnation: u32,
        /// Which.
        rollout: u64,
        /// Frames with it.
        frames: u64,
        /// Its own.
        here: u64,
    },
}

/// What a session and its recorder share; and the recorder's receipts, which learners and actors read.
#[derive(Debug, Default)]
pub struct Shared {
    /// The recorder has its ports.
    pub ready: bool,
    /// The recorder is to finish.
    pub finish: bool,
    /// It has.
    pub finished: bool,
    /// Why it stopped writing.
    pub failure: Option<String>,
    /// What it is told of the learners.
    pub notes: VecDeque<Note>,
    /// By actor: the newest incarnation that it has heard.
    pub met: BTreeMap<u32, u32>,
    /// By actor and half: what it has taken.
    pub receipts: BTreeMap<(u32, u32), Receipt>,
    /// Frames of the run whose steps are all recorded, as it counts them.
    pub confirmed: Option<u64>,
    /// How far it has written.
    pub written: Option<Written>,
    /// It takes no turn before this time: its thread gets no processor.
    pub lags_until: u64,
}

/// The kind of fault that waits for the next save.
pub const CUT_IN_SAVE: &str = "cut in a save";
/// The kind of fault that tears a checkpoint.
pub const TORN: &str = "torn checkpoint";
/// The kind of fault that waits for the next process.
pub const NO_PROCESS: &str = "no process";

pub struct World {
    pub setup: Setup,
    /// What it must come to.
    pub model: Model,
    /// Microseconds since the world began.
    pub now: u64,
    /// Chance.
    pub dice: Dice,
    pub disk: SimulatedDisk,
    /// By session.
    pub wires: Vec<Wire>,
    /// By session and incarnation of the learners.
    pub meetings: BTreeMap<(usize, u32), Meeting>,
    /// By session.
    pub shared: Vec<Shared>,
    /// Who holds the learners' locks, by rank.
    pub locks: BTreeMap<u32, TaskId>,
    /// How the sessions that came to an outcome ended.
    pub outcomes: Vec<(usize, Outcome)>,
    /// The next checkpoint is interrupted at this operation of the file system; with true the power fails there.
    pub cut_in_save: Option<(u32, bool)>,
    /// The newest rollout whose checkpoint was called saved, and was not torn since.
    pub saved: Option<u64>,
    /// The next process cannot be started.
    pub no_process: bool,
    /// The power is to fail now.
    pub power_fails: bool,
    /// The first thing that was wrong.
    pub violation: Option<String>,
    pub faults: BTreeMap<&'static str, u64>,
    /// When the last one did.
    pub last_fault: u64,
    /// Turns taken.
    pub turns: u64,
    /// Everything that happened, if it is kept.
    pub trace: Option<Vec<String>>,
    inboxes: BTreeMap<TaskId, VecDeque<Event>>,
    tasks: BTreeMap<TaskId, Task>,
    next_task: TaskId,
    queue: BTreeMap<(u64, u64), Happening>,
    queued: u64,
    over: bool,
}

impl World {
    /// A world in which nothing has happened.
    pub fn new(setup: Setup, model: Model, dice: Dice, traced: bool) -> Self {
        Self {
            setup,
            model,
            now: 0,
            dice,
            disk: SimulatedDisk::default(),
            wires: vec![],
            meetings: BTreeMap::new(),
            shared: vec![],
            locks: BTreeMap::new(),
            outcomes: vec![],
            cut_in_save: None,
            saved: None,
            no_process: false,
            power_fails: false,
            violation: None,
            faults: BTreeMap::new(),
            last_fault: 0,
            turns: 0,
            trace: traced.then(Vec::new),
            inboxes: BTreeMap::new(),
            tasks: BTreeMap::new(),
            next_task: 1,
            queue: BTreeMap::new(),
            queued: 0,
            over: false,
        }
    }

    /// The time since `begin`, as the programs measure it.
    pub fn since(&self, begin: u64) -> Duration {
        Duration::from_micros(self.now - begin)
    }

    /// Keeps a line of the trace.
    pub fn note(&mut self, line: impl FnOnce() -> String) {
        if let Some(trace) = &mut self.trace {
            trace.push(format!("{:>14.6} {}", self.now as f64 / SECOND as f64, line()));
        }
    }

    /// Something is wrong: the world ends.
    pub fn violate(&mut self, what: String) {
        self.note(|| format!("VIOLATION: {what}"));
        self.violation.get_or_insert(what);
        self.over = true;
    }

    /// Whether somebody has been stopped so far: then others may find it silent.
    pub fn may_hang(&self) -> bool {
        self.faults.keys().any(|kind| kind.starts_with("stop") || kind.starts_with("lag"))
    }

    /// A fault of this kind strikes now.
    pub fn count_fault(&mut self, kind: &'static str) {
        *self.faults.entry(kind).or_default() += 1;
        self.last_fault = self.now;
    }

    /// Where the save that begins is to be cut, and whether by a power failure; this is when it strikes.
    pub fn take_cut(&mut self) -> Option<(u32, bool)> {
        let cut = self.cut_in_save.take();
        if cut.is_some() {
            self.count_fault(CUT_IN_SAVE);
        }
        cut
    }

    /// Whether the process that is about to start cannot be started; this is when it strikes.
    pub fn take_no_process(&mut self) -> bool {
        let none = std::mem::take(&mut self.no_process);
        if none {
            self.count_fault(NO_PROCESS);
        }
        none
    }

    pub fn struck(&self) -> u64 {
        self.faults.values().sum()
    }

    /// The world ends as it should.
    pub fn end(&mut self) {
        self.over = true;
    }

    // Processes

    /// Starts a task: a process of its own, or one more of its parent's. It takes its first turn after `delay`.
    pub fn spawn(
        &mut self,
        label: Label,
        parent: Option<TaskId>,
        incarnation: u32,
        program: Box<dyn Program>,
        delay: u64,
    ) -> TaskId {
        let id = self.next_task;
        self.next_task += 1;
        let process = match (label, parent) {
            (Label::Recorder, Some(parent)) => parent,
            _ => id,
        };
        let task = Task {
            label,
            process,
            parent,
            incarnation,
            program: Some(program),
            wake: 0,
            asleep: false,
            rung: false,
            stopped: None,
            said: 0,
        };
        self.tasks.insert(id, task);
        self.wake_at(id, self.now + delay);
        id
    }

    /// The living tasks with this label, the newest last.
    pub fn tasks(&self, is: impl Fn(Label) -> bool) -> Vec<TaskId> {
        self.tasks.iter().filter(|(_, task)| is(task.label)).map(|(id, _)| *id).collect()
    }

    pub fn lives(&self, id: TaskId) -> bool {
        self.tasks.contains_key(&id)
    }

    /// Wakes a task if it sleeps; if it is busy, its next sleep is none.
    pub fn ring(&mut self, id: TaskId) {
        let delay =
            if self.dice.once_in(64) { self.dice.spread(200, 20 * MILLISECOND) } else { self.dice.between(20, 200) };
        self.ring_in(id, delay);
    }

    /// The same of several.
    pub fn ring_all(&mut self, ids: impl IntoIterator<Item = TaskId>) {
        for id in ids {
            self.ring(id);
        }
    }

    /// The same after a delay.
    pub fn ring_in(&mut self, id: TaskId, delay: u64) {
        self.happen(self.now + delay, Happening::Ring(id));
    }

    /// A child tells its parent something; the pipe keeps the order.
    pub fn tell_parent(&mut self, id: TaskId, event: Event) {
        let delay = self.dice.spread(20, 4 * MILLISECOND);
        let Some(task) = self.tasks.get_mut(&id) else { return };
        let Some(parent) = task.parent else { return };
        task.said = task.said.max(self.now + delay);
        let at = task.said;
        self.happen(at, Happening::Hear(parent, event));
    }

    /// Somebody outside tells a task something.
    pub fn tell(&mut self, id: TaskId, event: Event) {
        self.happen(self.now + 100, Happening::Hear(id, event));
    }

    /// The next thing that a task was told.
    pub fn hear(&mut self, id: TaskId) -> Option<Event> {
        self.inboxes.get_mut(&id)?.pop_front()
    }

    /// Stops a process for this long.
    pub fn stop(&mut self, process: TaskId, micros: u64) {
        for task in self.tasks.values_mut().filter(|task| task.process == process) {
            task.stopped.get_or_insert(false);
        }
        self.happen(self.now + micros, Happening::Continue(process));
    }

    /// Ends a process, and what follows from that for others.
    pub fn finish(&mut self, process: TaskId, exit: &Exit) {
        let ids: Vec<TaskId> =
            self.tasks.iter().filter(|(_, task)| task.process == process).map(|(id, _)| *id).collect();
        for id in ids {
            let Some(task) = self.tasks.remove(&id) else { continue };
            let label = task.label;
            self.note(|| format!("{label:?} (task {id}) ended: {exit}"));
            self.inboxes.remove(&id);
            self.locks.retain(|_, holder| *holder != id);
            // The file locks by which a dead process is known are released a moment after it is reaped.
            let known = self.now + self.dice.spread(MILLISECOND, 500 * MILLISECOND);
            self.wires.iter_mut().for_each(|wire| wire.died(id, known));
            let noticed = (!self.dice.once_in(4)).then(|| self.now + self.dice.spread(MILLISECOND, 2 * SECOND));
            let mourners: Vec<TaskId> =
                self.meetings.values_mut().flat_map(|meeting| meeting.died(id, noticed)).collect();
            for mourner in mourners {
                self.ring_in(mourner, noticed.map_or(0, |at| at - self.now));
            }
            if let (Label::Child(process), Some(parent)) = (label, task.parent) {
                let at = task.said.max(self.now) + self.dice.spread(50, 20 * MILLISECOND);
                let Task { incarnation, .. } = task;
                let event = Event::Exited { process, incarnation, exit: exit.clone(), last_words: vec![] };
                self.happen(at, Happening::Hear(parent, event));
            }
            if label == Label::Orchestrator {
                task.parent.into_iter().for_each(|user| self.ring(user));
                let children: Vec<TaskId> =
                    self.tasks.iter().filter(|(_, child)| child.parent == Some(id)).map(|(id, _)| *id).collect();
                for child in children {
                    self.let_go(child);
                }
            }
        }
    }

    /// Closes a child's lifeline.
    pub fn let_go(&mut self, id: TaskId) {
        let delay = self.dice.spread(20, 5 * MILLISECOND);
        self.happen(self.now + delay, Happening::LetGo(id));
    }

    /// All processes but the user's end at once, as the power does.
    pub fn end_everything(&mut self) {
        self.tasks.retain(|_, task| task.label == Label::User);
        self.locks.clear();
        self.inboxes.clear();
    }

    // The clock

    fn happen(&mut self, at: u64, what: Happening) {
        self.queued += 1;
        self.queue.insert((at, self.queued), what);
    }

    fn wake_at(&mut self, id: TaskId, at: u64) {
        let Some(task) = self.tasks.get_mut(&id) else { return };
        task.wake += 1;
        let wake = task.wake;
        self.happen(at, Happening::Wake(id, wake));
    }

    /// The next thing happens; false when the world is over.
    pub fn step(&mut self) -> bool {
        let Some(((at, _), what)) = self.queue.pop_first().filter(|_| !self.over) else { return false };
        self.now = at;
        match what {
            Happening::Wake(id, wake) => self.wake(id, wake),
            Happening::Ring(id) => {
                let Some(task) = self.tasks.get_mut(&id) else { return true };
                if std::mem::take(&mut task.asleep) {
                    self.wake_at(id, at);
                } else {
                    task.rung = true;
                }
            }
            Happening::Hear(id, event) => {
                if self.tasks.contains_key(&id) {
                    self.inboxes.entry(id).or_default().push_back(event);
                    self.ring_in(id, 10);
                }
            }
            Happening::Continue(process) => {
                let stopped = self.tasks.iter_mut().filter(|(_, task)| task.process == process);
                let late: Vec<TaskId> =
                    stopped.filter_map(|(id, task)| (task.stopped.take() == Some(true)).then_some(*id)).collect();
                for id in late {
                    self.wake_at(id, at);
                }
            }
            Happening::LetGo(id) => {
                let Some(task) = self.tasks.get_mut(&id) else { return true };
                if task.stopped.is_some() {
                    self.happen(at + 100 * MILLISECOND, Happening::LetGo(id));
                    return true;
                }
                let exit = task.program.as_mut().and_then(|program| program.let_go());
                match exit {
                    Some(exit) => self.finish(id, &exit),
                    None => self.ring_in(id, 10),
                }
            }
        }
        true
    }

    fn wake(&mut self, id: TaskId, wake: u64) {
        let Some(task) = self.tasks.get_mut(&id).filter(|task| task.wake == wake) else { return };
        if let Some(missed) = &mut task.stopped {
            *missed = true;
            return;
        }
        let Some(mut program) = task.program.take() else { return };
        (task.asleep, task.rung) = (false, false);
        self.turns += 1;
        let next = program.turn(self, id);
        let Some(task) = self.tasks.get_mut(&id) else { return };
        task.program = Some(program);
        match next {
            Next::After(micros) => self.wake_at(id, self.now + micros.max(1)),
            Next::Wait(micros) => {
                task.asleep = !task.rung;
                let rung = std::mem::take(&mut task.rung);
                self.wake_at(id, self.now + if rung { 10 } else { micros.max(1) });
            }
            Next::Exit(exit) => {
                let process = task.process;
                self.finish(process, &exit);
            }
        }
    }
}
