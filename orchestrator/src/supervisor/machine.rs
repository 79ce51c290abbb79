//! The supervisor: a state machine fed with events and a clock. Pure: it starts, signals and prints nothing itself.
//!
//! ```text
//! Running ──stop, Ctrl-C, a process given up, cannot write─────▶ Saving ──learner saved──▶ Leaving ──all gone──▶ Over
//!    └───────────────────── budget reached ──────────────────────────────────────────────▶ Leaving
//! ```
//! Where a run is saved only to go on with another number of actors, a death leads from Saving back to Running.
//!
//! Learners run, save and die together ([`super::learner_group`]), and rank 0 reports for all. If one dies, the others
//! are killed, because they can neither continue nor save.
//!
//! Every state has a deadline: learners must become ready, their actors must connect, rollouts must come, a stop must
//! be acknowledged, and a process that was asked to exit must exit. Learners whose actors do not connect fail the run at
//! once, and those that do not become ready at their second start: trying again would only take as long again. An
//! actor that dies twice of the same error of the user's environment fails the run. What exceeds any other deadline is
//! killed, and a kill is a death like any other. Deaths without progress are bounded ([`super::restart`]), progress is
//! bounded by the frame budget, so every schedule of events ends in [`Action::Finish`].
//!
//! Time is the duration since the orchestrator began.

use super::children::Children;
use super::deadlines::Deadlines;
use super::event::{Action, Event, Exit, Level, Outcome, Process, Saved, SessionEnd};
use super::learner_group::{Bereaved, LearnerGroup};
use super::messages::{
    actor_died, also, connected, died_at_stop, environment_error, environment_fails, given_up, immortal, killed_for_it,
    killed_unready, learners_given_up, needs_more_time, quote, ready, recorder_stands_still, rewinds, unanswering,
};
use super::overdue::{self, Overdue};
use super::pace::Work;
use super::restart::{RestartHistory, Verdict};
use super::stage_machine::StageMachine;
use proto::config::StageConfig;
use proto::event::LearnerEvent;
use proto::exit::{EXIT_LOST_PEERS, EXIT_UNSAVED};
use std::time::Duration;

const LOST_PEERS: Exit = Exit::Code(EXIT_LOST_PEERS);
const SIGKILL: Exit = Exit::Signal(9);
const RECORDER_WARNING_S: f64 = 5.0;

#[derive(Debug, Clone, PartialEq, Eq)]
enum Phase {
    Running,
    Saving {
        failure: Option<String>,
        since: Duration,
        patience: Duration,
        /// Only the number of actors changes. Until this has worked, whoever dies is started again as in [`Phase::Running`].
        goes_on: bool,
    },
    Leaving {
        since: Duration,
    },
    Over,
}

pub struct Supervisor {
    deadlines: Deadlines,
    stages: StageMachine,
    stops_before: Option<u64>,
    children: Children,
    learner_group: LearnerGroup,
    actor_histories: Vec<RestartHistory>,
    phase: Phase,
    outcome: Option<Outcome>,
    frames_reached: u64,
    /// Episodes of an evaluation that the present incarnation of its learner has played, and the most that any has.
    episodes: u64,
    episodes_reached: u64,
    /// By rank: for how long its recorder stood still when that was last said, and when it was warned of.
    held_up_s: Vec<[f64; 2]>,
    actions: Vec<Action>,
}

impl Supervisor {
    /// A supervisor that has not started anything. An evaluation has no stages, and a budget of no frames to train on.
    pub fn new(deadlines: Deadlines, stages: Vec<StageConfig>) -> Self {
        Self {
            deadlines,
            stages: StageMachine::new(stages),
            stops_before: None,
            children: Children::new(deadlines.learners, deadlines.actors),
            learner_group: LearnerGroup::new(deadlines.learners),
            actor_histories: vec![RestartHistory::default(); deadlines.actors as usize],
            phase: Phase::Running,
            outcome: None,
            frames_reached: 0,
            episodes: 0,
            episodes_reached: 0,
            held_up_s: vec![[0.0; 2]; deadlines.learners as usize],
            actions: Vec::new(),
        }
    }

    pub fn start(&mut self, now: Duration) -> Vec<Action> {
        self.start_learners(now);
        for actor in 0..self.deadlines.actors {
            self.spawn(Process::Actor(actor), now);
        }
        std::mem::take(&mut self.actions)
    }

