//! The training loop: wait for the rollout's announcement, collect it, agree with the other learners, update, report,
//! save; until the budget is reached or a stop is requested.
//!
//! With `ppo.overlap` an update runs while the next rollout is collected. Whatever concerns all learners happens when
//! the update is through and before the next begins: so their calls to each other have one order, and what is saved is
//! the boundary between the two rollouts, just as without it.

use super::announcements::Permission;
use super::conversation::{Conversation, Silent};
use super::ends::{CutShort, joint_end, reasons};
use super::failure::{NonFinite, Unsaved, is_non_finite, is_unsaved};
use super::pacing::Pacing;
use super::stop::Stop;
use super::writing::Unrecorded;
use crate::agent::{Agent, AgentError};
use crate::checkpoint::{CheckpointError, Part, Snapshot, Store};
use crate::collector::{Lane, Reward, RolloutStatistics, Settled, Task};
use anyhow::Result;
use proto::config::Config;
use proto::event::{LearnerEvent, Timing};
use proto::hosts::Hosts;
use proto::learning_rate::learning_rate_progress;
use proto::metric;
use proto::run_folder::RunFolder;
use proto::shell::quoted;
use proto::stage::{RolloutShape, StagePosition, position_at};
use proto::trained::{History, Trained};
use std::collections::BTreeMap;
use std::io::Write;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use wire::fault;

const ANNOUNCEMENT_DEADLINE: Duration = Duration::from_mins(1);

pub struct Training<'a, W> {
    pub config: Config,
    pub run: RunFolder,
    pub store: Store,
    pub agent: Agent,
    pub conversation: Conversation<'a, W>,
    pub pacing: Pacing,
    /// The next rollout to be trained on.
    pub rollout: u64,
    pub frames: u64,
    pub in_update: Option<InUpdate>,
    /// The rollout of the last checkpoint on disk, if this process has written or loaded one.
    pub saved: Option<u64>,
    /// Columns of actors that the run does not have at present: every checkpoint holds them.
    pub resting: Option<Part>,
    /// Figures of all rollouts trained so far.
    pub figures: History,
    /// Number of the orchestrator's start.
    pub orchestrator: u32,
    pub hosts: Hosts,
}

pub struct InUpdate {
    rollout: u64,
    /// Frames trained on when the update is through.
    frames: u64,
    stage: u32,
    ends_stage: bool,
    /// What is known before the update is through.
    metrics: BTreeMap<String, f64>,
}

struct Agreement {
    /// Frames that all learners collected: fewer than planned if some were pre-empted.
    collected: u64,
    /// Those of this host.
    here: u64,
    preempted: u32,
    /// Why all abandon it, if one must.
    end: Option<CutShort>,
}

/// State that only the loop needs.
struct Loop {
    last_save: Instant,
    /// When the timing's rollout began: when the one before was through.
    began: Instant,
    timing: Timing,
    /// When the learners agreed last.
    agreed: Option<Instant>,
    /// From the agreement before to that one, the mean of all learners; none before the second.
    took: Option<Duration>,
    /// This learner ended the rollout in progress, or the last one, early, because the others had finished.
    preempted: bool,
    /// The next checkpoint is to be evaluated.
    evaluated: bool,
    /// See [`crate::collector::Collector::actor_starts`].
    actor_starts: u64,
}

