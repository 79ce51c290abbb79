//! A learner's communication: it receives observations and announcements, and sends actions, restores and events.
//! Training and evaluation both use it.

use super::announcements::Announcements;
use super::control::Control;
use super::link::{Ports, Sample};
use super::patience::{DEADLINES, Patience, Waited};
use super::stop::{OrchestratorGone, Stop};
use crate::collector::{Boundary, Collector, ColumnMap, Lane, Missing, Noise, Received, Settings, Signals};
use crate::shards::Shards;
use anyhow::Result;
use proto::config::Config;
use proto::event::LearnerEvent;
use std::io::Write;
use std::ops::Range;
use std::time::{Duration, Instant};
use wire::{Standstill, Written, fault};

/// Longest sleep without a look around. Whatever is waited for rings, but a process can be killed before it does.
const LOOK: Duration = Duration::from_millis(250);

#[derive(Debug, thiserror::Error)]
#[error("{actors} did not answer within {deadline_s:.0} s, twice learner.actor_deadline_s")]
pub struct Silent {
    actors: String,
    deadline_s: f64,
}

#[derive(Clone, Copy)]
pub struct Speaker<'a> {
    pub rank: u32,
    /// How often this learner has been started under this wire address, from 1.
    pub incarnation: u32,
    pub ports: &'a Ports,
    pub gone: &'a OrchestratorGone,
}

pub struct Conversation<'a, W> {
    pub rank: u32,
    pub collector: Collector<Sample>,
    /// What the orchestrator allows, by the newest announcement received.
    pub announcements: Announcements,
    actors: Range<u32>,
    incarnation: u32,
    actor_deadline_s: f64,
    ports: &'a Ports,
    control: Control<W>,
    gone: &'a OrchestratorGone,
    connected: bool,
    /// An actor has started since the last look.
    greeted: bool,
    standstill: Standstill,
    /// For how long the recorder had stood still when that was told last.
    pub(super) told_of_recorder: Duration,
}

impl<'a, W: Write> Conversation<'a, W> {
    /// The environments, divided into `shards`, go on from `boundary`; events are written to `output`.
    pub fn open(speaker: Speaker<'a>, config: &Config, shards: &Shards, boundary: Boundary, output: W) -> Self {
        let Speaker { rank, incarnation, ports, gone } = speaker;
        let settings = Settings {
            column_map: ColumnMap::of(rank, config),
            seed: config.seed,
            noise: Noise::of(&config.action_head()),
            max_episode_steps: config.episode.max_steps,
            task: config.spec(),
            gamma: config.ppo.gamma,
            signals: Signals::of(config),
            learner_incarnation: incarnation,
            recorded: ports.recorded(),
        };
        let actors = config.shares().actors_of(rank);
        gone.wakes(ports.own_bell());
        Self {
            rank,
            collector: Collector::new(settings, shards, boundary),
            announcements: Announcements::default(),
            actors,
            incarnation,
            actor_deadline_s: config.learner.actor_deadline_s,
            ports,
            control: Control::new(output, gone.clone()),
            gone,
            connected: false,
            greeted: false,
            standstill: Standstill::default(),
            told_of_recorder: Duration::ZERO,
        }
    }

    pub fn tell(&mut self, event: &LearnerEvent) {
        self.control.tell(event);
    }

    pub fn restore_all(&self) -> Result<()> {
        self.actors.clone().try_for_each(|actor| self.restore(actor, 0))
    }

    fn restore(&self, actor: u32, actor_incarnation: u32) -> Result<()> {
        let (header, states) = self.collector.restore(actor, actor_incarnation);
        self.ports.send_restore(actor, header, &states)
    }

    /// Sleeps until an actor has sent something, something is announced or the orchestrator is gone, at most for
    /// `longest`; it may wake without a reason.
    pub fn wait(&self, longest: Duration) {
        self.wait_for(1, longest);
    }

    /// The same, but observations wake it only when so many have come.
    fn wait_for(&self, observations: u32, longest: Duration) {
        self.ports.wait(observations, longest.min(LOOK));
    }

