//! `learner evaluate`: plays the fixed episodes of an evaluation with the weights of a checkpoint, and tells what came
//! of each. It trains on nothing and writes nothing.
//!
//! A learner that is started again begins again: the same weights, episodes and noise give the same records.

use super::announcements::Announcements;
use super::control::Control;

use super::stop::{OrchestratorGone, Stop};
use super::wire::{Ports, Sample};
use super::{lifeline, weights};
use crate::agent::Agent;
use crate::collector::{Boundary, Collector, Layout, Received, Reward, Settings, Task};
use crate::evaluation::Examination;
use crate::{device, ffi};
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::control::LearnerEvent;
use proto::fault;
use proto::reward::RewardKind;
use proto::run_folder::RunFolder;
use proto::stage::RolloutShape;
use proto::wire::{WireAddress, WireShape};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longest sleep without a look at lifeline and announcements.
const LOOK: Duration = Duration::from_millis(50);
/// An actor that has not answered for this long is told of, and again after each [`NOTICE_INTERVAL`].
const FIRST_NOTICE: Duration = Duration::from_secs(2);
const NOTICE_INTERVAL: Duration = Duration::from_secs(10);
/// This machine's learner is the only one.
const RANK: u32 = 0;

/// What an evaluation is started with.
#[derive(Debug, Clone)]
pub struct EvaluationArguments {
    /// Folder of the evaluation; its config.toml is the configuration.
    pub folder: PathBuf,
    /// Where its services live.
    pub wire: WireAddress,
    /// How often this learner has been started under this wire address, from 1.
    pub incarnation: u32,
    /// Standard input is a lifeline.
    pub lifeline: bool,
}

/// Plays all episodes, or as many as a stop allows.
pub fn evaluate(arguments: EvaluationArguments) -> Result<()> {
    let EvaluationArguments { folder, wire, incarnation, lifeline: has_lifeline } = arguments;
    let gone = OrchestratorGone::default();
    if has_lifeline {
        ffi::ignore_interrupt();
        lifeline::watch(std::io::stdin(), gone.clone()).context("cannot watch the lifeline")?;
    }
    let path = RunFolder::new(folder).config();
    let text =
        std::fs::read_to_string(&path).with_context(|| format!("cannot read configuration {}", path.display()))?;
    let config = Config::from_toml(&text, &path.display().to_string())?;
    let (Some(asked), Some(plan)) = (&config.evaluation, config.evaluation_plan()) else {
        bail!("{} has no table [evaluation]: it is the configuration of a run", path.display());
    };

    let device = device::choose(config.learner.device, config.learner.threads)?;
    let mut agent = Agent::new(&config, device)?;
    let (rollout, frames) = match &asked.checkpoint {
        None => (0, 0),
        Some(checkpoint) => {
            let manifest = weights::load(&mut agent, Path::new(checkpoint))?;
            (manifest.rollout, manifest.frames)
        }
    };
    let (actors, environments_per_actor) = (config.actors.count, config.actors.environments_per_actor);
    let layout = Layout::new(0, actors, environments_per_actor).in_kitchens(config.kitchens());
    let policy_actions = config.episode.action_space.actions().len();
    let settings = Settings {
        layout,
        seed: config.seed,
        policy_actions,
        max_episode_steps: config.episode.max_steps,
        gamma: config.ppo.gamma,
        learner_incarnation: incarnation,
    };
    let seed = (!asked.deterministic).then_some(config.seed);
    let examination = Examination::new(plan, layout, config.reward.lambda_disturb, seed, policy_actions);
    let ports = Ports::open(&wire, WireShape { actors, environments_per_actor }, "learner-0")?;
    let mut control = Control::new(std::io::stdout(), gone.clone());
    control.tell(&LearnerEvent::Ready {
        rank: RANK,
        rollout,
        frames,
        device: device::describe(device),
        parameters: agent.parameter_count(),
        checkpoint: asked.checkpoint.clone(),
    });
    let collector = Collector::new(settings, Boundary::start(layout.columns()));
    Room { config, agent, examination, collector, ports, control, gone, announcements: Announcements::default() }.run()
}

/// Where episodes are played.
struct Room<W> {
    config: Config,
    agent: Agent,
    examination: Examination,
    collector: Collector<Sample>,
    ports: Ports,
    control: Control<W>,
    gone: OrchestratorGone,
    announcements: Announcements,
}

