//! The training loop: announced rollout → collect → update → tell → save, until the budget is reached or a stop.

use super::announcements::{Announcements, Word};
use super::control::Control;
use super::stop::{OrchestratorGone, Stop};
use super::wire::{Ports, Sample};
use crate::agent::{Agent, AgentError};
use crate::checkpoint::{Snapshot, Store, encode_tensors};
use crate::collector::{Collector, Received, Reward, Task};
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::control::{LearnerEvent, Timing, metric};
use proto::fault;
use proto::reward::RewardKind;
use proto::run_folder::{RunFolder, write_atomically};
use proto::stage::{RolloutShape, position_at};
use std::io::Write;
use std::time::{Duration, Instant};

/// Longest sleep without a look at lifeline and announcements.
const LOOK: Duration = Duration::from_millis(50);
/// Longest wait for a rollout's announcement.
const ANNOUNCEMENT_DEADLINE: Duration = Duration::from_mins(1);
/// An actor that has not answered for this long is told of, and again after each [`NOTICE_INTERVAL`].
const FIRST_NOTICE: Duration = Duration::from_secs(2);
const NOTICE_INTERVAL: Duration = Duration::from_secs(10);

/// An error that ends the process with a status of its own.
#[derive(Debug, thiserror::Error)]
#[error("{what} is not finite; what rollout {rollout} was made of is in {dump}")]
pub struct NonFinite {
    rollout: u64,
    what: String,
    dump: String,
}

/// Actors that did not answer in time.
#[derive(Debug, thiserror::Error)]
#[error("{actors} did not answer within {deadline_s:.0} s (learner.actor_deadline_s)")]
struct Silent {
    actors: String,
    deadline_s: f64,
}

/// All that training needs.
pub struct Training<W> {
    /// Rank in the process group.
    pub rank: u32,
    /// The run's configuration.
    pub config: Config,
    /// The run's folder.
    pub run: RunFolder,
    /// Where checkpoints go.
    pub store: Store,
    /// Network, beliefs, optimiser.
    pub agent: Agent,
    /// Environments and their exchanges.
    pub collector: Collector<Sample>,
    /// Shared memory.
    pub ports: Ports,
    /// Events to the orchestrator.
    pub control: Control<W>,
    /// Set when the orchestrator is gone.
    pub gone: OrchestratorGone,
    /// The next rollout.
    pub rollout: u64,
    /// Frames trained on.
    pub frames: u64,
    /// The rollout whose checkpoint is on disk, if this process knows of one.
    pub saved: Option<u64>,
}

/// State that only the loop needs.
struct Loop {
    announcements: Announcements,
    connected: bool,
    last_save: Instant,
    timing: Timing,
}

impl<W: Write> Training<W> {
    /// Trains until the budget is reached or a stop; in both cases the state is saved at the end.
    pub fn run(mut self) -> Result<()> {
        let mut state = Loop {
            announcements: Announcements::default(),
            connected: false,
            last_save: Instant::now(),
            timing: Timing::default(),
        };
        if self.saved.is_none() {
            self.save(&mut state)?;
        }
        for actor in 0..self.config.actors.count {
            self.restore(actor, 0)?;
        }
        while let Some(position) = position_at(&self.config.stages, self.frames) {
            let began = Instant::now();
            let version = match self.await_announcement(&mut state)? {
                Ok(version) => version,
                Err(stop) => return self.leave(&mut state, Some(stop)),
            };
            if position.frames_in_stage == 0 {
                self.agent.start_stage();
            }
            let stage = &self.config.stages[position.stage];
            let progress = position.frames_in_stage as f64 / stage.frames as f64;
            let environments = self.config.environments();
            let shape = RolloutShape::next(position.frames_left, self.config.ppo.rollout_steps as usize, environments);
            let reward = Reward { kind: stage.reward, disturbance_weight: self.agent.disturbance_weight(stage.reward) };
            self.agent.begin_rollout(shape);
            self.collector.begin(shape, reward, version);
            match self.collect(&mut state) {
                Ok(None) => {}
                Ok(Some(stop)) => {
                    self.agent.abandon_rollout();
                    return self.leave(&mut state, Some(stop));
                }
                Err(error) if error.is::<Silent>() => {
                    // The work up to the boundary is good, whatever became of the actor.
                    self.agent.abandon_rollout();
                    self.save_unsaved(&mut state)?;
                    return Err(error);
                }
                Err(error) => return Err(error),
            }
            let statistics = self.collector.finish();
            // Fewer than planned when the other learners did not wait.
            let collected = statistics.frames();
            let frames = self.frames + collected;
            self.tell(&LearnerEvent::RolloutCollected { rank: self.rank, rollout: self.rollout, frames });

            fault::reach("learner.before_update");
            let update_began = Instant::now();
            let update = self.agent.update(progress, self.rollout);
            let mut metrics = update.map_err(|error| self.agent_failed(error))?;
            fault::reach("learner.after_update");
            state.timing.update_s = update_began.elapsed().as_secs_f64();
            metrics.extend(statistics.metrics());
            if reward.kind == RewardKind::Lagrangian {
                self.agent.constrain(statistics.mean_discounted_disturbance_m());
                metrics.insert(metric::MULTIPLIER.to_owned(), self.agent.multiplier());
            }
            let rollout = self.rollout;
            self.rollout += 1;
            self.frames = frames;

            let timing = state.timing_of(began.elapsed());
            self.tell(&LearnerEvent::RolloutTrained {
                rank: self.rank,
                rollout,
                frames,
                stage: position.stage as u32,
                timing,
                metrics,
            });
            let stage_ended = collected == position.frames_left;
            let due = state.last_save.elapsed().as_secs_f64() >= self.config.checkpoint.interval_s;
            // The orchestrator evaluates that checkpoint.
            let validated = self.config.validation.is_due(frames - shape.frames, frames);
            if stage_ended || due || validated {
                let began = Instant::now();
                self.save(&mut state)?;
                // It falls into the next rollout's account.
                state.timing.other_s += began.elapsed().as_secs_f64();
            }
        }
        self.leave(&mut state, None)
    }