    /// Receives every waiting sample, so that an actor that is served first does not make others wait, and reads the
    /// recorder's receipts.
    pub fn receive_all(&mut self) -> Result<()> {
        fault::reach("learner.before_receive");
        while let Some((header, sample)) = self.ports.receive()? {
            fault::reach("learner.after_receive");
            match self.collector.receive(&header, sample)? {
                Received::Hello { actor, actor_incarnation } => {
                    tracing::debug!("actor {actor}, start number {actor_incarnation}, asks for its state");
                    self.restore(actor, actor_incarnation)?;
                    self.greeted = true;
                }
                Received::Foreign => {
                    tracing::debug!("actor {} still follows learner {}", header.actor, header.learner_incarnation);
                }
                Received::Kept | Received::Duplicate => {}
            }
        }
        for (actor, half, receipt) in self.ports.receipts() {
            if half < self.collector.halves() {
                self.collector.recorded(actor, half, receipt);
            }
        }
        Ok(())
    }

    /// Reads the announcements; returns a reason to stop, if there is one.
    pub fn stop_asked(&mut self) -> Result<Option<Stop>> {
        for announcement in self.ports.announcements()? {
            fault::reach("learner.after_announcement");
            self.announcements.hear(announcement);
        }
        Ok(if self.gone.is_set() {
            Some(Stop::OrchestratorGone)
        } else {
            self.announcements.stop().then_some(Stop::Announced)
        })
    }

    /// Receives until enough actors have sent their observations, or there is a reason to stop.
    pub fn await_observations(&mut self) -> Result<Option<Stop>> {
        self.await_actors(Collector::missing)
    }

    /// Waits until the recorder has the observations of these lanes, or there is a reason to stop. An actor that cannot
    /// send them to it does not answer, whatever the learner has of it.
    pub fn await_receipts(&mut self, lanes: &[Lane]) -> Result<Option<Stop>> {
        self.await_actors(|collector| collector.unrecorded(lanes))
    }

    /// Whether the recording of this learner's rollouts before `rollout` is written; without a recorder it is.
    pub(super) fn is_written(&self, rollout: u64) -> bool {
        let written =
            |Written { learner_incarnation, rollout: to }| learner_incarnation == self.incarnation && to >= rollout;
        !self.ports.recorded() || self.ports.written().is_some_and(written)
    }

    /// For how long the recorder has stood still, if there is one and it does.
    pub(super) fn recorder_standstill(&mut self) -> Option<Duration> {
        self.ports.look_at_recorder(&mut self.standstill)
    }

    /// Whether nothing more can be recorded.
    pub fn recording_failed(&self) -> bool {
        self.ports.recording_failed()
    }

    /// Receives until no actor is waited for, or there is a reason to stop.
    fn await_actors(&mut self, waits_for: impl Fn(&Collector<Sample>) -> Missing) -> Result<Option<Stop>> {
        let mut began = Instant::now();
        let mut patience = Patience::new(self.actor_deadline_s);
        loop {
            self.receive_all()?;
            let Missing { actors: missing, enough } = waits_for(&self.collector);
            if let Some(stop) = self.stop_asked()? {
                return Ok(Some(stop));
            }
            if missing.is_empty() {
                return Ok(None);
            }
            // An actor that was started again has its time, too.
            if std::mem::take(&mut self.greeted) || self.recorder_stands_still()? {
                (began, patience) = (Instant::now(), Patience::new(self.actor_deadline_s));
            }
            let waited = began.elapsed();
            let left = match patience.after(waited) {
                Waited::Overdue => return Err(self.silent(&missing).into()),
                Waited::Wait(left) => left,
                Waited::Notice(left) => {
                    let waited_s = waited.as_secs_f64();
                    for actor in missing {
                        self.tell(&LearnerEvent::WaitingForActor { rank: self.rank, actor, waited_s });
                    }
                    left
                }
            };
            self.wait_for(enough, left);
        }
    }

    fn silent(&self, missing: &[u32]) -> Silent {
        let named: Vec<String> = missing.iter().map(u32::to_string).collect();
        let plural = if named.len() == 1 { "actor" } else { "actors" };
        Silent { actors: format!("{plural} {}", named.join(", ")), deadline_s: DEADLINES * self.actor_deadline_s }
    }

    /// Reports, once, that all actors have answered.
    pub fn note_connected(&mut self) {
        if !self.connected && self.collector.all_seen() {
            self.connected = true;
            self.tell(&LearnerEvent::ActorsConnected { rank: self.rank });
        }
    }

    /// Sends these lanes' actions, in batch order, once the recorder has what they answer; or returns a reason to stop.
    pub fn answer(&mut self, lanes: &[Lane], actions: &[u8]) -> Result<Option<Stop>> {
        let stop = self.await_receipts(lanes)?;
        if stop.is_none() {
            self.ports.send_actions(&self.collector.answer(lanes, actions))?;
        }
        Ok(stop)
    }
}
