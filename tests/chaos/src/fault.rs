//! What can happen to a run, and which of it happens in which case.

use crate::draw::Draw;
use crate::points::{CREATION, EVALUATION, Point, SUITE, TRAINING, VALIDATION};
use crate::privileges::Privileges;
use crate::run_kind::{Kind, RUN_KINDS, RunKind};
use std::fmt::{Display, Formatter};

/// As many open files as every shape has room with.
pub const ENOUGH_DESCRIPTORS: u64 = 4096;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Who {
    /// The one that was started: of a run, an evaluation or a suite.
    Orchestrator,
    Learner(u32),
    Actor(u32),
    /// The orchestrator of a validation beside the run, or of a suite's run or evaluation.
    Child,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Damage {
    /// A bit of the tensors is another.
    FlippedBit,
    /// The tensors end early.
    ShortTensors,
    NoTensors,
    /// The manifest ends early.
    ShortManifest,
    /// The manifest is of zeros, as some file systems leave it after a power cut.
    ZeroManifest,
}

/// How a file of lines is damaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Journal {
    /// The beginning of a line at its end.
    Torn,
    /// Bytes that are no text in the middle of a line.
    Garbled,
    /// It is gone.
    Missing,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// SIGKILL.
    Kill(Who),
    /// SIGKILL to two at once.
    KillTwo(Who, Who),
    /// SIGKILL to all processes at once.
    KillAll,
    /// SIGKILL, and again to the one that takes its place, this many milliseconds after it was seen.
    KillAgain(Who, u64),
    /// SIGKILL to an actor; the orchestrator is held for so many milliseconds when another has taken its place.
    KillAndHold(u32, u64),
    /// SIGSTOP, and SIGCONT so many milliseconds later.
    Pause(Who, u64),
    /// SIGTERM.
    Terminate(Who),
    /// SIGINT to the orchestrator.
    Interrupt,
    /// Dies at this point, when it passes it for the n-th time.
    Point(Point, u64),
    /// The disk is full for so many milliseconds.
    FullDisk(u64),
    /// /dev/shm is full for so many milliseconds.
    FullMemory(u64),
    /// The power fails: everything dies at once, and what was not synced is gone.
    LosePower,
    /// The newest checkpoint is damaged while nothing runs.
    Checkpoint(Damage),
    /// metrics.jsonl is damaged while nothing runs.
    Metrics(Journal),
    /// A start that may open only so many files.
    FewDescriptors(u64),
}

/// What became of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fate {
    Landed,
    /// Its time never came, or the process was not there.
    Missed,
    /// This machine does not let us.
    Skipped,
}

/// When a fault happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// While the command runs.
    Running,
    /// With the next start.
    Start,
    /// After the command's death, before the next start.
    Between,
}

/// A fault with its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Planned {
    /// The run must have trained so many rollouts.
    pub rollout: u64,
    /// So long after that, or after the start if they had been trained before it.
    pub delay_ms: u64,
    pub fault: Fault,
}

/// One run with what happens to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Case {
    /// Its number under the seed.
    pub number: u32,
    pub shape: RunKind,
    /// By what, in order.
    pub faults: Vec<Planned>,
}

impl Fault {
    /// When it happens.
    pub fn phase(self) -> Phase {
        match self {
            Self::Point(..) | Self::FewDescriptors(_) => Phase::Start,
            Self::Checkpoint(_) | Self::Metrics(_) => Phase::Between,
            _ => Phase::Running,
        }
    }

    /// This fault, if it can be the reason of an end: of two deaths one after the other the first may have come alone.
    pub fn in_force(self, fate: Fate) -> Option<Self> {
        let is_half = fate == Fate::Missed && matches!(self, Self::KillAgain(..) | Self::KillAndHold(..));
        (fate == Fate::Landed || is_half).then_some(self)
    }

    /// Whether it can be carried out here.
    pub fn is_allowed(self, privileges: Privileges) -> bool {
        match self {
            Self::FullDisk(_) | Self::FullMemory(_) => privileges.mounts,
            Self::LosePower => privileges.disks,
            _ => true,
        }
    }

    /// What it is counted as.
    pub fn class(self) -> &'static str {
        match self {
            Self::Kill(Who::Orchestrator) => "SIGKILL, orchestrator",
            Self::Kill(Who::Learner(_)) => "SIGKILL, learner",
            Self::Kill(Who::Actor(_)) => "SIGKILL, actor",
            Self::Kill(Who::Child) => "SIGKILL, child orchestrator",
            Self::KillTwo(..) => "SIGKILL, two at once",
            Self::KillAll => "SIGKILL, all at once",
            Self::KillAgain(..) => "SIGKILL during recovery",
            Self::KillAndHold(..) => "SIGKILL, recovery held",
            Self::Pause(..) => "SIGSTOP and SIGCONT",
            Self::Terminate(_) => "SIGTERM",
            Self::Interrupt => "SIGINT",
            Self::Point(point, _) => match point.program {
                "actor" => "fault point, actor",
                "learner" => "fault point, learner",
                _ => "fault point, orchestrator",
            },
            Self::FullDisk(_) => "full disk",
            Self::FullMemory(_) => "full /dev/shm",
            Self::LosePower => "power failure",
            Self::Checkpoint(_) => "damaged checkpoint",
            Self::Metrics(_) => "damaged metrics.jsonl",
            Self::FewDescriptors(_) => "few descriptors",
        }
    }
}