impl<W: Write> Room<W> {
    fn run(mut self) -> Result<()> {
        let columns = self.config.environments();
        // To the collector an evaluation is one rollout without an end. No reward of it is used.
        let endless = RolloutShape { steps: usize::MAX, environments_in_last_step: columns, frames: u64::MAX };
        let reward = Reward { kind: RewardKind::Task, disturbance_weight: self.config.reward.lambda_disturb };
        self.collector.begin(endless, reward, 0);
        for actor in 0..self.config.actors.count {
            self.restore(actor, 0)?;
        }
        let mut connected = false;
        while self.examination.remaining() > 0 {
            match self.collector.task() {
                Task::Await { half: _ } => {
                    if let Some(stop) = self.await_observations()? {
                        self.leave(Some(stop));
                        return Ok(());
                    }
                }
                Task::Act { half, t: _ } => {
                    if !std::mem::replace(&mut connected, true) {
                        self.control.tell(&LearnerEvent::ActorsConnected { rank: RANK });
                    }
                    self.settle(half);
                    self.act(half)?;
                    if half == 0 {
                        fault::reach("learner.mid_evaluation");
                    }
                }
                Task::Bootstrap { .. } | Task::Finish => unreachable!("a rollout without an end does not end"),
            }
        }
        self.leave(None);
        Ok(())
    }

    /// Takes in what the half's last actions did.
    fn settle(&mut self, half: u32) {
        let acted = self.collector.settle(half).into_iter().map(|settled| settled.column).collect::<Vec<_>>();
        let mut acted = acted.into_iter().peekable();
        for (column, transition) in self.collector.transitions(half) {
            // Both ascend.
            if acted.next_if_eq(&column).is_none() {
                continue;
            }
            if let Some((record, actions)) = self.examination.settle(column, transition) {
                self.control.tell(&LearnerEvent::EpisodePlayed { record, actions });
            }
        }
    }

    fn act(&mut self, half: u32) -> Result<()> {
        let batch = self.collector.batch_with(half, |place, noise| self.examination.noise(place, noise));
        let input = batch.input();
        let choice = self.agent.act(&input)?;
        let mut actions = Vec::with_capacity(choice.actions.len());
        for (row, (&column, &action)) in input.columns.iter().zip(&choice.actions).enumerate() {
            let foretold = choice.disturbs.as_ref().map(|disturbs| disturbs[row]);
            actions.push(self.examination.choose(column, action, foretold));
        }
        drop(batch);
        for batch in self.collector.answer(half, &actions) {
            self.ports.send_actions(&batch)?;
        }
        Ok(())
    }

    /// Receives until the half whose turn it is is complete.
    fn await_observations(&mut self) -> Result<Option<Stop>> {
        let began = Instant::now();
        let deadline_s = self.config.learner.actor_deadline_s;
        let mut notice = FIRST_NOTICE;
        loop {
            while let Some((header, sample)) = self.ports.receive()? {
                if let Received::Hello { actor, actor_incarnation } = self.collector.receive(&header, sample)? {
                    self.restore(actor, actor_incarnation)?;
                }
            }
            for announcement in self.ports.announcements()? {
                self.announcements.hear(announcement);
            }
            if self.gone.is_set() {
                return Ok(Some(Stop::OrchestratorGone));
            }
            if self.announcements.stop() {
                return Ok(Some(Stop::Announced));
            }
            let missing = self.collector.missing();
            if missing.is_empty() {
                return Ok(None);
            }
            let waited = began.elapsed();
            if waited.as_secs_f64() >= deadline_s {
                bail!("actors {missing:?} did not answer within {deadline_s:.0} s (learner.actor_deadline_s)");
            }
            if waited >= notice {
                notice = waited + NOTICE_INTERVAL;
                let waited_s = waited.as_secs_f64();
                for actor in missing {
                    self.control.tell(&LearnerEvent::WaitingForActor { rank: RANK, actor, waited_s });
                }
            }
            self.ports.wait(LOOK)?;
        }
    }

    fn restore(&self, actor: u32, actor_incarnation: u32) -> Result<()> {
        let (header, states) = self.collector.restore(actor, actor_incarnation);
        self.ports.send_restore(actor, header, &states)
    }

    fn leave(&mut self, stop: Option<Stop>) {
        match stop {
            None => tracing::info!("all episodes are played"),
            Some(stop) => tracing::info!("{} episodes are left: {stop:?}", self.examination.remaining()),
        }
        let weights = self.agent.weights_digest();
        self.control.tell(&LearnerEvent::Finished { rank: RANK, frames: 0, weights, complete: stop.is_none() });
    }
}
