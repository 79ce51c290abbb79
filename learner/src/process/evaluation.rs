//! `learner evaluate`: runs the episodes of an evaluation with the weights of a checkpoint, and reports the result of
//! each. It does not train and writes no files.
//!
//! A restarted learner begins again: the same weights, episodes and noise give the same records.

use super::conversation::{Conversation, Speaker};
use super::link::Ports;
use super::output::claim_stdout;
use super::stop::{OrchestratorGone, Stop};
use super::weights::{self, Trained};
use crate::agent::Agent;
use crate::collector::{Boundary, ColumnMap, Lane, Reward, Task};
use crate::device;
use crate::evaluation::Examination;
use anyhow::{Result, bail};
use proto::config::Config;
use proto::event::LearnerEvent;
use proto::run_folder::RunFolder;
use proto::stage::RolloutShape;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use wire::{WireAddress, fault};

/// Time to end once the orchestrator is gone: there is nothing to save.
const LAST: Duration = Duration::from_mins(1);
/// This machine's learner is the only one.
const RANK: u32 = 0;

#[derive(Debug, Clone)]
pub struct EvaluationArguments {
    pub folder: PathBuf,
    pub wire: WireAddress,
    /// How often this learner has been started under this wire address, from 1.
    pub incarnation: u32,
    /// Standard input is a lifeline.
    pub lifeline: bool,
}

/// Plays all episodes, or as many as a stop allows.
pub fn evaluate(arguments: EvaluationArguments) -> Result<()> {
    let EvaluationArguments { folder, wire, incarnation, lifeline } = arguments;
    let output = claim_stdout()?;
    let gone = OrchestratorGone::watched(lifeline)?;
    gone.end_after(LAST, || {
        tracing::error!("the orchestrator is gone, and there was time to end: this learner ends");
        // Without destructors: those of the GPU would wait for a hanging operation.
        std::process::abort();
    })?;
    let folder = RunFolder::new(folder);
    let config = Config::of_run(&folder)?;
    let (Some(asked), Some(plan)) = (&config.evaluation, config.evaluation_plan()) else {
        bail!("{} has no table [evaluation]: it is the configuration of a run", folder.config().display());
    };

    let device = device::choose(&config.learner)?;
    let mut agent = Agent::new(&config, device)?;
    let Trained { rollout, frames } = match &asked.checkpoint {
        None => Trained { rollout: 0, frames: 0 },
        Some(from) => weights::load_any(&mut agent, Path::new(from))?,
    };
    let column_map = ColumnMap::of(RANK, &config);
    let seed = (!asked.deterministic).then_some(config.seed);
    let examination = Examination::new(plan, column_map, &config, seed);
    let ports = Ports::open(&wire, &config, RANK)?;
    let speaker = Speaker { rank: RANK, incarnation, ports: &ports, gone: &gone };
    let boundary = Boundary::start(column_map.columns());
    let mut conversation = Conversation::open(speaker, &config, agent.shards(), boundary, output);
    conversation.tell(&LearnerEvent::Ready {
        rank: RANK,
        rollout,
        frames,
        device: agent.device(),
        parameters: agent.parameter_count(),
        checkpoint: asked.checkpoint.clone(),
    });
    let tempo = Tempo::of(asked.steps_per_s);
    Room { config, tempo, agent, examination, conversation }.run()
}

/// An actor's environments are in so many halves at most.
const HALVES_MOST: usize = 2;

/// Holds steps back, so that somebody can watch.
struct Tempo {
    period: Duration,
    /// When the next step of each half may be taken.
    due: [Instant; HALVES_MOST],
}

impl Tempo {
    fn of(steps_per_s: Option<u32>) -> Self {
        let period = steps_per_s.map_or(Duration::ZERO, |steps| Duration::from_secs(1) / steps);
        Self { period, due: [Instant::now(); HALVES_MOST] }
    }

    /// Waits for a step at most: a stop is noticed after that.
    fn keep(&mut self, half: u32) {
        if self.period.is_zero() {
            return;
        }
        let due = &mut self.due[half as usize];
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        // Whoever was late is not to hurry.
        *due = Instant::now().max(*due) + self.period;
    }
}

