//! What goes wrong, and when: a plan of a few faults, each after a number of turns of the world.

use crate::dice::Dice;
use crate::kernel::{CUT_IN_SAVE, Label, MILLISECOND, NO_PROCESS, SECOND, TORN, World};
use crate::learner::tear_newest;
use crate::service::TaskId;
use orchestrator::{Event, Exit, Process};

/// A fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// SIGKILL, or another sudden end, of one of the actors.
    KillActor(u32),
    /// Of one of the learners.
    KillLearner(u32),
    /// Of the orchestrator.
    KillOrchestrator,
    /// An actor is stopped for this many microseconds.
    StopActor(u32, u64),
    /// A learner is.
    StopLearner(u32, u64),
    /// The orchestrator is, with its recorder.
    StopOrchestrator(u64),
    /// The recorder's thread alone gets no processor.
    Lag(u64),
    /// The user asks for an orderly stop.
    AskToStop,
    /// Ctrl-C.
    Interrupt,
    /// The disk is full until the user resumes the run, or frees it.
    FillDisk,
    /// There is room again.
    FreeDisk,
    /// The next checkpoint is interrupted at this operation: by SIGKILL, or with true by a power failure.
    CutSave(u32, bool),
    /// The power fails.
    LosePower,
    /// The newest of several checkpoints is torn.
    TearCheckpoint,
    /// The next process cannot be started.
    NoProcess,
}

impl Fault {
    /// What kind it is.
    pub fn kind(self) -> &'static str {
        match self {
            Self::KillActor(_) => "kill actor",
            Self::KillLearner(_) => "kill learner",
            Self::KillOrchestrator => "kill orchestrator",
            Self::StopActor(..) => "stop actor",
            Self::StopLearner(..) => "stop learner",
            Self::StopOrchestrator(_) => "stop orchestrator",
            Self::Lag(_) => "lag of the recorder",
            Self::AskToStop => "ask to stop",
            Self::Interrupt => "interrupt",
            Self::FillDisk => "full disk",
            Self::FreeDisk => "free disk",
            Self::CutSave(_, _) => CUT_IN_SAVE,
            Self::LosePower => "power failure",
            Self::TearCheckpoint => TORN,
            Self::NoProcess => NO_PROCESS,
        }
    }
}

/// Faults by the turn after which they strike.
pub type Plan = Vec<(u64, Fault)>;

/// The plan of a seed. Gaps between faults are short as often as they are long, so that they meet in every way.
pub fn plan(dice: &mut Dice) -> Plan {
    let mut at = u64::from(dice.below(900));
    let count = dice.below(7);
    let mut plan = vec![];
    for _ in 0..count {
        let fault = any(dice);
        plan.push((at, fault));
        at += dice.spread(1, 1 << 9);
        // There is room again only where there was none.
        if fault == Fault::FillDisk && dice.once_in(2) {
            plan.push((at, Fault::FreeDisk));
            at += dice.spread(1, 1 << 9);
        }
    }
    plan
}

fn any(dice: &mut Dice) -> Fault {
    let who = dice.below(16);
    match dice.below(33) {
        0..=6 => Fault::KillActor(who),
        7..=10 => Fault::KillLearner(who),
        11..=13 => Fault::KillOrchestrator,
        14..=15 => Fault::StopActor(who, dice.spread(MILLISECOND, 128 * SECOND)),
        16..=17 => Fault::StopLearner(who, dice.spread(MILLISECOND, 2048 * SECOND)),
        18..=20 => Fault::StopOrchestrator(dice.spread(MILLISECOND, 16 * SECOND)),
        21..=22 => Fault::Lag(dice.spread(MILLISECOND, 16 * SECOND)),
        23 => Fault::AskToStop,
        24 => Fault::Interrupt,
        25..=26 => Fault::FillDisk,
        27..=29 => Fault::CutSave(dice.below(24), dice.once_in(2)),
        30 => Fault::LosePower,
        31 => Fault::TearCheckpoint,
        _ => Fault::NoProcess,
    }
}

/// A fault of the plan is due. One that finds nobody to strike is none; one that waits for its moment (a cut in a
/// save, a process that cannot be started) counts when that comes.
pub fn strike(world: &mut World, fault: Fault) {
    world.note(|| format!("FAULT {fault:?}"));
    if carry_out(world, fault) {
        world.count_fault(fault.kind());
    }
}

/// True if it struck somebody or something already.
fn carry_out(world: &mut World, fault: Fault) -> bool {
    let actor = |label| matches!(label, Label::Child(Process::Actor(_)));
    let learner = |label| matches!(label, Label::Child(Process::Learner(_)));
    let orchestrator = |label| label == Label::Orchestrator;
    match fault {
        Fault::KillActor(who) => kill(world, who, actor),
        Fault::KillLearner(who) => kill(world, who, learner),
        Fault::KillOrchestrator => kill(world, 0, orchestrator),
        Fault::StopActor(who, micros) => stop(world, who, actor, micros),
        Fault::StopLearner(who, micros) => stop(world, who, learner, micros),
        Fault::StopOrchestrator(micros) => stop(world, 0, orchestrator, micros),
        Fault::Lag(micros) => {
            let until = world.now + micros;
            world.shared.iter_mut().for_each(|shared| shared.lags_until = until);
            !world.shared.is_empty()
        }
        Fault::AskToStop => tell_orchestrator(world, Event::Stop),
        Fault::Interrupt => tell_orchestrator(world, Event::Interrupt),
        Fault::FillDisk => world.disk.set_full(true),
        Fault::FreeDisk => world.disk.set_full(false),
        Fault::CutSave(operations, power) => {
            world.cut_in_save = Some((operations, power));
            false
        }
        Fault::LosePower => {
            world.power_fails = true;
            true
        }
        Fault::TearCheckpoint => tear_newest(world),
        Fault::NoProcess => {
            world.no_process = true;
            false
        }
    }
}

fn kill(world: &mut World, who: u32, is: impl Fn(Label) -> bool) -> bool {
    let task = pick(world, who, is);
    task.inspect(|task| world.finish(*task, &Exit::Signal(9))).is_some()
}

fn stop(world: &mut World, who: u32, is: impl Fn(Label) -> bool, micros: u64) -> bool {
    let task = pick(world, who, is);
    task.inspect(|task| world.stop(*task, micros)).is_some()
}

fn tell_orchestrator(world: &mut World, event: Event) -> bool {
    let task = pick(world, 0, |label| label == Label::Orchestrator);
    task.inspect(|task| world.tell(*task, event)).is_some()
}

/// One of the processes of a kind, if there is any.
fn pick(world: &World, who: u32, is: impl Fn(Label) -> bool) -> Option<TaskId> {
    let all = world.tasks(is);
    all.get(who as usize % all.len().max(1)).copied()
}

/// Ends everything and forgets what was not on the disk, if the power is to fail.
pub fn lose_power_if_due(world: &mut World) {
    if std::mem::take(&mut world.power_fails) {
        world.note(|| "the power fails".to_owned());
        world.end_everything();
        let mut dice = std::mem::replace(&mut world.dice, Dice::new(0));
        world.disk.lose_power(&mut dice);
        world.dice = dice;
        for user in world.tasks(|label| label == Label::User) {
            world.ring_in(user, 10 * SECOND);
        }
    }
}