impl<W: Write> Training<'_, W> {
    /// Trains until the budget is reached or a stop; in both cases the state is saved at the end. A number that is not
    /// finite is dumped with its rollout.
    pub fn run(mut self) -> Result<()> {
        self.train().map_err(|error| {
            let (collecting, dumped) = (self.next().0, error.is::<NonFinite>());
            self.agent.await_update();
            if is_non_finite(&error) && !dumped { self.dump(collecting, &error).into() } else { error }
        })
    }

    fn train(&mut self) -> Result<()> {
        let mut state = Loop::new();
        if self.saved.is_none() {
            self.save(&mut state)?;
        }
        self.conversation.restore_all()?;
        state.began = Instant::now();
        loop {
            let (rollout, before) = self.next();
            let Some(position) = position_at(&self.config.stages, before) else { break };
            let cut_short = self.await_and_collect(&mut state, position)?;
            // With `ppo.overlap`: of the rollout before this one. From here to the next update the learners speak to
            // each other, and this is the rollout of which they speak.
            self.finish_update(&mut state)?;
            let Agreement { collected, here, preempted, end } = self.agree(&mut state, cut_short)?;
            if let Some(end) = end {
                return self.break_off(&mut state, end);
            }
            let frames = before + collected;
            self.tell_collected(frames, here);
            if let Some(end) = self.await_writing()? {
                return self.break_off(&mut state, end);
            }
            let own = self.conversation.collector.finish();
            let statistics = RolloutStatistics::over(&own, self.agent.shards(), self.agent.peers())?;
            assert_eq!(statistics.frames(), collected, "every frame is counted once");

            fault::reach("learner.before_update");
            let metrics = self.known_before_update(position, &statistics, preempted);
            let stage = &self.config.stages[position.stage];
            let whole = self.config.ppo.learning_rate_frames;
            let progress = learning_rate_progress(position.frames_in_stage, stage.frames, whole);
            self.agent.begin_update(progress, rollout);
            let (stage, ends_stage) = (position.stage as u32, collected == position.frames_left);
            self.in_update = Some(InUpdate { rollout, frames, stage, ends_stage, metrics });
            // A stage begins with a fresh optimiser, and its end is saved.
            if ends_stage || !self.config.ppo.overlap {
                self.finish_update(&mut state)?;
            }
        }
        self.leave(&mut state, None)
    }

    /// The next rollout to be collected, and the frames before it.
    fn next(&self) -> (u64, u64) {
        self.in_update.as_ref().map_or((self.rollout, self.frames), |update| (update.rollout + 1, update.frames))
    }

    /// The figures of a collected rollout that its update does not change. PPO-Lagrangian's multiplier takes its step:
    /// by this rollout alone, so that the next one is rewarded with it, whether or not an update runs meanwhile.
    fn known_before_update(
        &mut self,
        position: StagePosition,
        statistics: &RolloutStatistics,
        preempted: u32,
    ) -> BTreeMap<String, f64> {
        let mut metrics = statistics.metrics();
        if self.hurries() {
            metrics.insert(metric::PREEMPTED.to_owned(), f64::from(preempted));
        }
        if self.config.reward(&self.config.stages[position.stage].reward).has_multiplier() {
            self.agent.constrain(statistics.mean_discounted_cost());
            metrics.insert(metric::MULTIPLIER.to_owned(), self.agent.multiplier());
        }
        metrics
    }

    /// Waits for the update that has begun, if there is one, reports it, and saves if that is due.
    fn finish_update(&mut self, state: &mut Loop) -> Result<()> {
        let Some(update) = self.in_update.take() else { return Ok(()) };
        let InUpdate { rollout, frames, stage, ends_stage, metrics: known } = update;
        let waits = Instant::now();
        let mut metrics = match self.agent.finish_update() {
            Ok(metrics) => metrics,
            Err(error @ AgentError::NonFinite { .. }) => {
                // All learners reach this point. The first to exit ends the others, so all wait until every learner
                // has written its dump.
                let dumped = self.dump(rollout, &error.into());
                let _ = self.agent.peers().barrier();
                return Err(dumped.into());
            }
            Err(error) => return Err(error.into()),
        };
        fault::reach("learner.after_update");
        state.timing.update_s = waits.elapsed().as_secs_f64();
        state.timing.exchange_s = self.agent.peers().exchanged()?.seconds;
        metrics.extend(known);
        let before = std::mem::replace(&mut self.frames, frames);
        self.rollout = rollout + 1;

        let timing = state.take_timing();
        self.note(rollout, stage, timing, &metrics);
        fault::reach("learner.before_trained_told");
        self.tell_for_all(|rank| LearnerEvent::RolloutTrained { rank, rollout, frames, stage, timing, metrics });
        let due = self.first_says(state.last_save.elapsed().as_secs_f64() >= self.config.checkpoint.interval_s)?;
        // The orchestrator evaluates that checkpoint. If it cannot be written, the next one is evaluated in its place.
        let complete = position_at(&self.config.stages, frames).is_none() && self.config.validation.every_frames > 0;
        let validated = complete || self.config.validation.is_due(before, frames);
        state.evaluated |= validated;
        if ends_stage || due || validated { self.save_or_go_on(state) } else { Ok(()) }
    }

    /// Abandons the rollout, also if this learner has taken all its steps: the state at its beginning is saved.
    fn break_off(&mut self, state: &mut Loop, end: CutShort) -> Result<()> {
        self.agent.abandon_rollout();
        match end {
            CutShort::Stop(stop) => self.leave(state, Some(stop)),
            CutShort::Fault(error) => {
                // One error is reported at the end: that the state is lost. So the other one is told here.
                self.save_unsaved(state).inspect_err(|_| tracing::error!("{error:#}"))?;
                Err(error)
            }
        }
    }

    /// Saves the state if necessary and reports the end.
    fn leave(&mut self, state: &mut Loop, stop: Option<Stop>) -> Result<()> {
        match stop {
            None => tracing::info!("the budget of {} frames is reached", self.frames),
            Some(Stop::Announced) => tracing::info!("stopped at {} frames, rollout {}", self.frames, self.rollout),
            Some(Stop::OrchestratorGone) => {
                tracing::warn!("the orchestrator is gone: saving at {} frames, rollout {}", self.frames, self.rollout);
            }
        }
        self.save_unsaved(state)?;
        fault::reach("learner.before_finished");
        let weights = self.agent.weights_digest();
        self.conversation.tell(&LearnerEvent::Finished {
            rank: self.conversation.rank,
            frames: self.frames,
            weights,
            complete: stop.is_none(),
        });
        fault::reach("learner.after_finished");
        Ok(())
    }

    /// Saves, unless this very boundary is on disk.
    fn save_unsaved(&mut self, state: &mut Loop) -> Result<()> {
        if self.saved == Some(self.rollout) { Ok(()) } else { self.save(state) }
    }

    /// Saves, or goes on with a warning if the checkpoint cannot be written. What was trained since the last one is in
    /// these processes alone: to end, or to be started again, would lose it, while there may be space by the next time.
    fn save_or_go_on(&mut self, state: &mut Loop) -> Result<()> {
        let error = match self.save(state) {
            Err(error) if error.is::<Unsaved>() => error,
            saved => return saved,
        };
        state.last_save = Instant::now();
        if self.conversation.rank == 0 {
            tracing::warn!(
                "{error:#}. The run goes on and tries again after {} s at the earliest; make room until then: when it \
                 ends, what it trained since its last checkpoint (rollout {}) is lost",
                self.config.checkpoint.interval_s,
                self.saved.unwrap_or(0)
            );
        } else if is_unsaved(&error) {
            // Rank 0 knows only that it was another host.
            tracing::warn!("{error:#}");
        }
        Ok(())
    }

    /// Keeps the figures of a rollout for the next checkpoint, which rank 0 writes.
    fn note(&mut self, rollout: u64, stage: u32, timing: Timing, metrics: &BTreeMap<String, f64>) {
        if self.conversation.rank == 0 {
            let at_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs());
            let (frames, incarnation, metrics) = (self.frames, self.orchestrator, metrics.clone());
            self.figures.insert(Trained {
                rollout,
                frames,
                stage,
                at_unix_s,
                incarnation,
                wall_s: None,
                timing,
                metrics: metrics.into(),
            });
        }
    }

    /// Writes a checkpoint. Rank 0 writes it, with the other learners' parts about their own environments.
    fn save(&mut self, state: &mut Loop) -> Result<()> {
        self.tell_for_all(|rank| LearnerEvent::CheckpointBegun { rank });
        let (peers, weights) = (self.agent.peers(), self.agent.weights_digest());
        let head = u64::from_str_radix(&weights[..16], 16).expect("a digest is hex digits");
        peers.agree("the heads of their weights' digests", head)?;
        let boundary = self.conversation.collector.boundary();
        let mut written = Ok(None);
        // Each host's recordings are seen onto its disk before rank 0 has all parts, and so before the checkpoint counts.
        let synced = if self.conversation.rank > 0 && self.hosts.leads(self.conversation.rank) {
            self.store.sync_recordings()
        } else {
            Ok(())
        };
        let unsynced = if self.hosts.count() > 1 { peers.total(u64::from(synced.is_err()))? } else { 0 };
        synced.map_err(Unsaved::Here)?;
        if unsynced > 0 {
            return Err(Unsaved::OtherHost.into());
        }
        if self.conversation.rank == 0 {
            let Self { rollout, frames, .. } = *self;
            let agent = self.agent.state();
            let mut snapshot = Snapshot { rollout, frames, agent, boundary, weights };
            for part in peers.gather(&[])? {
                snapshot.append(Part::decode(&part)?);
            }
            if let Some(resting) = &self.resting {
                snapshot.append(resting.again());
            }
            written = self.store.save(&snapshot, &self.figures, state.evaluated).map(Some);
        } else {
            peers.gather(&Part { beliefs: self.agent.boundary_beliefs(), boundary }.encode()?)?;
        }
        // A barrier, too: no learner continues or exits before the checkpoint is on disk.
        let mut good = f64::from(u8::from(written.is_ok()));
        peers.first(&mut good)?;
        if let Err(error @ CheckpointError::Foreign { .. }) = written {
            return Err(error.into());
        }
        let written = written.map_err(Unsaved::Here)?;
        if good == 0.0 {
            return Err(Unsaved::Elsewhere.into());
        }
        self.saved = Some(self.rollout);
        (state.last_save, state.evaluated) = (Instant::now(), false);
        if let Some(path) = written {
            fault::reach("learner.before_checkpoint_told");
            let (rollout, frames) = (self.rollout, self.frames);
            self.tell_for_all(|rank| LearnerEvent::CheckpointWritten { rank, rollout, frames, path });
        }
        Ok(())
    }

    /// Says that the rollout is collected: rank 0 for all, and the first learner of each host for its recorder.
    fn tell_collected(&mut self, frames: u64, here: u64) {
        let (rank, rollout) = (self.conversation.rank, self.rollout);
        if self.hosts.leads(rank) {
            self.conversation.tell(&LearnerEvent::RolloutCollected { rank, rollout, frames, here });
        }
    }

    /// Sends an event on behalf of all learners, if this is rank 0.
    fn tell_for_all(&mut self, event: impl FnOnce(u32) -> LearnerEvent) {
        if self.conversation.rank == 0 {
            self.conversation.tell(&event(0));
        }
    }

    /// Rank 0's value, on all learners.
    fn first_says(&self, own: bool) -> Result<bool> {
        let mut word = f64::from(u8::from(own));
        self.agent.peers().first(&mut word)?;
        Ok(word > 0.0)
    }

    /// Whether a learner may have to end its rollout early.
    fn hurries(&self) -> bool {
        self.config.ppo.preemption_share > 0.0 && self.agent.peers().count() > 1
    }

    /// Waits for a rollout's announcement and collects the rollout, or returns why it must be abandoned.
    fn await_and_collect(&mut self, state: &mut Loop, position: StagePosition) -> Result<Option<CutShort>> {
        let version = match self.await_announcement()? {
            Ok(version) => version,
            Err(end) => return Ok(Some(end)),
        };
        if position.frames_in_stage == 0 {
            self.agent.start_stage();
        }
        let composition = self.config.reward(&self.config.stages[position.stage].reward);
        let reward = Reward { composition, multiplier: self.agent.multiplier() as f32 };
        let steps = self.config.ppo.rollout_steps as usize;
        let shape = RolloutShape::next(position.frames_left, steps, self.config.environments());
        let shape = shape.part(self.agent.columns());
        self.agent.begin_rollout(shape);
        self.conversation.collector.go_at(self.pacing.next(state.took));
        self.conversation.collector.begin(shape, reward, version);
        match self.collect(state) {
            Ok(stop) => Ok(stop.map(CutShort::Stop)),
            Err(error) if error.is::<Silent>() => Ok(Some(CutShort::Fault(error))),
            Err(error) => Err(error),
        }
    }

    /// Agrees with the other learners at the end of a rollout on the number of frames collected and on whether all
    /// continue. Every learner calls this once in each rollout, whatever happened to its own part. If one is dead, this
    /// fails.
    fn agree(&mut self, state: &mut Loop, own: Option<CutShort>) -> Result<Agreement> {
        let flag = |condition: bool| f64::from(u8::from(condition));
        let host = self.hosts.of_learner(self.conversation.rank) as usize;
        let mut sums = vec![flag(state.preempted)];
        sums.extend(reasons(own.as_ref()));
        let took = state.agreed.replace(Instant::now()).map(|before| before.elapsed());
        sums.push(took.map_or(0.0, |took| took.as_secs_f64()));
        // Of each host its own, after that.
        let collected = sums.len();
        sums.resize(collected + self.hosts.count() as usize, 0.0);
        sums[collected + host] = self.conversation.collector.collected() as f64;
        self.agent.peers().sum(&mut sums)?;
        let [preempted, announced, gone, faults, all_took] = [sums[0], sums[1], sums[2], sums[3], sums[4]];
        // All have the same number, so all decide alike on what depends on it.
        state.took = took.map(|_| Duration::from_secs_f64(all_took / f64::from(self.agent.peers().count())));
        let of_hosts: Vec<u64> = sums[collected..].iter().map(|&frames| frames as u64).collect();
        Ok(Agreement {
            collected: of_hosts.iter().sum(),
            here: of_hosts[host],
            preempted: preempted as u32,
            end: joint_end(own, [announced, gone, faults]),
        })
    }

    /// Waits until the recording of the collected rollout is written: a rollout is trained on only after that. So
    /// whatever a checkpoint holds is recorded, whichever process is killed later. The first learner of each host waits
    /// for the recorder there, and all go on when all have it. Returns the reason if the rollout must be abandoned.
    fn await_writing(&mut self) -> Result<Option<CutShort>> {
        if !self.config.recording.enabled {
            return Ok(None);
        }
        let own = if self.hosts.leads(self.conversation.rank) { self.await_written()? } else { None };
        let mut sums = reasons(own.as_ref());
        self.agent.peers().sum(&mut sums)?;
        Ok(joint_end(own, sums))
    }

    fn await_written(&mut self) -> Result<Option<CutShort>> {
        match self.conversation.await_written(self.rollout) {
            Ok(stop) => Ok(stop.map(CutShort::Stop)),
            Err(error) if matches!(error.downcast_ref(), Some(Unrecorded::Late { .. })) => {
                Ok(Some(CutShort::Fault(error)))
            }
            Err(error) => Err(error),
        }
    }

    /// Waits until the next rollout is announced. Actors that start meanwhile are served.
    fn await_announcement(&mut self) -> Result<Result<u64, CutShort>> {
        let began = Instant::now();
        loop {
            self.conversation.receive_all()?;
            if let Some(stop) = self.conversation.stop_asked()? {
                return Ok(Err(CutShort::Stop(stop)));
            }
            let left = ANNOUNCEMENT_DEADLINE.saturating_sub(began.elapsed());
            let (rollout, frames) = self.next();
            match self.conversation.announcements.permission(&self.config.stages, rollout, frames)? {
                Permission::Begin { version } => return Ok(Ok(version)),
                Permission::Stop => return Ok(Err(CutShort::Stop(Stop::Announced))),
                Permission::Wait if left.is_zero() => {
                    return Ok(Err(CutShort::Fault(anyhow::anyhow!(
                        "the orchestrator does not answer: rollout {rollout} was not announced within {} s. The run is \
                         saved: end the orchestrator if it still runs, then `orchestrator resume {}`",
                        ANNOUNCEMENT_DEADLINE.as_secs(),
                        quoted(self.run.root())
                    ))));
                }
                Permission::Wait => self.conversation.wait(left),
            }
        }
    }

    /// Collects the rollout in progress, or returns why it must be abandoned.
    fn collect(&mut self, state: &mut Loop) -> Result<Option<Stop>> {
        state.preempted = false;
        loop {
            if self.hurries()
                && let Some([steps, planned]) = self.conversation.collector.between_steps()
                && matches!(self.conversation.collector.task(), Task::Act(_))
                && self.agent.is_preempted(self.rollout, steps, planned)?
            {
                tracing::info!("rollout {} ends after {steps} of {planned} steps: the others wait", self.rollout);
                self.conversation.collector.cut();
                self.agent.cut_rollout(steps);
                state.preempted = true;
            }
            match self.conversation.collector.task() {
                Task::Await => {
                    let began = Instant::now();
                    let stop = self.conversation.await_observations()?;
                    state.timing.simulate_s += began.elapsed().as_secs_f64();
                    if stop.is_some() {
                        return Ok(stop);
                    }
                }
                Task::Act(lanes) => {
                    self.conversation.note_connected();
                    let began = Instant::now();
                    self.look_for_new_actors(state);
                    self.settle(&lanes)?;
                    let batch = self.conversation.collector.batch(&lanes);
                    let output = self.agent.step_each(&batch.at, &batch.input())?;
                    drop(batch);
                    state.timing.infer_s += began.elapsed().as_secs_f64();
                    let began = Instant::now();
                    let stop = self.conversation.answer(&lanes, &output.actions)?;
                    state.timing.simulate_s += began.elapsed().as_secs_f64();
                    if stop.is_some() {
                        return Ok(stop);
                    }
                    if self.conversation.collector.has_first(&lanes) {
                        fault::reach("learner.mid_rollout");
                    }
                }
                Task::Finish => {
                    if self.hurries() && !state.preempted {
                        self.agent.peers().note_finished(self.rollout)?;
                    }
                    return Ok(None);
                }
            }
        }
    }

    fn look_for_new_actors(&mut self, state: &mut Loop) {
        let starts = self.conversation.collector.actor_starts();
        if std::mem::replace(&mut state.actor_starts, starts) != starts {
            self.agent.recheck_memory();
        }
    }

    fn settle(&mut self, lanes: &[Lane]) -> Result<(), AgentError> {
        for Settled { t, column, outcome, last_seen } in self.conversation.collector.settle(lanes) {
            self.agent.record(t, column, outcome);
            if let Some(numbers) = last_seen {
                self.agent.value_last(t, column, &numbers)?;
            }
        }
        Ok(())
    }

    fn dump(&self, rollout: u64, error: &anyhow::Error) -> NonFinite {
        let mut tensors = self.agent.state().tensors;
        tensors.extend(self.agent.rollout_tensors());
        NonFinite::dumped(rollout, error, &self.run.nonfinite_dump(rollout, self.conversation.rank), &tensors)
    }
}

impl Loop {
    fn new() -> Self {
        let now = Instant::now();
        Self {
            last_save: now,
            began: now,
            timing: Timing::default(),
            agreed: None,
            took: None,
            preempted: false,
            evaluated: false,
            actor_starts: 0,
        }
    }

    /// Returns the timing of the rollout that is through, and starts the next one's. Time in no other category counts
    /// as "other"; that of a checkpoint, which is written afterwards, is the next rollout's.
    fn take_timing(&mut self) -> Timing {
        let mut timing = std::mem::take(&mut self.timing);
        let total_s = std::mem::replace(&mut self.began, Instant::now()).elapsed().as_secs_f64();
        timing.other_s = (total_s - timing.total_s()).max(0.0);
        timing
    }
}
