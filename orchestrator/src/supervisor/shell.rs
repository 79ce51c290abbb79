//! The loop around the machine: processes, signals and shared memory on one side, events and actions on the other.
//!
//! Everything happens on one thread, because ports of shared memory stay on the thread that made them; children are
//! listened to by small tasks on the same thread, which send events. A turn of the loop takes milliseconds, the
//! longest part being the sweep after a death.

use super::event::{Action, End, Event, Exit, Level, Outcome, Process};
use super::machine::Supervisor;
use super::policy::Policy;
use super::process::{Launch, Processes};
use super::stage::StageSwitch;
use crate::recorder::Recorder;
use anyhow::{Context, Result};
use proto::config::Config;
use proto::event::LearnerEvent;
use std::collections::VecDeque;
use std::time::{Duration, Instant};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use tokio::time::{Interval, MissedTickBehavior};
use wire::WireHost;
use wire::fault;

/// How often deadlines are looked at, late subscribers are given the announcement, and progress is shown.
const TICK: Duration = Duration::from_millis(250);
/// A dead process's ports are swept at its death and on this many ticks after it: the file locks by which it is known
/// to be dead are released a moment after it is reaped.
const SWEEPS_AFTER_DEATH: u32 = 4;
/// Events that may wait. A child that is not listened to blocks; the orchestrator never does.
const QUEUE: usize = 1024;

/// The signals that ask for a stop.
#[derive(Debug)]
pub struct Signals {
    interrupt: Signal,
    terminate: Signal,
    hang_up: Option<Signal>,
}

impl Signals {
    /// From now on signals are events. To be called inside the runtime, before there is anything to clean up.
    pub fn install() -> Result<Self> {
        // nohup: a closed terminal is no reason to stop.
        let ignores_hang_up = signal_is_ignored(SignalKind::hangup().as_raw_value());
        Ok(Self {
            interrupt: signal(SignalKind::interrupt()).context("SIGINT")?,
            terminate: signal(SignalKind::terminate()).context("SIGTERM")?,
            hang_up: if ignores_hang_up { None } else { Some(signal(SignalKind::hangup()).context("SIGHUP")?) },
        })
    }

    async fn next(&mut self) -> Event {
        let hang_up = async {
            match &mut self.hang_up {
                Some(hang_up) => hang_up.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = self.interrupt.recv() => Event::Interrupt,
            _ = self.terminate.recv() => Event::Stop,
            _ = hang_up => Event::Stop,
        }
    }
}

fn signal_is_ignored(number: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap_or_default();
    u64::from_str_radix(mask.trim(), 16).is_ok_and(|mask| mask >> (number - 1) & 1 == 1)
}

/// Who is told what the learner says, of several the one that speaks for all: keeps it, and shows how the work gets on.
pub trait Audience {
    /// The learner spoke. An error is the end: what happens cannot be written down any more.
    fn learner(&mut self, now: Duration, event: &LearnerEvent) -> Result<()>;
    /// The learner is gone: it died, or it has left after it said so.
    fn learner_died(&mut self, now: Duration);
    /// Some time has passed.
    fn tick(&mut self, now: Duration, recorder: Option<&Recorder>);
    /// Whether there is something of its own to wait for when all work is complete. It is told of ticks meanwhile. Who
    /// asks to stop does not wait: the run then counts as stopped, and what is missing is made when it goes on.
    fn is_busy(&self) -> bool {
        false
    }
    /// It is over: nothing more is shown, and nothing of its own goes on.
    fn over(&mut self);
}

/// What the loop works with.
pub struct Shell<'a> {
    /// Configuration of the run.
    pub config: &'a Config,
    /// The services.
    pub host: &'a WireHost,
    /// The recording, if there is one.
    pub recorder: Option<&'a Recorder>,
    /// Requests to stop.
    pub signals: Signals,
}

