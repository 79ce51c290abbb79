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
//! kill is a death like any other. Deaths without progress are bounded ([`super::restart`]), progress is bounded by the frame budget, so every
//! schedule of events ends in [`Action::Finish`].
//!
//! Time is the duration since the orchestrator began.

use super::restart::{RestartHistory, RestartPolicy, Verdict};
use super::stage::{StageMachine, StageSwitch};
use proto::config::{Config, StageConfig};
use proto::control::{EXIT_NON_FINITE, LearnerEvent};
use proto::kitchen::Kitchens;
use proto::message::StageAnnouncement;
use std::collections::BTreeMap;
use std::fmt::{Display, Formatter};
use std::time::Duration;

/// A process of the run, in the order in which they are started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Process {
    /// A learner, by its rank in the process group. This machine's orchestrator runs rank 0.
    Learner(u32),
    /// An actor, by its number.
    Actor(u32),
}

/// The learner of this machine.
pub const LEARNER: Process = Process::Learner(0);

impl Display for Process {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Learner(rank) => write!(f, "learner-{rank}"),
            Self::Actor(actor) => write!(f, "actor-{actor:02}"),
        }
    }
}

impl Process {
    /// Its name and, of an actor, its kitchen in a run in these kitchens.
    pub fn describe(self, kitchens: Kitchens) -> String {
        match self {
            Self::Learner(_) => self.to_string(),
            Self::Actor(actor) => format!("{self} (kitchen {})", kitchens.of_actor(actor)),
        }
    }
}

/// How a process ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Exit {
    /// It exited with this status.
    Code(i32),
    /// A signal ended it.
    Signal(i32),
    /// It could not be started at all.
    NotStarted(String),
}

impl Display for Exit {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Code(code) => write!(f, "exit status {code}"),
            Self::Signal(signal) => match signal_name(*signal) {
                Some(name) => write!(f, "signal {signal} ({name})"),
                None => write!(f, "signal {signal}"),
            },
            Self::NotStarted(cause) => write!(f, "it could not be started: {cause}"),
        }
    }
}

fn signal_name(signal: i32) -> Option<&'static str> {
    Some(match signal {
        2 => "SIGINT",
        4 => "SIGILL: an instruction this processor does not have",
        6 => "SIGABRT",
        7 => "SIGBUS: shared memory or the disk behind a mapped file is full",
        8 => "SIGFPE",
        9 => "SIGKILL: killed, perhaps by the kernel for want of memory",
        11 => "SIGSEGV",
        15 => "SIGTERM",
        _ => return None,
    })
}

/// What happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A process ended and was reaped.
    Exited {
        /// Which.
        process: Process,
        /// The incarnation that ended.
        incarnation: u32,
        /// How.
        exit: Exit,
        /// Its last lines on standard error.
        last_words: Vec<String>,
    },
    /// A learner spoke.
    Learner {
        /// The incarnation that spoke.
        incarnation: u32,
        /// What it said.
        event: LearnerEvent,
    },
    /// Time passed.
    Tick,
    /// Someone asks for an orderly stop (`orchestrator stop`, SIGTERM, SIGHUP). Asking twice changes nothing.
    Stop,
    /// Ctrl-C: the first is an orderly stop, the second ends everything at once.
    Interrupt,
    /// The recording or the figures of the run cannot be written any more: a run that nobody can look into is ended.
    CannotWrite(String),
}

/// How loudly a report is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// As expected.
    Info,
    /// Something broke and is being mended.
    Warning,
    /// The run ends because of it.
    Error,
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Start a process.
    Spawn {
        /// Which.
        process: Process,
        /// How often it has been started, from 1.
        incarnation: u32,
    },
    /// Close its standard input: it leaves in good order.
    CloseLifeline(Process),
    /// SIGKILL.
    Kill(Process),
    /// Publish to the learners.
    Announce(StageAnnouncement),
    /// Note a change of stage.
    SwitchStage(StageSwitch),
    /// Tell the user.
    Report(Level, String),
    /// Nothing more will come.
    Finish(Outcome),
}

/// How a run (or this sitting of it) ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// Why.
    pub end: End,
    /// What the learner had saved when it left; none if it left without a word.
    pub saved: Option<Saved>,
}

/// Why a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// The budget is reached.
    Complete,
    /// Someone asked for it; the run can be resumed.
    Stopped,
    /// Someone asked twice; the run can be resumed from its last checkpoint.
    Interrupted,
    /// It cannot go on. The reason has been reported.
    Failed(String),
}

impl End {
    /// As `run.toml` and the user are told: `complete`, `stopped`, `interrupted` or `failed`.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Complete => "complete",
            Self::Stopped => "stopped",
            Self::Interrupted => "interrupted",
            Self::Failed(_) => FAILED,
        }
    }
}

/// The word for a run that cannot go on.
pub const FAILED: &str = "failed";

/// The state a learner left behind.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Saved {
    /// Frames trained on.
    pub frames: u64,
    /// SHA-256 of the weights, 64 hex digits.
    pub weights: String,
}

/// Every bound the supervisor keeps.
#[derive(Debug, Clone, Copy)]
pub struct Policy {
    /// Kitchens that the actors simulate.
    pub kitchens: Kitchens,
    /// Actor processes.
    pub actors: u32,
    /// On restarts.
    pub restart: RestartPolicy,
    /// From a learner's start to its `Ready`.
    pub learner_ready: Duration,
    /// From `Ready` until all actors have answered.
    pub actors_connected: Duration,
    /// The longest a learner may be without a finished rollout or update; also the longest that saving may take.
    pub silence: Duration,
    /// An actor that the learner has waited for this long, and that has run this long, is taken to hang.
    pub actor_silence: Duration,
    /// From a learner's `Finished` to its exit.
    pub learner_leaves: Duration,
    /// From an actor's closed lifeline to its exit.
    pub actor_leaves: Duration,
    /// From SIGKILL to the death: longer only when the kernel itself is stuck.
    pub killed: Duration,
}

impl Policy {
    /// The bounds for a configuration.
    pub fn of(config: &Config) -> Self {
        let rollout_frames = config.environments() as f64 * f64::from(config.ppo.rollout_steps);
        // Ten frames a second and pass is a tenth of what one old core does with the larger network.
        let slowest_update_s = rollout_frames * f64::from(config.ppo.epochs) / 10.0;
        let actor_deadline = Duration::from_secs_f64(config.learner.actor_deadline_s.min(1e6));
        Self {
            kitchens: config.kitchens(),
            actors: config.actors.count,
            restart: RestartPolicy::default(),
            learner_ready: Duration::from_mins(2),
            actors_connected: actor_deadline + Duration::from_secs(30),
            silence: Duration::from_secs_f64(slowest_update_s.max(600.0)) + actor_deadline,
            actor_silence: actor_deadline / 2,
            learner_leaves: Duration::from_secs(30),
            actor_leaves: Duration::from_secs(2),
            killed: Duration::from_secs(10),
        }
    }
}

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
                        format!(
                            "{who} met non-finite numbers twice after the same checkpoint; the batch is dumped in the run folder{}",
                            quote(last_words)
                        ),
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
                let origin = checkpoint.map_or_else(|| "from the seed".to_owned(), |path| format!("from {path}"));
                self.report(
                    Level::Info,
                    format!("learner-0 ready on {device}, {parameters} parameters, {origin}, {frames} frames trained"),
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
    let error = last_words.iter().rposition(|line| line.contains(" ERROR ")).unwrap_or(0);
    format!("; its last words:\n    {}", last_words[error..].join("\n    "))
}

#[cfg(test)]
mod tests;