    /// Saves what is not saved and says good-bye.
    fn leave(&mut self, state: &mut Loop, stop: Option<Stop>) -> Result<()> {
        match stop {
            None => tracing::info!("the budget of {} frames is reached", self.frames),
            Some(Stop::Announced) => tracing::info!("stopped at {} frames, rollout {}", self.frames, self.rollout),
            Some(Stop::OrchestratorGone) => {
                tracing::warn!("the orchestrator is gone: saving at {} frames, rollout {}", self.frames, self.rollout);
            }
        }
        self.save_unsaved(state)?;
        let weights = self.agent.weights_digest();
        self.tell(&LearnerEvent::Finished { rank: self.rank, frames: self.frames, weights, complete: stop.is_none() });
        Ok(())
    }

    /// Saves, unless this very boundary is on disk.
    fn save_unsaved(&mut self, state: &mut Loop) -> Result<()> {
        if self.saved == Some(self.rollout) { Ok(()) } else { self.save(state) }
    }

    fn save(&mut self, state: &mut Loop) -> Result<()> {
        let snapshot = Snapshot {
            rollout: self.rollout,
            frames: self.frames,
            agent: self.agent.state(),
            boundary: self.collector.boundary(),
            weights: self.agent.weights_digest(),
        };
        let path = self.store.save(&snapshot)?;
        self.saved = Some(self.rollout);
        state.last_save = Instant::now();
        self.tell(&LearnerEvent::CheckpointWritten {
            rank: self.rank,
            rollout: self.rollout,
            frames: self.frames,
            path,
        });
        Ok(())
    }

    /// Waits until the next rollout is announced. Actors that start meanwhile are served.
    fn await_announcement(&mut self, state: &mut Loop) -> Result<Result<u64, Stop>> {
        let began = Instant::now();
        loop {
            self.receive_all()?;
            if let Some(stop) = self.stop_asked(state)? {
                return Ok(Err(stop));
            }
            match state.announcements.word(&self.config.stages, self.rollout, self.frames)? {
                Word::Begin { version } => return Ok(Ok(version)),
                Word::Stop => return Ok(Err(Stop::Announced)),
                Word::Wait if began.elapsed() >= ANNOUNCEMENT_DEADLINE => {
                    // The work up to the boundary is good, whatever became of the orchestrator.
                    self.save_unsaved(state)?;
                    bail!(
                        "the orchestrator does not answer: rollout {} was not announced within {} s. The run is saved: \
                         end the orchestrator if it still runs, then `orchestrator resume {}`",
                        self.rollout,
                        ANNOUNCEMENT_DEADLINE.as_secs(),
                        self.run.root().display()
                    )
                }
                // Announcements ring no bell.
                Word::Wait => self.ports.wait(Duration::from_millis(2))?,
            }
        }
    }

