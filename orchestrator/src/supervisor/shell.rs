//! The loop around the machine: processes, signals and shared memory on one side, events and actions on the other.
//!
//! Everything happens on one thread, because ports of shared memory stay on the thread that made them; children are
//! listened to by small tasks on the same thread, which send events. A turn of the loop takes milliseconds, the
//! longest part being the sweep after a death.

use super::clock::Clock;
use super::deadlines::Deadlines;
use super::event::{Action, Event, Exit, Level, Outcome, Process, SessionEnd};
use super::machine::Supervisor;
use super::process::{Launch, Processes};
use super::remote_hosts::{FromHost, HostReport, Order, RemoteHosts};
use super::stage_machine::StageSwitch;
use crate::output::events::tell;
use crate::output::format;
use crate::run::scale::ScaleRequest;
use anyhow::{Context, Result};
use proto::config::Config;
use proto::event::LearnerEvent;
use proto::run_folder::RunFolder;
use recording::recorder::Recorder;
use serde_json::json;
use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use tokio::time::{Interval, MissedTickBehavior};
use wire::{Announcer, WireHost, fault};

/// Interval of checking deadlines, of repeating the announcement for late subscribers, and of showing progress.
pub const TICK: Duration = Duration::from_millis(250);
/// A dead process's ports are swept at its death and on this many ticks after it: the file locks by which it is known
/// to be dead are released a moment after it is reaped.
pub const SWEEPS_AFTER_DEATH: u32 = 4;
const STANDSTILL: Duration = Duration::from_secs(5);
/// Events that may wait. A child that is not listened to blocks; the orchestrator never does.
pub const QUEUE: usize = 1024;

pub struct Signals {
    interrupt: Signal,
    terminate: Signal,
    user: Signal,
    hang_up: Option<Signal>,
    launched: bool,
    requeue: bool,
    asked: Option<Event>,
}

impl Signals {
    /// From now on signals are events. To be called inside the runtime, before there is anything to clean up. `launched`:
    /// a scheduler or launcher started this program and may start it again, so its SIGTERM asks for that, too.
    fn install(launched: bool) -> Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt()).context("SIGINT")?,
            terminate: signal(SignalKind::terminate()).context("SIGTERM")?,
            user: signal(SignalKind::user_defined1()).context("SIGUSR1")?,
            launched,
            requeue: false,
            asked: None,
            hang_up: hang_up_signal()?,
        })
    }

    pub fn kept(kept: &mut Option<Self>, launched: bool) -> Result<&mut Self> {
        Ok(match kept {
            Some(kept) => kept,
            None => kept.insert(Self::install(launched)?),
        })
    }

    pub async fn next(&mut self) -> Event {
        let (event, requeue) = tokio::select! {
            _ = self.interrupt.recv() => (Event::Interrupt, false),
            _ = self.terminate.recv() => (Event::Stop, self.launched),
            _ = self.user.recv() => (Event::Stop, true),
            () = next(&mut self.hang_up) => (Event::Stop, false),
        };
        self.requeue |= requeue;
        self.asked = Some(event.clone());
        event
    }

    /// The last one that came. Whoever has handed it on while one session ended does not know whether it was received.
    pub fn asked(&self) -> Option<Event> {
        self.asked.clone()
    }

    /// Whether one of them, SIGUSR1 or a launcher's SIGTERM, says that the run is started again later.
    pub fn ask_for_requeue(&self) -> bool {
        self.requeue
    }
}

/// Of a closed terminal; none under nohup, where that is no reason to stop.
pub fn hang_up_signal() -> Result<Option<Signal>> {
    let ignored = signal_is_ignored(SignalKind::hangup().as_raw_value());
    (!ignored).then(|| signal(SignalKind::hangup()).context("SIGHUP")).transpose()
}

/// The next one of a signal; of none it never comes.
pub async fn next(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => drop(signal.recv().await),
        None => std::future::pending().await,
    }
}

fn signal_is_ignored(number: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap_or_default();
    u64::from_str_radix(mask.trim(), 16).is_ok_and(|mask| mask >> (number - 1) & 1 == 1)
}