struct Room<'a, W> {
    config: Config,
    tempo: Tempo,
    agent: Agent,
    examination: Examination,
    conversation: Conversation<'a, W>,
}

impl<W: Write> Room<'_, W> {
    fn run(mut self) -> Result<()> {
        let columns = self.config.environments();
        // To the collector an evaluation is one rollout without an end. No reward of it is used.
        let endless = RolloutShape { steps: usize::MAX, environments_in_last_step: columns, frames: u64::MAX };
        let reward = Reward { composition: self.config.reward(&self.config.stages[0].reward), multiplier: 0.0 };
        self.conversation.collector.begin(endless, reward, 0);
        self.conversation.restore_all()?;
        while self.examination.remaining() > 0 {
            match self.conversation.collector.task() {
                Task::Await => {
                    if let Some(stop) = self.conversation.await_observations()? {
                        self.leave(Some(stop));
                        return Ok(());
                    }
                }
                Task::Act(lanes) => {
                    self.conversation.note_connected();
                    self.settle(&lanes);
                    let stop = match self.examination.remaining() {
                        // The last outcomes, too, are recorded before all processes leave.
                        0 => self.conversation.await_receipts(&lanes)?,
                        _ => self.act(&lanes)?,
                    };
                    if stop.is_some() {
                        self.leave(stop);
                        return Ok(());
                    }
                    if lanes[0].half == 0 {
                        fault::reach("learner.mid_evaluation");
                    }
                }
                Task::Finish => unreachable!("a rollout without an end does not end"),
            }
        }
        self.leave(None);
        Ok(())
    }

    /// Records the outcomes of a half's last actions, and reports the episodes that ended.
    fn settle(&mut self, lanes: &[Lane]) {
        let collector = &mut self.conversation.collector;
        let acted: Vec<usize> = collector.settle(lanes).into_iter().map(|settled| settled.column).collect();
        let mut acted = acted.into_iter().peekable();
        let mut played = vec![];
        for (column, record) in collector.records(lanes) {
            // Both ascend.
            if acted.next_if_eq(&column).is_some() {
                played.extend(self.examination.settle(column, record));
            }
        }
        for (record, actions) in played {
            self.conversation.tell(&LearnerEvent::EpisodePlayed { record, actions });
        }
    }

    fn act(&mut self, lanes: &[Lane]) -> Result<Option<Stop>> {
        let collector = &self.conversation.collector;
        let batch = collector.batch_with(lanes, |place, noise| self.examination.noise(place, noise));
        let input = batch.input();
        let choice = self.agent.act(&input)?;
        let mut actions = Vec::with_capacity(choice.actions.len());
        let bytes = choice.actions.len() / input.columns.len();
        for (row, (&column, action)) in input.columns.iter().zip(choice.actions.chunks_exact(bytes)).enumerate() {
            let foretold = choice.foretold.as_ref().map(|foretold| foretold[row]);
            actions.extend_from_slice(self.examination.choose(column, action, foretold));
        }
        drop(batch);
        // In lockstep all are of one half.
        self.tempo.keep(lanes[0].half);
        self.conversation.answer(lanes, &actions)
    }

    fn leave(&mut self, stop: Option<Stop>) {
        match stop {
            None => tracing::info!("all episodes are played"),
            Some(stop) => tracing::info!("{} episodes are left: {stop:?}", self.examination.remaining()),
        }
        let weights = self.agent.weights_digest();
        self.conversation.tell(&LearnerEvent::Finished { rank: RANK, frames: 0, weights, complete: stop.is_none() });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_held_back_for_somebody_who_watches_and_for_nobody_else() {
        let mut tempo = Tempo::of(Some(50));
        let began = Instant::now();
        for half in [0, 1, 0, 1, 0] {
            tempo.keep(half);
        }
        // The first step of each half is taken at once.
        assert!(began.elapsed() >= 2 * Duration::from_millis(20));
        let mut none = Tempo::of(None);
        none.keep(0);
        assert_eq!(none.period, Duration::ZERO);
    }
}
