use super::message_writer::RolloutMetrics;
use super::note::{Note, OBSERVATIONS, RecorderSetup, RecordingSummary, START_DEADLINE, now_ns};
use super::recorder_thread;
use crate::schema::foxglove::log::Level;
use crate::schema::stillroom::{StageSwitch, Validation};
use anyhow::{Context, Result, anyhow, bail};
use proto::event::LearnerEvent;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::Duration;
use wire::{Bell, Bells, Receipts, Sleeper, Standstill};

const LOOK: Duration = Duration::from_millis(5);
const FIRST_WARNING: Duration = Duration::from_secs(5);
const DIED: &str = "the recorder's thread ended unexpectedly; its last messages are in the log";

#[derive(Debug)]
pub struct Recorder {
    thread: JoinHandle<Result<RecordingSummary>>,
    notes: Sender<(u64, Note)>,
    bell: Bell,
    failure: Arc<OnceLock<String>>,
    receipts: Receipts,
    leader: u32,
    stages: Vec<(String, String)>,
}

impl Recorder {
    /// Starts the thread; returns once its subscriber exists, so that no actor started later can send past it.
    pub fn start(setup: RecorderSetup) -> Result<Self> {
        let (notes, inbox) = channel();
        let (ready, started) = channel();
        let bell = Bells::open(&setup.address, setup.shape).context(OBSERVATIONS)?.bell([Sleeper::Recorder]);
        let receipts = Receipts::open(&setup.address, setup.shape.shares.actors()).context(OBSERVATIONS)?;
        let (failure, leader) = (Arc::new(OnceLock::new()), setup.ranks.start);
        let stages = setup.config.stages.iter().map(|stage| (stage.name.clone(), stage.reward.clone())).collect();
        let thread = {
            let failure = Arc::clone(&failure);
            std::thread::Builder::new()
                .name("recorder".to_owned())
                // Ports of shared memory stay on the thread that made them.
                .spawn(move || {
                    let result = recorder_thread::run(&setup, &inbox, &failure, &ready);
                    if let Err(error) = &result {
                        // The first reason is kept.
                        let _ = failure.set(format!("{error:#}"));
                    }
                    result
                })
                .context("cannot start the recorder's thread")?
        };
        match started.recv_timeout(START_DEADLINE) {
            Ok(()) => Ok(Self { thread, notes, bell, failure, receipts, leader, stages }),
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {
                bail!("the recorder did not start within {} s", START_DEADLINE.as_secs())
            }
            // It returned before it was ready: with the reason, unless it panicked.
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => match thread.join() {
                Ok(Err(reason)) => Err(reason),
                Ok(Ok(_)) | Err(_) => bail!(DIED),
            },
        }
    }

    /// Records what the learner of this incarnation said: metrics on `/learner/metrics`, most else as a line on `/log`.
    /// Of a collected rollout the recorder checks that all of it is there, and writes it out.
    pub fn learner(&self, learner_incarnation: u32, event: &LearnerEvent) {
        match event {
            LearnerEvent::RolloutTrained { rank, rollout, frames, stage, timing, metrics } => {
                self.note(Note::Trained(RolloutMetrics {
                    rank: *rank,
                    rollout: *rollout,
                    frames: *frames,
                    stage: *stage,
                    timing: *timing,
                    metrics: metrics.clone(),
                }));
            }
            LearnerEvent::Ready { rank, rollout, frames, device, parameters, checkpoint } => {
                if *rank == self.leader {
                    self.note(Note::Began { learner_incarnation, frames: *frames });
                }
                let origin = checkpoint.as_deref().unwrap_or("a fresh start");
                self.learner_log(
                    *rank,
                    Level::Info,
                    format!("ready on {device}, {parameters} parameters, from {origin}: rollout {rollout}, {frames} frames trained"),
                );
            }
            LearnerEvent::ActorsConnected { rank } => {
                self.learner_log(*rank, Level::Info, "all actors have answered".to_owned());
            }
            LearnerEvent::RolloutCollected { rollout, frames, here, .. } => {
                let (rollout, frames, here) = (*rollout, *frames, *here);
                self.note(Note::Collected { learner_incarnation, rollout, frames, here });
            }
            // What begins is followed by what was written; an episode that was played has its end in the recording; a
            // recorder that stands still does not write that down.
            LearnerEvent::EpisodePlayed { .. }
            | LearnerEvent::CheckpointBegun { .. }
            | LearnerEvent::WaitingForRecorder { .. } => {}
            LearnerEvent::CheckpointWritten { rank, rollout, frames, path } => {
                self.learner_log(
                    *rank,
                    Level::Info,
                    format!("checkpoint {path}: rollout {rollout}, {frames} frames trained"),
                );
            }
            LearnerEvent::WaitingForActor { rank, actor, waited_s } => {
                self.learner_log(*rank, Level::Warning, format!("has waited {waited_s:.1} s for actor {actor}"));
            }
            LearnerEvent::Finished { rank, frames, weights, complete } => {
                let how = if *complete { "complete" } else { "stopped" };
                self.learner_log(*rank, Level::Info, format!("{how} after {frames} frames, weights {weights}"));
            }
        }
    }

    pub fn stage_switch(&self, from: Option<usize>, to: usize, frames: u64, rollout: u64) {
        let (name, reward) = self.stages.get(to).cloned().unwrap_or_default();
        let line = format!("stage {name} (reward {reward}) begins with rollout {rollout}, after {frames} frames");
        self.note(Note::Stage(StageSwitch {
            from: from.map(|stage| stage as u32),
            to: to as u32,
            name,
            reward,
            frames,
            rollout,
        }));
        self.note(Note::Log { level: Level::Info, process: "orchestrator".to_owned(), line });
    }

    pub fn validation(&self, figures: Validation) {
        self.note(Note::Validation(figures));
    }

    /// The error that stopped writing, if there is one. The supervisor then saves and ends the run. Until then the
    /// thread keeps receiving samples, so that no actor blocks on it.
    pub fn failure(&self) -> Option<String> {
        match self.failure.get() {
            Some(failure) => Some(failure.clone()),
            None if self.thread.is_finished() => Some(DIED.to_owned()),
            None => None,
        }
    }

    /// Takes what is still in shared memory, completes the last segment and sees it onto the disk. Warns of a disk that
    /// hangs, and gives it up after [`Standstill::DEADLINE`].
    pub fn finish(self) -> Result<RecordingSummary> {
        self.note(Note::Finish);
        let (mut standstill, mut warning) = (Standstill::default(), FIRST_WARNING);
        while !self.thread.is_finished() {
            let still = standstill.look(&self.receipts).unwrap_or_default();
            if still >= Standstill::DEADLINE {
                bail!(
                    "the recording has not got on for {} s: its disk hangs. What is written of it can be read; \
                     `orchestrator recover` completes the file",
                    still.as_secs()
                );
            }
            if still >= warning {
                tracing::warn!(
                    "the recording's end has not got on for {} s: its disk is slow or hangs",
                    still.as_secs()
                );
                warning = 2 * still;
            }
            std::thread::sleep(LOOK);
        }
        self.thread.join().map_err(|_| anyhow!(DIED))?
    }

    fn learner_log(&self, rank: u32, level: Level, line: String) {
        self.note(Note::Log { level, process: format!("learner-{rank}"), line });
    }

    fn note(&self, note: Note) {
        // A thread that is gone is reported by `failure` and `finish`.
        let _ = self.notes.send((now_ns(), note));
        self.bell.ring();
    }
}
