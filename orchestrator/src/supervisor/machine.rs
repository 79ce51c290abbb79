//! The supervisor: a state machine fed with events and a clock. Pure: it starts, signals and prints nothing itself.
//!
//! ```text
//! Running ──stop, Ctrl-C, a process given up, cannot write─────▶ Saving ──learner saved──▶ Leaving ──all gone──▶ Over
//!    └───────────────────── budget reached ──────────────────────────────────────────────▶ Leaving
//! ```
//!
//! Every state has a deadline: a learner must become ready, its actors must connect, rollouts must come, a stop must
//! be answered, a process told to leave must go. A learner that does not become ready, or whose actors do not connect,
//! fails the run at once: trying again would only take as long again. What exceeds any other deadline is killed, and a
//! kill is a death like any other. Deaths without progress are bounded ([`super::restart`]), progress is bounded by the
//! frame budget, so every schedule of events ends in [`Action::Finish`].
//!
//! Time is the duration since the orchestrator began.

use super::event::{Action, End, Event, Exit, LEARNER, Level, Outcome, Process, Saved};
use super::policy::Policy;
use super::restart::{RestartHistory, Verdict};
use super::stage::StageMachine;
use crate::log_line::error_in;
use proto::config::StageConfig;
use proto::control::{EXIT_NON_FINITE, LearnerEvent};
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Debug)]
struct Child {
    incarnation: u32,
    state: ChildState,
    history: RestartHistory,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ChildState {
    /// Not running; to be started at the given time, if any.
    Down { restart_at: Option<Duration> },
    /// Running.
    Up { since: Duration, killed: Option<Duration> },
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Phase {
    Running,
    /// STOP is announced; the learner saves.
    Saving {
        failure: Option<String>,
        until: Duration,
    },
    /// Whatever still runs has been told to go.
    Leaving {
        since: Duration,
    },
    Over,
}

/// What the present incarnation of the learner has said so far.
#[derive(Debug, Default)]
struct LearnerWord {
    ready: Option<Duration>,
    connected: bool,
    advanced: Duration,
    /// Episodes of an evaluation played.
    episodes: u64,
}

/// The supervisor of one run on one machine.
#[derive(Debug)]
pub struct Supervisor {
    policy: Policy,
    stages: StageMachine,
    children: BTreeMap<Process, Child>,
    phase: Phase,
    learner: LearnerWord,
    outcome: Option<Outcome>,
    frames_reached: u64,
    episodes_reached: u64,
    non_finite_deaths: u32,
    actions: Vec<Action>,
}

impl Supervisor {
    /// A supervisor that has not started anything. An evaluation has no stages, and a budget of no frames to train on.
    pub fn new(policy: Policy, stages: Vec<StageConfig>) -> Self {
        let child = || Child {
            incarnation: 0,
            state: ChildState::Down { restart_at: None },
            history: RestartHistory::default(),
        };
        let processes = std::iter::once(LEARNER).chain((0..policy.actors).map(Process::Actor));
        Self {
            policy,
            stages: StageMachine::new(stages),
            children: processes.map(|process| (process, child())).collect(),
            phase: Phase::Running,
            learner: LearnerWord::default(),
            outcome: None,
            frames_reached: 0,
            episodes_reached: 0,
            non_finite_deaths: 0,
            actions: Vec::new(),
        }
    }

    /// Starts everything.
    pub fn start(&mut self, now: Duration) -> Vec<Action> {
        for process in self.children.keys().copied().collect::<Vec<_>>() {
            self.spawn(process, now);
        }
        std::mem::take(&mut self.actions)
    }

    /// Takes one event in and says what is to be done. `now` never goes back.
    pub fn on_event(&mut self, now: Duration, event: Event) -> Vec<Action> {
        match event {
            Event::Exited { process, incarnation, exit, last_words } => {
                self.exited(now, process, incarnation, &exit, &last_words);
            }
            Event::Learner { incarnation, event } => {
                let child = &self.children[&LEARNER];
                if child.incarnation == incarnation && matches!(child.state, ChildState::Up { .. }) {
                    self.learner_spoke(now, event);
                }
            }
            Event::Tick => self.tick(now),
            Event::Stop => self.stop(now),
            Event::Interrupt => self.interrupt(now),
            Event::CannotWrite(cause) => {
                if self.phase == Phase::Running {
                    self.fail(now, format!("what the run does cannot be written down any more: {cause}"));
                }
            }
        }
        std::mem::take(&mut self.actions)
    }

    /// True once [`Action::Finish`] was given.
    #[cfg(test)]
    pub fn is_over(&self) -> bool {
        self.phase == Phase::Over
    }

    /// True from the moment on when a stop or an end is being carried out.
    #[cfg(test)]
    pub fn is_stopping(&self) -> bool {
        self.phase != Phase::Running
    }

    // Processes

    fn spawn(&mut self, process: Process, now: Duration) {
        let child = self.children.get_mut(&process).expect("all processes are in the map from the start");
        assert!(matches!(child.state, ChildState::Down { .. }), "{process} is never started twice");
        child.incarnation += 1;
        child.state = ChildState::Up { since: now, killed: None };
        if process == LEARNER {
            self.learner = LearnerWord { advanced: now, ..LearnerWord::default() };
        }
        self.actions.push(Action::Spawn { process, incarnation: child.incarnation });
    }

    fn kill(&mut self, now: Duration, process: Process) {
        let child = self.children.get_mut(&process).expect("all processes are in the map from the start");
        if let ChildState::Up { killed, .. } = &mut child.state
            && killed.is_none()
        {
            *killed = Some(now);
            self.actions.push(Action::Kill(process));
        }
    }

    fn exited(&mut self, now: Duration, process: Process, incarnation: u32, exit: &Exit, last_words: &[String]) {
        let Some(child) = self.children.get_mut(&process) else { return };
        if child.incarnation != incarnation || !matches!(child.state, ChildState::Up { .. }) {
            return;
        }
        child.state = ChildState::Down { restart_at: None };
        match &self.phase {
            Phase::Running => self.died(now, process, exit, last_words),
            Phase::Saving { failure, .. } if process == LEARNER => {
                let died =
                    format!("learner-0 died while it saved ({exit}); the last checkpoint stands{}", quote(last_words));
                let reason = failure.as_ref().map_or_else(|| died.clone(), |failure| format!("{failure}\n{died}"));
                self.report(Level::Error, died);
                self.leave(now, End::Failed(reason), None);
            }
            Phase::Saving { .. } => {
                self.report(Level::Warning, format!("{} died: {exit}", process.describe(self.policy.kitchens)));
            }
            Phase::Leaving { .. } => self.finish_if_alone(),
            Phase::Over => {}
        }
    }

    /// A process died that should be running.
    fn died(&mut self, now: Duration, process: Process, exit: &Exit, last_words: &[String]) {
        let who = process.describe(self.policy.kitchens);
        if process == LEARNER {
            // A learner that says no by itself at its first start has a reason that another try does not remove: a
            // checkpoint it cannot read, a device that is not there.
            let refused = self.children[&LEARNER].incarnation == 1
                && self.learner.ready.is_none()
                && matches!(exit, Exit::Code(_) | Exit::NotStarted(_));
            if refused {
                return self.fail(now, format!("{who} could not begin: {exit}{}", quote(last_words)));
            }
            if *exit == Exit::Code(EXIT_NON_FINITE) {
                self.non_finite_deaths += 1;
                if self.non_finite_deaths > 1 {
                    return self.fail(
                        now,
                        format!("{who} met non-finite numbers twice after the same checkpoint{}", quote(last_words)),
                    );
                }
            }
        }
        let child = self.children.get_mut(&process).expect("all processes are in the map from the start");
        match child.history.died(now, &self.policy.restart) {
            Verdict::RestartAt(at) => {
                child.state = ChildState::Down { restart_at: Some(at) };
                let next = child.incarnation + 1;
                let rewinds = match process {
                    Process::Learner(_) if self.stages.budget() == 0 => "; it begins again",
                    Process::Learner(_) => "; it goes on from the last checkpoint",
                    Process::Actor(_) => "",
                };
                self.report(Level::Warning, format!("{who} died: {exit}; start number {next} follows{rewinds}"));
                self.start_due(now);
            }
            Verdict::GiveUp { deaths } => self.fail(
                now,
                format!(
                    "{who} died {deaths} times while the run got no further, last with {exit}{}",
                    quote(last_words)
                ),
            ),
        }
    }

    fn start_due(&mut self, now: Duration) {
        let due = |child: &Child| matches!(child.state, ChildState::Down { restart_at: Some(at) } if at <= now);
        let due: Vec<Process> =
            self.children.iter().filter(|(_, child)| due(child)).map(|(process, _)| *process).collect();
        for process in due {
            self.spawn(process, now);
        }
    }

    // The learner

    fn learner_spoke(&mut self, now: Duration, event: LearnerEvent) {
        match event {
            LearnerEvent::Ready { rollout, frames, device, parameters, checkpoint, .. } => {
                self.learner.ready = Some(now);
                self.learner.advanced = now;
                let origin = checkpoint.map_or_else(String::new, |path| format!(" from {path},"));
                self.report(
                    Level::Info,
                    format!("learner-0 ready on {device}, {parameters} parameters,{origin} {frames} frames trained"),
                );
                match self.phase {
                    Phase::Running => self.allow(rollout, frames),
                    Phase::Saving { .. } => self.announce_stop(),
                    Phase::Leaving { .. } | Phase::Over => {}
                }
            }
            LearnerEvent::ActorsConnected { .. } => {
                self.learner.connected = true;
                self.report(Level::Info, format!("all {} actors connected", self.policy.actors));
            }
            LearnerEvent::RolloutCollected { rollout, frames, .. } => {
                self.learner.connected = true;
                self.learner.advanced = now;
                if self.phase == Phase::Running {
                    self.allow(rollout + 1, frames);
                }
            }
            LearnerEvent::RolloutTrained { frames, .. } => {
                self.learner.advanced = now;
                if frames > self.frames_reached {
                    self.frames_reached = frames;
                    self.non_finite_deaths = 0;
                    for child in self.children.values_mut() {
                        child.history.progress();
                    }
                }
            }
            LearnerEvent::EpisodePlayed { .. } => {
                self.learner.advanced = now;
                self.learner.episodes += 1;
                // One that was started again plays the first ones again: that is no progress.
                if self.learner.episodes > self.episodes_reached {
                    self.episodes_reached = self.learner.episodes;
                    for child in self.children.values_mut() {
                        child.history.progress();
                    }
                }
            }
            LearnerEvent::CheckpointWritten { .. } => {}
            LearnerEvent::WaitingForActor { actor, waited_s, .. } => self.waits_for(now, actor, waited_s),
            LearnerEvent::Finished { frames, weights, complete, .. } => {
                self.finished(now, Saved { frames, weights }, complete);
            }
        }
    }

    fn allow(&mut self, rollout: u64, frames: u64) {
        // At the budget there is nothing to allow: the learner finishes by itself.
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
        let Some(child) = self.children.get(&process) else { return };
        let ChildState::Up { since, killed: None } = child.state else { return };
        let waited = Duration::try_from_secs_f64(waited_s).unwrap_or_default();
        if self.phase == Phase::Running
            && waited >= self.policy.actor_silence
            && now.saturating_sub(since) >= self.policy.actor_silence
        {
            self.report(
                Level::Warning,
                format!(
                    "{} has not answered for {waited_s:.0} s and is killed",
                    process.describe(self.policy.kitchens)
                ),
            );
            self.kill(now, process);
        }
    }

    fn finished(&mut self, now: Duration, saved: Saved, complete: bool) {
        let budget = self.stages.budget();
        let end = match &self.phase {
            Phase::Saving { failure: Some(failure), .. } => End::Failed(failure.clone()),
            Phase::Leaving { .. } | Phase::Over => {
                // It was told to go and saved on its way.
                if let Some(outcome) = &mut self.outcome {
                    outcome.saved = Some(saved);
                }
                return;
            }
            _ if complete && saved.frames != budget => {
                let reason =
                    format!("learner-0 calls the run complete at {} frames, but its budget is {budget}", saved.frames);
                self.report(Level::Error, reason.clone());
                End::Failed(reason)
            }
            _ if complete => End::Complete,
            _ => End::Stopped,
        };
        self.leave(now, end, Some(saved));
    }

    // Deadlines

    fn tick(&mut self, now: Duration) {
        match self.phase.clone() {
            Phase::Running => {
                self.check_learner(now);
                self.check_killed(now);
                // Not when one of them has just ended the run.
                if self.phase == Phase::Running {
                    self.start_due(now);
                }
            }
            Phase::Saving { failure, until } => {
                if now >= until {
                    let late = format!("learner-0 has not saved within {} s", self.policy.silence.as_secs());
                    let reason = failure.map_or_else(|| late.clone(), |failure| format!("{failure}\n{late}"));
                    self.report(Level::Error, late);
                    self.leave(now, End::Failed(reason), None);
                }
            }
            Phase::Leaving { since } => self.check_leaving(now, since),
            Phase::Over => {}
        }
    }

    fn check_learner(&mut self, now: Duration) {
        let ChildState::Up { since, killed: None } = self.children[&LEARNER].state else { return };
        match self.learner.ready {
            None if now.saturating_sub(since) > self.policy.learner_ready => self.fail(
                now,
                format!(
                    "learner-0 was not ready after {} s; its log says what it was doing",
                    self.policy.learner_ready.as_secs()
                ),
            ),
            Some(ready) if !self.learner.connected && now.saturating_sub(ready) > self.policy.actors_connected => self
                .fail(
                    now,
                    format!(
                        "not all actors had answered the learner {} s after it was ready; their logs say what they were doing",
                        self.policy.actors_connected.as_secs()
                    ),
                ),
            Some(_) if now.saturating_sub(self.learner.advanced) > self.policy.silence => {
                self.report(
                    Level::Warning,
                    format!(
                        "learner-0 finished neither a rollout nor an update for {} s and is killed",
                        self.policy.silence.as_secs()
                    ),
                );
                self.kill(now, LEARNER);
            }
            _ => {}
        }
    }

    /// SIGKILL is answered at once, unless the kernel itself is stuck (a dead network file system, a lost GPU).
    fn check_killed(&mut self, now: Duration) {
        let stuck = |child: &Child| match child.state {
            ChildState::Up { killed: Some(killed), .. } => now.saturating_sub(killed) > self.policy.killed,
            _ => false,
        };
        if self.phase == Phase::Running
            && let Some(process) = self.children.iter().find(|(_, child)| stuck(child)).map(|(process, _)| *process)
        {
            self.fail(
                now,
                format!("SIGKILL does not end {}: the kernel holds on", process.describe(self.policy.kitchens)),
            );
        }
    }

    fn check_leaving(&mut self, now: Duration, since: Duration) {
        let waited = now.saturating_sub(since);
        let mut stuck = vec![];
        for process in self.children.keys().copied().collect::<Vec<_>>() {
            let ChildState::Up { killed, .. } = self.children[&process].state else { continue };
            let patience = match process {
                Process::Learner(_) => self.policy.learner_leaves,
                Process::Actor(_) => self.policy.actor_leaves,
            };
            match killed {
                None if waited > patience => {
                    self.report(Level::Warning, format!("{process} does not leave and is killed"));
                    self.kill(now, process);
                }
                Some(killed) if now.saturating_sub(killed) > self.policy.killed => stuck.push(process.to_string()),
                _ => {}
            }
        }
        let up = self.children.values().filter(|child| matches!(child.state, ChildState::Up { .. })).count();
        if up > 0 && stuck.len() == up {
            self.report(Level::Error, format!("SIGKILL does not end {}: the kernel holds on", stuck.join(", ")));
            self.finish();
        }
    }

    // The end

    fn stop(&mut self, now: Duration) {
        if self.phase == Phase::Running {
            self.save(now, None);
        }
    }

    fn interrupt(&mut self, now: Duration) {
        match self.phase {
            Phase::Running => {
                self.save(now, None);
                if matches!(self.phase, Phase::Saving { .. }) {
                    self.report(
                        Level::Info,
                        "stopping: the learner saves; Ctrl-C again ends everything at once".into(),
                    );
                }
            }
            Phase::Over => {}
            // After an orderly stop that someone else asked for, too: whoever presses Ctrl-C then is in a hurry.
            Phase::Saving { .. } | Phase::Leaving { .. } => {
                if let Phase::Saving { failure, .. } = &self.phase {
                    let end = failure.clone().map_or(End::Interrupted, End::Failed);
                    self.outcome = Some(Outcome { end, saved: None });
                    self.phase = Phase::Leaving { since: now };
                }
                for process in self.children.keys().copied().collect::<Vec<_>>() {
                    self.kill(now, process);
                }
                self.finish_if_alone();
            }
        }
    }

    fn fail(&mut self, now: Duration, reason: String) {
        self.report(Level::Error, reason.clone());
        self.save(now, Some(reason));
    }

    /// Has the learner save, if it can.
    fn save(&mut self, now: Duration, failure: Option<String>) {
        let up = matches!(self.children[&LEARNER].state, ChildState::Up { killed: None, .. });
        if up && (self.learner.ready.is_some() || failure.is_none()) {
            self.phase = Phase::Saving { failure, until: now + self.policy.silence };
            self.announce_stop();
        } else {
            self.leave(now, failure.map_or(End::Stopped, End::Failed), None);
        }
    }

    fn leave(&mut self, now: Duration, end: End, saved: Option<Saved>) {
        self.phase = Phase::Leaving { since: now };
        self.outcome = Some(Outcome { end, saved });
        for (process, child) in &mut self.children {
            match child.state {
                ChildState::Up { .. } => self.actions.push(Action::CloseLifeline(*process)),
                ChildState::Down { .. } => child.state = ChildState::Down { restart_at: None },
            }
        }
        self.finish_if_alone();
    }

    fn finish_if_alone(&mut self) {
        if self.children.values().all(|child| matches!(child.state, ChildState::Down { .. })) {
            self.finish();
        }
    }

    fn finish(&mut self) {
        self.phase = Phase::Over;
        let outcome = self.outcome.take().expect("leaving begins with an outcome");
        self.actions.push(Action::Finish(outcome));
    }

    fn report(&mut self, level: Level, text: String) {
        self.actions.push(Action::Report(level, text));
    }
}

/// A process's last lines, indented below the sentence that tells of its death. Where it said what its error was, that
/// and what followed.
fn quote(last_words: &[String]) -> String {
    if last_words.is_empty() {
        return String::new();
    }
    let error = last_words.iter().rposition(|line| error_in(line).is_some()).unwrap_or(0);
    format!("; its last words:\n    {}", last_words[error..].join("\n    "))
}

#[cfg(test)]
mod tests;