    /// Processes one event and returns the actions. `now` never decreases.
    pub fn on_event(&mut self, now: Duration, event: Event) -> Vec<Action> {
        match event {
            Event::Exited { process, incarnation, exit, last_words } => {
                self.exited(now, process, incarnation, &exit, &last_words);
            }
            Event::Learner { incarnation, event } => {
                if self.children.runs(Process::Learner(event.rank()), incarnation) {
                    self.learner_spoke(now, event);
                }
            }
            Event::Tick => self.tick(now),
            Event::Stop => self.stop(now),
            Event::Scale { before } => self.stop_before(before),
            Event::Interrupt => self.interrupt(now),
            Event::CannotWrite(cause) => {
                if self.phase == Phase::Running || self.is_to_go_on() {
                    self.fail(now, format!("what the run does cannot be written down any more: {cause}"));
                }
            }
            Event::HostLost { processes, reason } => self.host_lost(now, &processes, reason),
        }
        std::mem::take(&mut self.actions)
    }

    /// The first rollout that has not been announced, and so can have another number of actors. None while a stop or an
    /// end is carried out; a save that fails and is made once more leads back from there.
    pub(super) fn open_rollout(&self) -> Option<u64> {
        (self.phase == Phase::Running).then(|| self.stages.next_rollout())
    }

    /// Whether there is nothing to train and nothing to save.
    fn evaluates(&self) -> bool {
        self.stages.budget() == 0
    }

    // Processes

    fn spawn(&mut self, process: Process, now: Duration) {
        let incarnation = self.children.start(process, now);
        self.actions.push(Action::Spawn { process, incarnation });
    }

    fn kill(&mut self, now: Duration, process: Process) {
        if self.children.kill(process, now) {
            self.actions.push(Action::Kill(process));
        }
    }

    fn start_learners(&mut self, now: Duration) {
        self.learner_group.begin(now);
        self.episodes = 0;
        for rank in self.learner_group.ranks() {
            self.spawn(Process::Learner(rank), now);
        }
    }

    fn kill_learners(&mut self, now: Duration) {
        for rank in self.learner_group.ranks() {
            self.kill(now, Process::Learner(rank));
        }
    }

    /// Kills the remaining learners when one is missing: they can neither save nor continue.
    fn kill_broken(&mut self, now: Duration) {
        if !self.learners_are_whole() {
            self.kill_learners(now);
        }
    }

    /// Whether the learners can still go on, or save: each is there, or has left in good order.
    fn learners_are_whole(&self) -> bool {
        let lives = |rank| self.children.alive_since(Process::Learner(rank)).is_some();
        self.learner_group.ranks().all(|rank| lives(rank) || self.learner_group.has_finished(rank))
    }

    fn learners_are_down(&self) -> bool {
        self.learner_group.ranks().all(|rank| self.children.is_down(Process::Learner(rank)))
    }

    fn exited(&mut self, now: Duration, process: Process, incarnation: u32, exit: &Exit, last_words: &[String]) {
        let was_killed = self.children.is_killed(process) && *exit == SIGKILL;
        if !self.children.end(process, incarnation) {
            return;
        }
        let exit = if was_killed { &Exit::Killed } else { exit };
        if self.is_to_go_on()
            && let Process::Learner(rank) = process
            && !self.learner_group.has_finished(rank)
        {
            self.run_on(now);
        }
        match &self.phase {
            Phase::Running => {
                match process {
                    // It has exited: rank 0's event decides the outcome.
                    Process::Learner(rank) if self.learner_group.has_finished(rank) => {}
                    Process::Learner(rank) => self.learner_died(now, rank, exit, last_words),
                    Process::Actor(actor) => self.actor_died(now, actor, exit, last_words),
                }
                // Not when that has just ended the run.
                if self.phase == Phase::Running {
                    self.start_due(now);
                }
            }
            Phase::Saving { failure, .. } => match process {
                Process::Learner(rank) if self.learner_group.has_finished(rank) => {}
                Process::Learner(_) => {
                    let died = died_at_stop(process, self.evaluates(), exit, last_words);
                    let reason = also(failure.as_deref(), &died);
                    self.report(Level::Error, died);
                    self.leave(now, SessionEnd::Failed(reason), None);
                }
                Process::Actor(_) => {
                    self.report(Level::Warning, format!("{} died: {exit}", process.describe(self.deadlines.kitchens)));
                }
            },
            Phase::Leaving { .. } => {
                if !self.learner_group.has_finished(0) {
                    self.kill_broken(now);
                }
                self.finish_if_alone();
            }
            Phase::Over => {}
        }
    }