impl Shell<'_> {
    /// Runs everything to its end.
    pub async fn supervise(mut self, launch: Launch, audience: &mut impl Audience) -> Result<Outcome> {
        let announcer = self.host.wire().announcer()?;
        let (sender, mut inbox) = mpsc::channel(QUEUE);
        let mut processes = Processes::new(launch, sender);
        let stages = if self.config.evaluation.is_some() { Vec::new() } else { self.config.stages.clone() };
        let mut machine = Supervisor::new(Policy::of(self.config), stages);
        let mut learner_incarnation = 0;
        let mut sweeps = 0;
        let mut own_events: VecDeque<Event> = VecDeque::new();
        let mut recording_failed = false;
        let mut asked_to_stop = false;

        let begin = Instant::now();
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut actions = machine.start(Duration::ZERO);
        fault::reach("orchestrator.before_spawn");
        loop {
            for action in actions {
                match action {
                    Action::Spawn { process, incarnation } => {
                        if matches!(process, Process::Learner(_)) {
                            learner_incarnation = incarnation;
                        }
                        if let Err(cause) = processes.spawn(process, incarnation) {
                            let exit = Exit::NotStarted(cause);
                            own_events.push_back(Event::Exited { process, incarnation, exit, last_words: vec![] });
                        }
                        fault::reach("orchestrator.after_spawn");
                    }
                    Action::CloseLifeline(process) => processes.close_lifeline(process),
                    Action::Kill(process) => processes.kill(process),
                    Action::Announce(announcement) => {
                        fault::reach("orchestrator.before_announce");
                        announcer.announce(announcement)?;
                        fault::reach("orchestrator.after_announce");
                    }
                    Action::SwitchStage(switch) => self.switch_stage(switch),
                    Action::Report(Level::Info, text) => tracing::info!("{text}"),
                    Action::Report(Level::Warning, text) => tracing::warn!("{text}"),
                    Action::Report(Level::Error, text) => tracing::error!("{text}"),
                    Action::Finish(mut outcome) => {
                        let complete = outcome.end == End::Complete;
                        if complete && !self.wait_for(audience, &mut tick, begin, asked_to_stop).await {
                            outcome.end = End::Stopped;
                        }
                        audience.over();
                        return Ok(outcome);
                    }
                }
            }
            let event = if let Some(event) = own_events.pop_front() {
                event
            } else {
                tokio::select! {
                    event = self.signals.next() => event,
                    Some(event) = inbox.recv() => event,
                    _ = tick.tick() => Event::Tick,
                }
            };
            let now = begin.elapsed();
            match &event {
                Event::Exited { process, .. } => {
                    processes.forget(*process);
                    // When another learner dies, this one does not outlive it.
                    if *process == Process::Learner(0) {
                        audience.learner_died(now);
                    }
                    // Before its place is taken, and before anyone blocks on what it held.
                    self.host.sweep_dead();
                    sweeps = SWEEPS_AFTER_DEATH;
                }
                Event::Learner { incarnation, event } if *incarnation == learner_incarnation => {
                    if let Some(recorder) = self.recorder {
                        recorder.learner(event);
                    }
                    if is_for_audience(event)
                        && let Err(error) = audience.learner(now, event)
                    {
                        own_events.push_back(Event::CannotWrite(format!("{error:#}")));
                    }
                }
                Event::Tick => {
                    if let Err(error) = announcer.update() {
                        tracing::debug!("{error}");
                    }
                    if sweeps > 0 {
                        sweeps -= 1;
                        self.host.sweep_dead();
                    }
                    if !recording_failed && let Some(failure) = self.recorder.and_then(Recorder::failure) {
                        recording_failed = true;
                        own_events.push_back(Event::CannotWrite(failure));
                    }
                    audience.tick(now, self.recorder);
                }
                Event::Stop | Event::Interrupt => asked_to_stop = true,
                _ => {}
            }
            actions = machine.on_event(now, event);
        }
    }

    /// Waits for what the audience still has to do; false if someone asks to stop before that is done.
    async fn wait_for(
        &mut self,
        audience: &mut impl Audience,
        tick: &mut Interval,
        begin: Instant,
        mut asked_to_stop: bool,
    ) -> bool {
        while audience.is_busy() && !asked_to_stop {
            tokio::select! {
                _ = self.signals.next() => asked_to_stop = true,
                _ = tick.tick() => audience.tick(begin.elapsed(), self.recorder),
            }
        }
        !audience.is_busy()
    }

    fn switch_stage(&self, switch: StageSwitch) {
        let stage = &self.config.stages[switch.to];
        tracing::info!(
            "stage {} ({}) is in force from {} frames, rollout {}",
            stage.name,
            crate::progress::reward_symbol(stage.reward),
            switch.frames,
            switch.rollout
        );
        if let Some(recorder) = self.recorder {
            recorder.stage_switch(switch.from, switch.to, switch.frames, switch.rollout);
        }
        fault::reach("orchestrator.stage_switch");
    }
}

/// Rank 0 speaks for all learners, but each waits for actors of its own.
fn is_for_audience(event: &LearnerEvent) -> bool {
    event.rank() == 0 || matches!(event, LearnerEvent::WaitingForActor { .. })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_other_learners_only_what_they_wait_for_is_shown() {
        let ready = |rank| LearnerEvent::Ready {
            rank,
            rollout: 0,
            frames: 0,
            device: "cpu".into(),
            parameters: 1,
            checkpoint: None,
        };
        assert!(is_for_audience(&ready(0)) && !is_for_audience(&ready(1)));
        assert!(is_for_audience(&LearnerEvent::WaitingForActor { rank: 1, actor: 12, waited_s: 5.0 }));
    }
}