/// Receives rank 0's events, and every learner's wait for an actor: stores them and shows progress.
pub trait Audience {
    /// Handles a learner's event. An error ends the run, because its results can no longer be written.
    fn learner(&mut self, now: Duration, event: &LearnerEvent) -> Result<()>;
    fn learner_died(&mut self, now: Duration);
    fn tick(&mut self, now: Duration, recorder: Option<&Recorder>);
    /// Somebody has asked for the end.
    fn stop_asked(&mut self) {}
    /// Whether the audience still has work when all processes have finished; it gets ticks meanwhile. A stop request
    /// ends the wait: the run then counts as stopped, and `resume` does the missing work.
    fn is_busy(&self) -> bool {
        false
    }
    fn over(&mut self);
}

pub struct Shell<'a> {
    pub config: &'a Config,
    pub host: &'a WireHost,
    pub recorder: Option<&'a Recorder>,
    pub signals: &'a mut Signals,
    pub remote_hosts: Option<&'a mut RemoteHosts>,
    /// Where another number of actors may be asked for, and of which start.
    pub scaled: Option<(&'a RunFolder, u32)>,
}

impl Shell<'_> {
    pub async fn supervise(self, launch: Launch, audience: &mut impl Audience) -> Result<Outcome> {
        let stages = if self.config.evaluation.is_some() { Vec::new() } else { self.config.stages.clone() };
        let mut machine = Supervisor::new(Deadlines::of(self.config), stages);
        let announcer = self.host.wire().announcer()?;
        let (sender, inbox) = mpsc::channel(QUEUE);
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut supervision = Supervision {
            shell: self,
            audience,
            announcer,
            processes: Processes::new(launch, sender),
            inbox,
            begin: Instant::now(),
            clock: Clock::default(),
            tick,
            learner_incarnation: 0,
            sweeps: 0,
            own_events: VecDeque::new(),
            refusals: BTreeMap::new(),
            recording_failed: false,
            asked_to_stop: false,
            requeue: false,
            open_rollout: machine.open_rollout(),
            scales_to: None,
        };
        let mut actions = machine.start(Duration::ZERO);
        fault::reach("orchestrator.before_spawn");
        loop {
            for action in actions {
                if let Some(outcome) = supervision.carry_out(action).await? {
                    return Ok(outcome);
                }
            }
            let event = supervision.next_event().await;
            let now = supervision.now();
            supervision.take_note(now, &event);
            actions = machine.on_event(now, event);
            supervision.open_rollout = machine.open_rollout();
        }
    }
}

struct Supervision<'a, A> {
    shell: Shell<'a>,
    audience: &'a mut A,
    announcer: Announcer,
    processes: Processes,
    inbox: mpsc::Receiver<Event>,
    begin: Instant,
    clock: Clock,
    tick: Interval,
    learner_incarnation: u32,
    sweeps: u32,
    own_events: VecDeque<Event>,
    refusals: BTreeMap<u32, String>,
    recording_failed: bool,
    asked_to_stop: bool,
    requeue: bool,
    /// The first rollout that can have another number of actors; none while a stop or an end is carried out.
    open_rollout: Option<u64>,
    scales_to: Option<u32>,
}