fn anyone(shape: &RunKind, draw: &mut Draw) -> Who {
    let learner = Who::Learner(draw.within(0..=u64::from(shape.learners) - 1) as u32);
    let actor = Who::Actor(draw.within(0..=u64::from(shape.actors) - 1) as u32);
    let child = if shape.validates || shape.kind == Kind::Suite { 2 } else { 0 };
    draw.weighed(&[(2, Who::Orchestrator), (2, learner), (3, actor), (child, Who::Child)])
}

fn other_than(one: Who, shape: &RunKind, draw: &mut Draw) -> Who {
    loop {
        let other = anyone(shape, draw);
        if other != one {
            return other;
        }
    }
}

fn fault(shape: &RunKind, is_first: bool, draw: &mut Draw) -> Fault {
    let training = shape.kind == Kind::Training;
    let who = anyone(shape, draw);
    let two = Fault::KillTwo(who, other_than(who, shape, draw));
    let child = match who {
        Who::Orchestrator | Who::Child => Who::Learner(0),
        child => child,
    };
    let again = Fault::KillAgain(child, draw.within(0..=400));
    let hold = Fault::KillAndHold(draw.within(0..=u64::from(shape.actors) - 1) as u32, draw.within(800..=1500));
    let pause = Fault::Pause(who, draw.within(20..=1200));
    let points: &[&[Point]] = match shape.kind {
        Kind::Evaluation => &[EVALUATION],
        Kind::Suite => &[SUITE],
        Kind::Training if is_first => &[TRAINING, CREATION],
        Kind::Training if shape.validates => &[TRAINING, VALIDATION, VALIDATION],
        Kind::Training => &[TRAINING],
    };
    let (point, pass) = Point::draw(points, draw);
    let damages =
        [Damage::FlippedBit, Damage::ShortTensors, Damage::NoTensors, Damage::ShortManifest, Damage::ZeroManifest];
    let damage = draw.of(&damages);
    let journal = draw.of(&[Journal::Torn, Journal::Torn, Journal::Garbled, Journal::Missing]);
    let few = draw.of(&[24, 48, 96, ENOUGH_DESCRIPTORS]);
    let full = draw.within(100..=1500);
    // What needs a run folder that goes on, or a folder or memory of its own.
    let if_training = |weight| if training { weight } else { 0 };
    draw.weighed(&[
        (6, Fault::Kill(who)),
        (2, two),
        (1, Fault::KillAll),
        (3, again),
        (2, hold),
        (3, pause),
        (2, Fault::Terminate(who)),
        (1, Fault::Interrupt),
        (10, Fault::Point(point, pass)),
        (if_training(1), Fault::FullDisk(full)),
        (if_training(1), Fault::FullMemory(full)),
        (if_training(2), Fault::LosePower),
        (if_training(2), Fault::Checkpoint(damage)),
        (if_training(1), Fault::Metrics(journal)),
        (1, Fault::FewDescriptors(few)),
    ])
}

impl Case {
    /// The case of this number under this seed.
    pub fn draw(seed: u64, number: u32) -> Self {
        let mut draw = Draw::new(seed, number);
        let shape = draw.weighed(RUN_KINDS);
        let count = draw.within(2..=5);
        // The end is left alone: what comes after it does not happen.
        let latest = shape.rollouts().saturating_sub(3);
        let mut rollouts: Vec<u64> = (0..count).map(|_| draw.within(0..=latest)).collect();
        rollouts.sort_unstable();
        let planned = |(index, rollout): (usize, u64)| {
            let fault = fault(&shape, index == 0, &mut draw);
            let longest = if shape.kind == Kind::Training { 250 } else { 2500 };
            let delay_ms = draw.within(0..=longest);
            // A start that has not come yet cannot be waited for.
            let rollout = if index == 0 && fault.phase() == Phase::Start { 0 } else { rollout };
            Planned { rollout, delay_ms, fault }
        };
        let faults = rollouts.into_iter().enumerate().map(planned).collect();
        Self { number, shape, faults }
    }
}

impl Display for Who {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Orchestrator => write!(f, "orchestrator"),
            Self::Learner(rank) => write!(f, "learner-{rank}"),
            Self::Actor(number) => write!(f, "actor-{number:02}"),
            Self::Child => write!(f, "child orchestrator"),
        }
    }
}

impl Display for Fault {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Kill(who) => write!(f, "kill {who}"),
            Self::KillTwo(one, other) => write!(f, "kill {one} and {other}"),
            Self::KillAll => write!(f, "kill all"),
            Self::KillAgain(who, ms) => write!(f, "kill {who}, and again {ms} ms after it is back"),
            Self::KillAndHold(actor, ms) => {
                write!(f, "kill actor-{actor:02}, hold the orchestrator {ms} ms when it is back")
            }
            Self::Pause(who, ms) => write!(f, "stop {who} for {ms} ms"),
            Self::Terminate(who) => write!(f, "SIGTERM to {who}"),
            Self::Interrupt => write!(f, "SIGINT"),
            Self::Point(point, pass) => write!(f, "{} dies at {}:{pass}", point.program, point.name),
            Self::FullDisk(ms) => write!(f, "disk full for {ms} ms"),
            Self::FullMemory(ms) => write!(f, "/dev/shm full for {ms} ms"),
            Self::LosePower => write!(f, "power failure"),
            Self::Checkpoint(damage) => write!(f, "newest checkpoint: {damage:?}"),
            Self::Metrics(journal) => write!(f, "metrics.jsonl: {journal:?}"),
            Self::FewDescriptors(limit) => write!(f, "start with at most {limit} files open"),
        }
    }
}

impl Display for Planned {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "at rollout {} + {} ms: {}", self.rollout, self.delay_ms, self.fault)
    }
}