    /// A learner died that should be running, or would be if another had not died.
    fn learner_died(&mut self, now: Duration, rank: u32, exit: &Exit, last_words: &[String]) {
        let who = Process::Learner(rank);
        // A learner that exits with an error at its first start has a cause that a retry does not remove, such as an
        // unreadable checkpoint or a missing device.
        let follows = self.learner_group.is_falling();
        if !follows && *exit == LOST_PEERS {
            self.learner_group.bereaved(now, rank, last_words);
            if !self.learners_are_down() {
                return;
            }
            // No other process is left that could be the cause.
            return self.fall_bereaved(now, Duration::ZERO);
        }
        let refused = !follows
            && self.children.incarnation(who) == 1
            && !self.learner_group.is_ready(rank)
            && matches!(exit, Exit::Code(_) | Exit::NotStarted(_));
        if refused {
            return self.fail(now, format!("{who} could not begin: {exit}{}", quote(last_words)));
        }
        if *exit == Exit::Code(EXIT_UNSAVED) {
            return self.fail(now, format!("{who} could not save{}", quote(last_words)));
        }
        if self.learner_group.met_non_finite_again(exit) {
            let met = format!("{who} met non-finite numbers twice after the same checkpoint{}", quote(last_words));
            return self.fail(now, met);
        }
        if !follows {
            self.fall(now, rank, exit, last_words);
        }
    }

    /// A learner ended because it lost another, and no cause is known: report its own end as the cause.
    fn fall_bereaved(&mut self, now: Duration, patience: Duration) {
        if !self.learner_group.is_falling()
            && let Some(Bereaved { rank, last_words, .. }) = self.learner_group.take_bereaved(now, patience)
        {
            self.fall(now, rank, &LOST_PEERS, &last_words);
        }
    }

    fn fall(&mut self, now: Duration, rank: u32, exit: &Exit, last_words: &[String]) {
        let who = Process::Learner(rank);
        let learners = self.learner_group.size();
        match self.learner_group.fell(now, &self.deadlines.restart) {
            Verdict::RestartAt(_) => {
                let next = self.children.incarnation(who) + 1;
                let rewinds = rewinds(learners, self.evaluates());
                self.report(Level::Warning, format!("{who} died: {exit}; start number {next} follows; {rewinds}"));
                self.kill_learners(now);
            }
            Verdict::GiveUp { deaths } => {
                let (all, last) = learners_given_up(learners, who);
                self.fail(now, given_up(&all, &last, deaths, exit, last_words));
            }
        }
    }

    fn actor_died(&mut self, now: Duration, actor: u32, exit: &Exit, last_words: &[String]) {
        let process = Process::Actor(actor);
        let who = process.describe(self.deadlines.kitchens);
        let history = &mut self.actor_histories[actor as usize];
        let error = environment_error(exit, last_words);
        if history.failed_again(error)
            && let Some(error) = error
        {
            return self.fail(now, environment_fails(&who, error));
        }
        match history.died(now, &self.deadlines.restart) {
            Verdict::RestartAt(at) => {
                self.children.restart(process, at);
                let next = self.children.incarnation(process) + 1;
                self.report(Level::Warning, actor_died(&who, exit, last_words, next));
            }
            Verdict::GiveUp { deaths } => {
                let slow = *exit == Exit::Killed;
                let advice = if slow { needs_more_time(self.deadlines.actor_silence) } else { String::new() };
                self.fail(now, given_up(&who, "", deaths, exit, last_words) + &advice);
            }
        }
    }

    fn start_due(&mut self, now: Duration) {
        // All start together or none: a learner without the others would wait for them.
        if self.learner_group.is_due(now) && self.learners_are_down() {
            self.start_learners(now);
        }
        for process in self.children.due(now) {
            self.spawn(process, now);
        }
    }

    fn progress(&mut self) {
        self.learner_group.progress();
        for history in &mut self.actor_histories {
            history.progress();
        }
    }

    // The learners