    /// Collects the rollout in progress; or says why it must be abandoned.
    fn collect(&mut self, state: &mut Loop) -> Result<Option<Stop>> {
        loop {
            if let Some([steps, planned]) = self.collector.between_steps()
                && self.agent.is_preempted(steps, planned)
            {
                tracing::info!("rollout {} ends after {steps} of {planned} steps: the others wait", self.rollout);
                self.collector.cut();
                self.agent.cut_rollout(steps);
            }
            match self.collector.task() {
                Task::Await { half: _ } => {
                    let began = Instant::now();
                    let stop = self.await_observations(state)?;
                    state.timing.simulate_s += began.elapsed().as_secs_f64();
                    if stop.is_some() {
                        return Ok(stop);
                    }
                }
                Task::Act { half, t } => {
                    if !state.connected {
                        // What is due could not be if any actor had not answered.
                        state.connected = true;
                        self.tell(&LearnerEvent::ActorsConnected { rank: self.rank });
                    }
                    let began = Instant::now();
                    self.settle(half);
                    let batch = self.collector.batch(half);
                    let output = self.agent.step(t, &batch.input()).map_err(|error| self.agent_failed(error))?;
                    drop(batch);
                    state.timing.infer_s += began.elapsed().as_secs_f64();
                    for batch in self.collector.answer(half, &output.actions) {
                        self.ports.send_actions(&batch)?;
                    }
                    if half == 0 {
                        fault::reach("learner.mid_rollout");
                    }
                }
                Task::Bootstrap { half } => {
                    let began = Instant::now();
                    self.settle(half);
                    let batch = self.collector.batch(half);
                    self.agent.bootstrap(&batch.input()).map_err(|error| self.agent_failed(error))?;
                    drop(batch);
                    state.timing.infer_s += began.elapsed().as_secs_f64();
                    self.collector.bootstrapped(half);
                }
                Task::Finish => return Ok(None),
            }
        }
    }

    fn settle(&mut self, half: u32) {
        for settled in self.collector.settle(half) {
            self.agent.record(settled.t, settled.column, settled.outcome);
        }
    }

    /// Receives until the half whose turn it is is complete.
    fn await_observations(&mut self, state: &mut Loop) -> Result<Option<Stop>> {
        let began = Instant::now();
        let deadline_s = self.config.learner.actor_deadline_s;
        let mut notice = FIRST_NOTICE;
        loop {
            self.receive_all()?;
            let missing = self.collector.missing();
            if let Some(stop) = self.stop_asked(state)? {
                return Ok(Some(stop));
            }
            if missing.is_empty() {
                return Ok(None);
            }
            let waited = began.elapsed();
            if waited.as_secs_f64() >= deadline_s {
                let named: Vec<String> = missing.iter().map(u32::to_string).collect();
                let plural = if named.len() == 1 { "actor" } else { "actors" };
                let actors = format!("{plural} {}", named.join(", "));
                return Err(Silent { actors, deadline_s }.into());
            }
            if waited >= notice {
                notice = waited + NOTICE_INTERVAL;
                let waited_s = waited.as_secs_f64();
                for actor in missing {
                    self.tell(&LearnerEvent::WaitingForActor { rank: self.rank, actor, waited_s });
                }
            }
            self.ports.wait(LOOK)?;
        }
    }

    /// Takes in every sample that is waiting: whoever is served first must not keep others waiting.
    fn receive_all(&mut self) -> Result<()> {
        while let Some((header, sample)) = self.ports.receive()? {
            match self.collector.receive(&header, sample)? {
                Received::Hello { actor, actor_incarnation } => {
                    tracing::debug!("actor {actor}, start number {actor_incarnation}, asks for its state");
                    self.restore(actor, actor_incarnation)?;
                }
                Received::Foreign => {
                    tracing::debug!("actor {} still follows learner {}", header.actor, header.learner_incarnation);
                }
                Received::Kept | Received::Duplicate => {}
            }
        }
        Ok(())
    }

    fn restore(&self, actor: u32, actor_incarnation: u32) -> Result<()> {
        let (header, states) = self.collector.restore(actor, actor_incarnation);
        self.ports.send_restore(actor, header, &states)
    }

    fn stop_asked(&self, state: &mut Loop) -> Result<Option<Stop>> {
        for announcement in self.ports.announcements()? {
            state.announcements.hear(announcement);
        }
        Ok(if self.gone.is_set() {
            Some(Stop::OrchestratorGone)
        } else {
            state.announcements.stop().then_some(Stop::Announced)
        })
    }

    /// A number that is not finite is dumped with its rollout; every other error passes.
    fn agent_failed(&self, error: AgentError) -> anyhow::Error {
        let AgentError::NonFinite { what } = error else { return error.into() };
        let path = self.run.nonfinite_dump(self.rollout);
        let mut tensors = self.agent.state().tensors;
        tensors.extend(self.agent.rollout_tensors());
        let written = encode_tensors(&tensors)
            .map_err(anyhow::Error::from)
            .and_then(|bytes| write_atomically(&path, &bytes).context("cannot write"));
        let dump = match written {
            Ok(()) => path.display().to_string(),
            Err(cause) => format!("no file: {}: {cause:#}", path.display()),
        };
        NonFinite { rollout: self.rollout, what, dump }.into()
    }

    fn tell(&mut self, event: &LearnerEvent) {
        self.control.tell(event);
    }
}

impl Loop {
    /// Closes the account of a rollout that took `total`; what is in no other account is "other". The next one begins.
    fn timing_of(&mut self, total: Duration) -> Timing {
        let mut timing = std::mem::take(&mut self.timing);
        let accounted = timing.simulate_s + timing.infer_s + timing.update_s;
        timing.other_s += (total.as_secs_f64() - accounted).max(0.0);
        timing
    }
}
