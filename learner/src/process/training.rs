//! The training loop: announced rollout → collect → update → tell → save, until the budget is reached or a stop.

use super::announcements::Word;
use super::conversation::{Conversation, Silent};
use super::is_non_finite;
use super::stop::Stop;
use crate::agent::Agent;
use crate::checkpoint::{Snapshot, Store, encode_tensors};
use crate::collector::{Reward, Task};
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::control::{LearnerEvent, Timing, metric};
use proto::fault;
use proto::reward::RewardKind;
use proto::run_folder::{RunFolder, write_atomically};
use proto::stage::{RolloutShape, position_at};
use std::io::Write;
use std::time::{Duration, Instant};

/// Longest wait for a rollout's announcement.
const ANNOUNCEMENT_DEADLINE: Duration = Duration::from_mins(1);

/// A number that is not finite, and where to look at what it came from.
#[derive(Debug, thiserror::Error)]
#[error("{what}; what rollout {rollout} was made of is in {dump}")]
pub struct NonFinite {
    rollout: u64,
    what: String,
    dump: String,
}

/// All that training needs.
pub struct Training<W> {
    /// The run's configuration.
    pub config: Config,
    /// The run's folder.
    pub run: RunFolder,
    /// Where checkpoints go.
    pub store: Store,
    /// Network, beliefs, optimiser.
    pub agent: Agent,
    /// With actors and orchestrator.
    pub conversation: Conversation<W>,
    /// The next rollout.
    pub rollout: u64,
    /// Frames trained on.
    pub frames: u64,
    /// The rollout whose checkpoint is on disk, if this process knows of one.
    pub saved: Option<u64>,
}

/// State that only the loop needs.
struct Loop {
    last_save: Instant,
    timing: Timing,
}

impl<W: Write> Training<W> {
    /// Trains until the budget is reached or a stop; in both cases the state is saved at the end. A number that is not
    /// finite is dumped with its rollout.
    pub fn run(mut self) -> Result<()> {
        self.train().map_err(|error| if is_non_finite(&error) { self.dump(&error).into() } else { error })
    }

    fn train(&mut self) -> Result<()> {
        let mut state = Loop { last_save: Instant::now(), timing: Timing::default() };
        if self.saved.is_none() {
            self.save(&mut state)?;
        }
        self.conversation.restore_all()?;
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
            self.conversation.collector.begin(shape, reward, version);
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
            let statistics = self.conversation.collector.finish();
            // Fewer than planned when the other learners did not wait.
            let collected = statistics.frames();
            let before = self.frames;
            let frames = before + collected;
            self.conversation.tell(&LearnerEvent::RolloutCollected {
                rank: self.conversation.rank,
                rollout: self.rollout,
                frames,
            });

            fault::reach("learner.before_update");
            let update_began = Instant::now();
            let mut metrics = self.agent.update(progress, self.rollout)?;
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
            self.conversation.tell(&LearnerEvent::RolloutTrained {
                rank: self.conversation.rank,
                rollout,
                frames,
                stage: position.stage as u32,
                timing,
                metrics,
            });
            let stage_ended = collected == position.frames_left;
            let due = state.last_save.elapsed().as_secs_f64() >= self.config.checkpoint.interval_s;
            // The orchestrator evaluates that checkpoint.
            let validated = self.config.validation.is_due(before, frames);
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
        self.conversation.tell(&LearnerEvent::Finished {
            rank: self.conversation.rank,
            frames: self.frames,
            weights,
            complete: stop.is_none(),
        });
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
            boundary: self.conversation.collector.boundary(),
            weights: self.agent.weights_digest(),
        };
        let path = self.store.save(&snapshot)?;
        self.saved = Some(self.rollout);
        state.last_save = Instant::now();
        self.conversation.tell(&LearnerEvent::CheckpointWritten {
            rank: self.conversation.rank,
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
            self.conversation.receive_all()?;
            if let Some(stop) = self.conversation.stop_asked()? {
                return Ok(Err(stop));
            }
            match self.conversation.announcements.word(&self.config.stages, self.rollout, self.frames)? {
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
                Word::Wait => self.conversation.wait(Duration::from_millis(2))?,
            }
        }
    }

    /// Collects the rollout in progress; or says why it must be abandoned.
    fn collect(&mut self, state: &mut Loop) -> Result<Option<Stop>> {
        loop {
            if let Some([steps, planned]) = self.conversation.collector.between_steps()
                && self.agent.is_preempted(steps, planned)
            {
                tracing::info!("rollout {} ends after {steps} of {planned} steps: the others wait", self.rollout);
                self.conversation.collector.cut();
                self.agent.cut_rollout(steps);
            }
            match self.conversation.collector.task() {
                Task::Await { half: _ } => {
                    let began = Instant::now();
                    let stop = self.conversation.await_observations()?;
                    state.timing.simulate_s += began.elapsed().as_secs_f64();
                    if stop.is_some() {
                        return Ok(stop);
                    }
                }
                Task::Act { half, t } => {
                    self.conversation.note_connected();
                    let began = Instant::now();
                    self.settle(half);
                    let batch = self.conversation.collector.batch(half);
                    let output = self.agent.step(t, &batch.input())?;
                    drop(batch);
                    state.timing.infer_s += began.elapsed().as_secs_f64();
                    self.conversation.answer(half, &output.actions)?;
                    if half == 0 {
                        fault::reach("learner.mid_rollout");
                    }
                }
                Task::Bootstrap { half } => {
                    let began = Instant::now();
                    self.settle(half);
                    let batch = self.conversation.collector.batch(half);
                    self.agent.bootstrap(&batch.input())?;
                    drop(batch);
                    state.timing.infer_s += began.elapsed().as_secs_f64();
                    self.conversation.collector.bootstrapped(half);
                }
                Task::Finish => return Ok(None),
            }
        }
    }

    fn settle(&mut self, half: u32) {
        for settled in self.conversation.collector.settle(half) {
            self.agent.record(settled.t, settled.column, settled.outcome);
        }
    }

    /// What is left of a rollout that met a number that is not finite.
    fn dump(&self, error: &anyhow::Error) -> NonFinite {
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
        NonFinite { rollout: self.rollout, what: format!("{error:#}"), dump }
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