    fn learner_spoke(&mut self, now: Duration, event: LearnerEvent) {
        match event {
            // Whoever falls with another comes to nothing.
            LearnerEvent::Ready { .. } if self.learner_group.is_falling() => {}
            LearnerEvent::Ready { rank, rollout, frames, device, parameters, checkpoint } => {
                self.learner_group.ready(rank, now);
                self.report(Level::Info, ready(rank, &device, parameters, checkpoint, frames));
                match self.phase {
                    Phase::Running if rank == 0 => self.begin(now, rollout, frames),
                    Phase::Saving { .. } => self.announce_stop(),
                    Phase::Running | Phase::Leaving { .. } | Phase::Over => {}
                }
            }
            LearnerEvent::ActorsConnected { rank } => {
                if self.learner_group.connected(rank) {
                    self.report(Level::Info, connected(self.deadlines.actors));
                }
            }
            LearnerEvent::RolloutCollected { rollout, frames, .. } => {
                self.learner_group.collected(now);
                if self.phase == Phase::Running && !self.ends_before(rollout + 1) {
                    self.allow(rollout + 1, frames);
                } else if self.ends_before(rollout + 1) && self.deadlines.overlap {
                    // Its update is reported only when the learners know what comes next.
                    self.end_shape(now);
                }
            }
            LearnerEvent::RolloutTrained { rollout, frames, .. } => {
                self.learner_group.goes_on(now, Work::Collect);
                if frames > self.frames_reached {
                    self.frames_reached = frames;
                    self.progress();
                }
                if self.ends_before(rollout + 1) {
                    self.end_shape(now);
                }
            }
            LearnerEvent::EpisodePlayed { .. } => {
                self.learner_group.goes_on(now, Work::Play);
                self.episodes += 1;
                // One that was started again plays the first ones again: that is no progress.
                if self.episodes > self.episodes_reached {
                    self.episodes_reached = self.episodes;
                    self.progress();
                }
            }
            LearnerEvent::CheckpointBegun { .. } => {
                self.learner_group.goes_on(now, Work::Save);
                self.save_begins(now);
            }
            LearnerEvent::CheckpointWritten { .. } => self.learner_group.goes_on(now, Work::Collect),
            LearnerEvent::WaitingForActor { actor, waited_s, .. } => {
                self.learner_group.waits(now);
                self.waits_for(now, actor, waited_s);
            }
            LearnerEvent::WaitingForRecorder { rank, waited_s } => {
                self.learner_group.waits_for_recorder(now);
                self.waits_for_recorder(rank, waited_s);
            }
            LearnerEvent::Finished { rank, frames, weights, complete } => {
                self.learner_group.finished(rank);
                if rank == 0 {
                    self.finished(now, Saved { frames, weights }, complete);
                }
            }
        }
    }

    fn allow(&mut self, rollout: u64, frames: u64) {
        // At the budget there is nothing to allow: the learners finish by themselves.
        if let Some(word) = self.stages.allow(rollout, frames) {
            if let Some(switch) = word.switch {
                self.actions.push(Action::SwitchStage(switch));
            }
            self.actions.push(Action::Announce(word.announcement));
        }
    }

    fn announce_stop(&mut self) {
        let announcement = self.stages.stop();
        self.actions.push(Action::Announce(announcement));
    }

    fn waits_for(&mut self, now: Duration, actor: u32, waited_s: f64) {
        let process = Process::Actor(actor);
        let Some(since) = self.children.alive_since(process) else { return };
        let waited = Duration::try_from_secs_f64(waited_s).unwrap_or_default().min(now.saturating_sub(since));
        let patience = self.deadlines.actor_patience(&self.learner_group.pace);
        if self.phase != Phase::Running || waited < patience / 3 {
            return;
        }
        let who = process.describe(self.deadlines.kitchens);
        self.report(Level::Warning, unanswering(&who, waited, (waited < patience).then_some(patience)));
        if waited >= patience {
            self.kill(now, process);
        }
    }

    /// Warns of a recorder that stands still, again whenever that has doubled. No process is killed for it: whoever came
    /// next would wait for it, too.
    fn waits_for_recorder(&mut self, rank: u32, waited_s: f64) {
        let [last_s, warned_s] = &mut self.held_up_s[rank as usize];
        if waited_s < *last_s {
            // Another time.
            *warned_s = 0.0;
        }
        *last_s = waited_s;
        if waited_s >= RECORDER_WARNING_S.max(2.0 * *warned_s) {
            *warned_s = waited_s;
            self.report(Level::Warning, recorder_stands_still(rank, waited_s));
        }
    }

    fn finished(&mut self, now: Duration, saved: Saved, complete: bool) {
        let budget = self.stages.budget();
        let end = match &self.phase {
            Phase::Saving { failure: Some(failure), .. } => SessionEnd::Failed(failure.clone()),
            Phase::Leaving { .. } | Phase::Over => {
                // It saved after it had been asked to exit.
                if let Some(outcome) = &mut self.outcome {
                    outcome.saved = Some(saved);
                }
                return;
            }
            _ if complete && saved.frames != budget => {
                let reason =
                    format!("learner-0 calls the run complete at {} frames, but its budget is {budget}", saved.frames);
                self.report(Level::Error, reason.clone());
                SessionEnd::Failed(reason)
            }
            _ if complete => SessionEnd::Complete,
            _ => SessionEnd::Stopped,
        };
        self.leave(now, end, Some(saved));
    }

