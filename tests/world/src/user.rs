//! Who starts the run, resumes it until it is complete, and then looks at what it left behind.

use crate::kernel::{Label, MILLISECOND, Next, Program, SECOND, Shared, World};
use crate::model::StepName;
use crate::recorder::recorded;
use crate::service::TaskId;
use crate::session::Session;
use crate::setup::Mutation;
use orchestrator::{Outcome, Process, SessionEnd};
use std::collections::BTreeMap;

/// Longest that a run may take after the last fault: a learner that hangs is noticed after a quarter of an hour.
const PATIENCE: u64 = 3600 * SECOND;

/// Faults without which no process can be given up: it may die five times in a minute.
const MANY: u64 = 5;

#[derive(Debug, Default)]
pub struct User {
    session: Option<TaskId>,
    looked_at: usize,
    /// When the session began, and how many faults had struck by then.
    began: u64,
    struck: u64,
}

impl Program for User {
    fn turn(&mut self, world: &mut World, me: TaskId) -> Next {
        if world.now > world.last_fault + PATIENCE {
            world.violate("the run does not come to its end".to_owned());
        }
        if self.session.is_some_and(|session| world.lives(session)) {
            return Next::Wait(60 * SECOND);
        }
        if let Some((session, outcome)) = world.outcomes.get(self.looked_at).cloned() {
            self.looked_at += 1;
            world.note(|| format!("user: session {session} ended: {outcome:?}"));
            confirmed(world, session, &outcome);
            if outcome.end == SessionEnd::Complete {
                look(world, &outcome);
                world.end();
                return Next::Wait(SECOND);
            }
            self.judge(world, &outcome);
        }
        // `resume` waits for the locks of learners that outlived their orchestrator.
        if !world.tasks(|label| matches!(label, Label::Child(Process::Learner(_)))).is_empty() {
            return Next::After(250 * MILLISECOND);
        }
        if self.session.is_some() && world.dice.once_in(2) {
            self.session = None;
            return Next::After(world.dice.spread(10 * MILLISECOND, 5 * SECOND));
        }
        world.note(|| "user: starts the run".to_owned());
        // Nothing that a command of the user does can be written while the disk is full.
        world.disk.set_full(false);
        (self.began, self.struck) = (world.now, world.struck());
        let session = Session::new(world);
        self.session = Some(world.spawn(Label::Orchestrator, Some(me), 1, Box::new(session), MILLISECOND));
        Next::Wait(60 * SECOND)
    }
}

/// What a session has saved is recorded, as the recorder counts it; a stop can leave a rollout aside that it has
/// confirmed.
fn confirmed(world: &mut World, session: usize, outcome: &Outcome) {
    let Shared { confirmed, failure, .. } = &world.shared[session];
    if let (Some(saved), None) = (&outcome.saved, failure)
        && *confirmed < Some(saved.frames)
        && !world.setup.has(Mutation::IgnoresReceipts)
    {
        let text = format!("saved are {} frames, but only of {confirmed:?} was every step recorded", saved.frames);
        world.violate(text);
    }
}

impl User {
    /// A session fails only for a reason.
    fn judge(&self, world: &mut World, outcome: &Outcome) {
        let Some(reason) = outcome.end.reason() else { return };
        let struck = world.struck() - self.struck;
        if world.last_fault < self.began {
            world.violate(format!("a session without a fault failed: {reason}"));
        } else if struck < MANY && reason.contains("times while the run got no further") {
            world.violate(format!("{struck} faults were too many for a session: {reason}"));
        }
    }
}

/// Looks at a complete run.
fn look(world: &mut World, outcome: &Outcome) {
    let weights = format!("{:064x}", world.model.last_weights());
    match &outcome.saved {
        Some(saved) if saved.frames != world.model.frames => {
            let (frames, budget) = (saved.frames, world.model.frames);
            return world.violate(format!("the run ended with {frames} frames of {budget}"));
        }
        Some(saved) if saved.weights != weights => {
            return world.violate(format!("the weights are {}, not {weights}", saved.weights));
        }
        None => return world.violate("a complete run has saved nothing".to_owned()),
        Some(_) => {}
    }
    let mut found: BTreeMap<StepName, u64> = BTreeMap::new();
    for (name, hash) in recorded(&world.disk) {
        if world.model.steps.get(&name) != Some(&hash) {
            return world.violate(format!("recorded is a step that the run does not have: {name:?}"));
        }
        found.insert(name, hash);
    }
    let missing: Vec<StepName> = world.model.steps.keys().filter(|name| !found.contains_key(name)).copied().collect();
    if let Some(first) = missing.first() {
        let (count, all) = (missing.len(), world.model.steps.len());
        let (column, episode, step) = first;
        world.violate(format!(
            "{count} of {all} steps are not in the recording, first column {column}, episode {episode}, step {step}"
        ));
    }
}
