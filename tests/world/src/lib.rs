//! A simulated world: the real state machines of all processes together in one process, on a virtual clock, with a
//! simulated wire, process table and file system, and a seed that decides what goes wrong when.
//!
//! What is real: the supervisor's machine with its stages, deadlines and restarts, the learner's collector,
//! announcements, patience and checkpoint store, the actor's protocol, the recorder's ledger. What is simulated are the
//! thin shells around them, turn by turn as they are written, and what these shells stand on: [`service`] is iceoryx2,
//! [`disk`] a file system that forgets, [`meeting`] the learners' collective operations, [`kernel`] the clock and the
//! process table. [`model`] computes the same run without any of this.
//!
//! [`play`] plays a seed. Whatever it does to the run, the run must come to its end with the weights of the undisturbed
//! one, on its exact budget, having trained on every frame once, and with every step in its recordings.

mod actor;
mod dice;
mod disk;
mod environment;
mod faults;
mod kernel;
mod learner;
mod meeting;
mod model;
mod recorder;
mod service;
mod session;
mod setup;
mod user;
mod wire;

pub use setup::Mutation;

use dice::Dice;
use faults::Plan;
use kernel::{Label, World};
use model::Model;
use setup::Setup;
use std::collections::BTreeMap;
use user::User;

/// Turns that a world may take at most.
const MOST_TURNS: u64 = 3_000_000;

/// What came of a seed.
#[derive(Debug)]
pub struct Report {
    /// The first thing that was wrong; none if all was well.
    pub violation: Option<String>,
    pub faults: BTreeMap<&'static str, u64>,
    /// Starts of the orchestrator.
    pub sessions: usize,
    /// Sessions that ended in failure.
    pub failures: usize,
    /// Turns taken by all processes.
    pub turns: u64,
    /// Virtual seconds.
    pub seconds: f64,
    /// Everything that happened, if it was asked for.
    pub trace: Vec<String>,
}

/// Plays a seed, with something wrong on purpose or without.
pub fn play(seed: u64, mutation: Option<Mutation>, traced: bool) -> Report {
    let mut dice = Dice::new(seed);
    let setup = Setup { mutation, ..Setup::of(&mut dice, seed) };
    let plan = faults::plan(&mut dice);
    run(setup, &plan, dice, traced)
}

fn run(setup: Setup, plan: &Plan, dice: Dice, traced: bool) -> Report {
    let model = Model::of(&setup);
    let mut world = World::new(setup, model, dice, traced);
    let [files, names] = [Mutation::ForgetsFiles, Mutation::ForgetsNames].map(|mutation| world.setup.has(mutation));
    world.disk.forget(files, names);
    let setup = world.setup.config.clone();
    world.note(|| {
        let (learners, actors) = (setup.learner.count, setup.actors.count);
        let each = setup.actors.environments_per_actor;
        format!("{learners} learners, {actors} actors of {each} environments; faults {plan:?}")
    });
    world.spawn(Label::User, None, 1, Box::new(User::default()), 1);
    let mut struck = 0;
    while world.step() {
        while let Some(&(_, fault)) = plan.get(struck).filter(|(at, _)| *at <= world.turns) {
            struck += 1;
            faults::strike(&mut world, fault);
        }
        faults::lose_power_if_due(&mut world);
        if world.turns > MOST_TURNS {
            world.violate(format!("the world takes more than {MOST_TURNS} turns"));
        }
    }
    Report {
        violation: world.violation,
        faults: world.faults,
        sessions: world.wires.len(),
        failures: world.outcomes.iter().filter(|(_, outcome)| outcome.end.reason().is_some()).count(),
        turns: world.turns,
        seconds: world.now as f64 / kernel::SECOND as f64,
        trace: world.trace.unwrap_or_default(),
    }
}