impl<A: Audience> Supervision<'_, A> {
    /// Executes an action of the machine; returns the outcome when there is nothing more to do.
    async fn carry_out(&mut self, action: Action) -> Result<Option<Outcome>> {
        match action {
            Action::Spawn { process, incarnation } => {
                if matches!(process, Process::Learner(_)) {
                    self.learner_incarnation = incarnation;
                }
                tell("process_started", || json!({ "process": process.to_string(), "incarnation": incarnation }));
                if let Some(host) = self.elsewhere(process) {
                    self.order(host, Order::Spawn { process, incarnation });
                } else if let Err(cause) = self.processes.spawn(process, incarnation) {
                    let exit = Exit::NotStarted(cause);
                    self.own_events.push_back(Event::Exited { process, incarnation, exit, last_words: vec![] });
                }
                fault::reach("orchestrator.after_spawn");
            }
            Action::CloseLifeline(process) => match self.elsewhere(process) {
                Some(host) => self.order(host, Order::CloseLifeline(process)),
                None => self.processes.close_lifeline(process),
            },
            Action::Kill(process) => match self.elsewhere(process) {
                Some(host) => self.order(host, Order::Kill(process)),
                None => self.processes.kill(process),
            },
            Action::Announce(announcement) => {
                fault::reach("orchestrator.before_announce");
                if let Some(remote_hosts) = &self.shell.remote_hosts {
                    remote_hosts.order_all(&Order::Announce(announcement.into()));
                }
                self.announcer.announce(announcement)?;
                fault::reach("orchestrator.after_announce");
            }
            Action::SwitchStage(switch) => self.switch_stage(switch),
            Action::Report(Level::Info, text) => tracing::info!("{text}"),
            Action::Report(Level::Warning, text) => tracing::warn!("{text}"),
            Action::Report(Level::Error, text) => tracing::error!("{text}"),
            Action::Finish(mut outcome) => {
                if outcome.end == SessionEnd::Complete && !self.wait_for_audience().await {
                    outcome.end = SessionEnd::Stopped;
                }
                if outcome.end == SessionEnd::Stopped && (self.requeue || self.shell.signals.ask_for_requeue()) {
                    outcome.end = SessionEnd::Requeued;
                }
                if outcome.end == SessionEnd::Stopped
                    && !self.asked_to_stop
                    && let Some(actors) = self.scales_to
                {
                    outcome.end = SessionEnd::Scaled(actors);
                }
                self.audience.over();
                return Ok(Some(outcome));
            }
        }
        Ok(None)
    }

    fn now(&mut self) -> Duration {
        let (now, stood) = self.clock.at(self.begin.elapsed());
        if let Some(stood) = stood.filter(|stood| *stood > STANDSTILL) {
            tracing::warn!(
                "this orchestrator stood still for {} s (it was stopped, or got no processor); deadlines do not count that",
                stood.as_secs()
            );
        }
        now
    }

    async fn next_event(&mut self) -> Event {
        if let Some(event) = self.own_events.pop_front() {
            return event;
        }
        tokio::select! {
            event = self.shell.signals.next() => event,
            Some(event) = self.inbox.recv() => event,
            (host, received) = received(&mut self.shell.remote_hosts) => self.event_of(host, received),
            _ = self.tick.tick() => Event::Tick,
        }
    }

    fn elsewhere(&self, process: Process) -> Option<u32> {
        self.shell.remote_hosts.as_ref().map(|remote_hosts| remote_hosts.host_of(process)).filter(|&host| host > 0)
    }

    fn order(&self, host: u32, order: Order) {
        if let Some(remote_hosts) = &self.shell.remote_hosts {
            remote_hosts.order(host, order);
        }
    }

    fn event_of(&mut self, host: u32, received: FromHost) -> Event {
        let Some(remote_hosts) = &self.shell.remote_hosts else { return Event::Tick };
        match received {
            FromHost::Lost(reason) => Event::HostLost {
                processes: remote_hosts.processes_of(host),
                reason: match self.refusals.remove(&host) {
                    Some(why) => format!("{} cannot go on: {why}", remote_hosts.name(host)),
                    None => format!("{} was lost: {reason}", remote_hosts.name(host)),
                },
            },
            FromHost::Reported(word) => match word {
                HostReport::Exited { process, incarnation, exit, last_words } => {
                    Event::Exited { process, incarnation, exit, last_words }
                }
                HostReport::Learner { incarnation, event } => Event::Learner { incarnation, event },
                HostReport::CannotWrite(reason) => Event::CannotWrite(format!("{}: {reason}", remote_hosts.name(host))),
                HostReport::Stop { requeue } => {
                    self.requeue |= requeue;
                    Event::Stop
                }
                HostReport::Interrupt => Event::Interrupt,
                HostReport::Refused(why) => {
                    self.refusals.insert(host, why);
                    Event::Tick
                }
                HostReport::Ready | HostReport::AsksOtherwise(_) | HostReport::Recorded(_) => Event::Tick,
            },
        }
    }

    /// Does what an event requires outside the machine, which receives it next.
    fn take_note(&mut self, now: Duration, event: &Event) {
        let recorder = self.shell.recorder;
        match event {
            Event::Exited { process, incarnation, exit, .. } => {
                tell(
                    "process_ended",
                    || json!({ "process": process.to_string(), "incarnation": incarnation, "how": exit.to_string() }),
                );
                // When another learner dies, this one does not outlive it.
                if *process == Process::Learner(0) {
                    self.audience.learner_died(now);
                }
                if self.elsewhere(*process).is_none() {
                    self.processes.forget(*process);
                    // Before its place is taken, and before anyone blocks on what it held.
                    self.shell.host.sweep_dead();
                    self.sweeps = SWEEPS_AFTER_DEATH;
                }
            }
            Event::Learner { incarnation, event } if *incarnation == self.learner_incarnation => {
                if let Some(recorder) = recorder {
                    recorder.learner(*incarnation, event);
                }
                if is_for_audience(event)
                    && let Err(error) = self.audience.learner(now, event)
                {
                    self.own_events.push_back(Event::CannotWrite(format!("{error:#}")));
                }
            }
            Event::Tick => {
                if let Err(error) = self.announcer.update() {
                    tracing::debug!("{error}");
                }
                if self.sweeps > 0 {
                    self.sweeps -= 1;
                    self.shell.host.sweep_dead();
                }
                if !self.recording_failed
                    && let Some(failure) = recorder.and_then(Recorder::failure)
                {
                    self.recording_failed = true;
                    self.own_events.push_back(Event::CannotWrite(failure));
                }
                self.audience.tick(now, recorder);
                self.look_for_scale();
            }
            Event::Stop | Event::Interrupt => {
                self.asked_to_stop = true;
                self.audience.stop_asked();
            }
            Event::Learner { .. } | Event::CannotWrite(_) | Event::HostLost { .. } | Event::Scale { .. } => {}
        }
    }

    fn look_for_scale(&mut self) {
        let Some((folder, incarnation)) = self.shell.scaled else { return };
        let open = self.open_rollout;
        let Some(request) = ScaleRequest::take(folder, incarnation, self.shell.config, open) else { return };
        let ScaleRequest { actors, at_rollout, .. } = request;
        let Some(at) = at_rollout.or(open) else { return };
        let instead = self.scales_to.replace(actors).map_or(String::new(), |other| format!(", not with {other}"));
        tracing::info!(
            "asked for {actors} actors: the run is saved before rollout {at} and goes on with them{instead}"
        );
        self.own_events.push_back(Event::Scale { before: at_rollout });
    }

    /// Waits for the audience's remaining work; false if a stop is requested before it is done.
    async fn wait_for_audience(&mut self) -> bool {
        while self.audience.is_busy() && !self.asked_to_stop {
            tokio::select! {
                _ = self.shell.signals.next() => self.asked_to_stop = true,
                (host, received) = received(&mut self.shell.remote_hosts) => match self.event_of(host, received) {
                    Event::Stop | Event::Interrupt => self.asked_to_stop = true,
                    Event::HostLost { reason, .. } => tracing::warn!("{reason}"),
                    _ => {}
                },
                _ = self.tick.tick() => {
                    let now = self.now();
                    self.audience.tick(now, self.shell.recorder);
                }
            }
        }
        !self.audience.is_busy()
    }

    fn switch_stage(&self, switch: StageSwitch) {
        let stage = &self.shell.config.stages[switch.to];
        tracing::info!(
            "stage {} ({}) is in force from {} frames, rollout {}",
            stage.name,
            format::reward(&stage.reward),
            format::count(switch.frames),
            switch.rollout
        );
        if let Some(recorder) = self.shell.recorder {
            recorder.stage_switch(switch.from, switch.to, switch.frames, switch.rollout);
        }
        fault::reach("orchestrator.stage_switch");
    }
}

async fn received(remote_hosts: &mut Option<&mut RemoteHosts>) -> (u32, FromHost) {
    match remote_hosts {
        Some(remote_hosts) => remote_hosts.received().await,
        None => std::future::pending().await,
    }
}

/// Rank 0 reports for all learners, but each waits for its own actors.
fn is_for_audience(event: &LearnerEvent) -> bool {
    event.rank() == 0 || matches!(event, LearnerEvent::WaitingForActor { .. } | LearnerEvent::WaitingForRecorder { .. })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_other_learners_only_what_they_wait_for_is_shown() {
        let ready = |rank| crate::evaluation::testing::ready(rank, 0, 0);
        assert!(is_for_audience(&ready(0)) && !is_for_audience(&ready(1)));
        assert!(is_for_audience(&LearnerEvent::WaitingForActor { rank: 1, actor: 12, waited_s: 5.0 }));
    }
}