    // Deadlines

    fn tick(&mut self, now: Duration) {
        match self.phase.clone() {
            Phase::Running => {
                self.fall_bereaved(now, self.deadlines.killed);
                self.check_learners(now);
                self.check_killed(now);
                // Not when one of them has just ended the run.
                if self.phase == Phase::Running {
                    self.start_due(now);
                }
            }
            Phase::Saving { failure, since, patience, goes_on: _ } => {
                self.check_saving(now, failure.as_deref(), now.saturating_sub(since), patience);
            }
            Phase::Leaving { since } => self.check_leaving(now, since),
            Phase::Over => {}
        }
    }

    fn check_learners(&mut self, now: Duration) {
        if !self.learners_are_whole() {
            return;
        }
        match overdue::of_learners(&self.learner_group, &self.deadlines, now) {
            Some(Overdue::Fails(reason)) => self.fail(now, reason),
            Some(Overdue::Kills(warning)) => {
                self.report(Level::Warning, warning);
                self.kill_learners(now);
            }
            Some(Overdue::Unready(late)) => self.unready(now, late),
            Some(Overdue::Warns(warning, silent)) => self.warn(warning, silent),
            None => {}
        }
    }

    /// A learner is not ready in time. One that hung at its start comes up at the next.
    fn unready(&mut self, now: Duration, late: String) {
        if self.learner_group.started_late_again() {
            return self.fail(now, late);
        }
        self.report(Level::Warning, killed_unready(self.learner_group.size(), &late));
        self.kill_learners(now);
    }

    fn warn(&mut self, warning: String, silent: Duration) {
        self.report(Level::Warning, warning);
        self.learner_group.warned(silent);
    }

    fn check_saving(&mut self, now: Duration, failure: Option<&str>, waited: Duration, patience: Duration) {
        let done = if self.evaluates() { "stopped" } else { "saved" };
        match overdue::of_stop(&self.learner_group, &self.deadlines, (waited, patience), done) {
            Some(Overdue::Warns(warning, silent)) => self.warn(warning, silent),
            Some(Overdue::Fails(late)) if self.is_to_go_on() => {
                self.report(Level::Warning, killed_for_it(self.learner_group.size(), &late));
                self.run_on(now);
                self.kill_learners(now);
            }
            Some(Overdue::Fails(late)) => {
                let reason = also(failure, &late);
                self.report(Level::Error, late);
                self.leave(now, SessionEnd::Failed(reason), None);
                self.kill_learners(now);
            }
            _ => {}
        }
    }

    /// SIGKILL is answered at once, unless the kernel itself is stuck (a dead network file system, a lost GPU).
    fn check_killed(&mut self, now: Duration) {
        let killed_long_ago =
            |killed: Option<Duration>| killed.is_some_and(|killed| now.saturating_sub(killed) > self.deadlines.killed);
        if self.phase == Phase::Running
            && let Some((process, _)) = self.children.up().into_iter().find(|(_, killed)| killed_long_ago(*killed))
        {
            self.fail(now, immortal(&process.describe(self.deadlines.kitchens)));
        }
    }

    fn check_leaving(&mut self, now: Duration, since: Duration) {
        let waited = now.saturating_sub(since);
        let mut stuck = vec![];
        for (process, killed) in self.children.up() {
            let patience = match process {
                Process::Learner(_) => self.deadlines.learner_leaves,
                Process::Actor(_) => self.deadlines.actor_leaves,
            };
            match killed {
                None if waited > patience => {
                    self.report(Level::Warning, format!("{process} does not leave and is killed"));
                    self.kill(now, process);
                }
                Some(killed) if now.saturating_sub(killed) > self.deadlines.killed => stuck.push(process.to_string()),
                _ => {}
            }
        }
        let up = self.children.up().len();
        if up > 0 && stuck.len() == up {
            self.report(Level::Error, immortal(&stuck.join(", ")));
            self.finish();
        }
    }

    fn report(&mut self, level: Level, text: String) {
        self.actions.push(Action::Report(level, text));
    }
}

mod ending;
#[cfg(test)]
mod tests;
