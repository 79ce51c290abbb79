//! A small agent's configuration, and the stand-in for what it acts on.

use crate::shared::{depth_mm, goal_m, noise, noise_f32};
use learner::agent::{Agent, AgentError, StepInput, StepOutput};
use learner::network::RawFrame;
use learner::rollout::Outcome;
use proto::camera::DepthFrame;
use proto::config::{Config, Encoder, Memory, PpoConfig};
use proto::stage::RolloutShape;
use proto::task::{ActionSpace, Dtype, Image, Spec};
use std::collections::BTreeMap;
use std::ops::Range;
use tch::Tensor;
use wire::message::Halves;

/// No action yet.
const NO_ACTION: u8 = 255;

/// A world of noise that an agent acts in: the script's `run_fixture`.
pub struct World {
    columns: usize,
    /// Numbers of an observation, and actions.
    width: usize,
    actions: usize,
    has_frame: bool,
    is_masked: bool,
    images: Vec<Image>,
    /// Columns of the agent that acts, of all.
    own: Range<usize>,
    /// Those of either half of a step.
    halves: [Vec<usize>; 2],
    pub steps: usize,
    /// Steps that a rollout is planned with; it is cut after `steps`.
    pub planned: usize,
    pub previous: Vec<u8>,
    /// Discounted sums of rewards are so many times a reward: any numbers of their size.
    pub returns: f64,
}

pub fn small_config() -> Config {
    let mut config = Config::default();
    config.actors.count = 2;
    config.actors.environments_per_actor = 2;
    config.network.encoder = Encoder::Cnn;
    config.network.input_pool = 4;
    config.network.hidden = 32;
    config.episode.action_space = ActionSpace::named("small").expect("the task has it");
    config.ppo.rollout_steps = 6;
    config.ppo.epochs = 2;
    config.ppo.learning_rate = 1e-3;
    config.ppo.environments_per_pass = 3;
    config
}

/// The same of a task without a frame.
pub fn numbers_config(memory: Memory) -> Config {
    Spec::declare(include_str!("../support/numbers.toml")).expect("a sound task");
    let mut config =
        Config::resolve_with("gym", Some(("task = \"numbers\"", "a test"))).expect("the preset is for such tasks");
    let small = small_config();
    (config.actors, config.ppo) = (small.actors, PpoConfig { normalize_advantages: true, ..small.ppo });
    config.network.memory = memory;
    config.network.hidden = small.network.hidden;
    config.network.mlp = vec![24, 16];
    config
}

/// The same where the critic alone is given where the door is.
pub fn privileged_config(memory: Memory) -> Config {
    let text = include_str!("../support/numbers.toml").replacen("\"numbers\"", "\"privileged_numbers\"", 1);
    let [observed, privileged] = ["observation", "privileged"].map(|role| format!("\"door\"\nrole = \"{role}\""));
    Spec::declare(&text.replacen(&observed, &privileged, 1)).expect("a sound task");
    Config { task: "privileged_numbers".to_owned(), ..numbers_config(memory) }
}

/// The same with a mask.
pub fn masked_config(memory: Memory) -> Config {
    let mask = "[[channels]]\nname = \"action_mask\"\nrole = \"mask\"\ndtype = \"u8\"\nshape = [3]\ndoc = \"\"\n";
    let text = include_str!("../support/numbers.toml").replacen("\"numbers\"", "\"masked_numbers\"", 1);
    Spec::declare(&(text + mask)).expect("a sound task");
    Config { task: "masked_numbers".to_owned(), ..numbers_config(memory) }
}

impl World {
    pub fn new(config: &Config) -> Self {
        Self::of_learner(config, 0..config.environments())
    }

    /// As much of it as one of several learners sees.
    pub fn of_learner(config: &Config, own: Range<usize>) -> Self {
        let columns = config.environments();
        let steps = config.ppo.rollout_steps as usize;
        let halves = [(0..columns / 2).collect(), (columns / 2..columns).collect()];
        let inputs = config.spec().inputs().expect("networks can take it");
        let (width, has_frame) = (inputs.width(), inputs.frame.is_some());
        let (actions, previous) = (config.policy_actions().len(), vec![NO_ACTION; columns]);
        let (is_masked, images) = (config.spec().mask().is_some(), inputs.images);
        let (planned, returns) = (steps, 20.0);
        Self { columns, width, actions, has_frame, is_masked, images, own, halves, steps, planned, previous, returns }
    }

    /// The same, with a half of each actor's environments in either half, as in a run.
    #[must_use]
    pub fn in_halves_of_actors(self, environments_per_actor: u32) -> Self {
        let halves = Halves::of(environments_per_actor);
        let of = |half: u32| {
            let within = |column: &usize| halves.range(half).contains(&(column % environments_per_actor as usize));
            if half < halves.count() { (0..self.columns).filter(within).collect() } else { vec![] }
        };
        Self { halves: [of(0), of(1)], ..self }
    }

    /// Acts through a rollout, in two halves a step; the last step has `last` columns.
    pub fn collect(&mut self, agent: &mut Agent, rollout: usize, last: usize) -> Result<Vec<StepOutput>, AgentError> {
        let (columns, steps, own) = (self.columns, self.steps, self.own.clone());
        let actions = self.actions;
        let frames = ((self.planned - 1) * columns + last) as u64;
        let shape = RolloutShape { steps: self.planned, environments_in_last_step: last, frames }.part(own.clone());
        agent.begin_rollout(shape);
        let mut outputs = vec![];
        for t in 0..steps.min(shape.steps) {
            let now = rollout * steps + t;
            let gumbel: Vec<f32> = noise(&format!("gumbel.{now}"), columns * actions)
                .into_iter()
                .map(|value| (-(-(value * 0.5 + 0.5).clamp(1e-6, 1.0 - 1e-6).ln()).ln()) as f32)
                .collect();
            let ended = noise(&format!("ended.{now}"), columns);
            let limit = noise(&format!("limit.{now}"), columns);
            let reward = noise_f32(&format!("reward.{now}"), columns);
            let disturbed = noise(&format!("disturbed.{now}"), columns);
            let mut whole = StepOutput::default();
            for half in self.halves.clone() {
                let half: Vec<usize> = half.into_iter().filter(|n| own.contains(n)).collect();
                if half.is_empty() {
                    continue;
                }
                let output = self.see(agent, now, &half, |agent, input| {
                    let gumbel: Vec<f32> =
                        half.iter().flat_map(|n| &gumbel[n * actions..(n + 1) * actions]).copied().collect();
                    agent.step(t, &StepInput { gumbel: &gumbel, ..*input })
                })?;
                for (&n, &action) in half.iter().zip(&output.actions) {
                    if t + 1 < steps || n < last {
                        let ended = ended[n] > 0.5;
                        agent.record(
                            t,
                            n - own.start,
                            Outcome {
                                reward: reward[n] * 3.0,
                                ended,
                                time_limit: ended && limit[n] > 0.0,
                                discounted_return: f64::from(reward[n]) * self.returns,
                                label: disturbed[n] > 0.4,
                            },
                        );
                        if ended && limit[n] > 0.0 && !self.has_frame && self.images.is_empty() {
                            let last = noise_f32(&format!("last.{now}.{n}"), self.width);
                            agent.value_last(t, n - own.start, &last)?;
                        }
                        self.previous[n] = if ended { NO_ACTION } else { action };
                    }
                }
                whole.actions.extend(output.actions);
                whole.log_probs.extend(output.log_probs);
                whole.values.extend(output.values);
            }
            outputs.push(whole);
        }
        if self.planned > steps {
            agent.cut_rollout(steps);
        }
        // Where none of its columns acts in the last step, a learner is a step short.
        let (seen, waiting) = if shape.steps < self.planned { (shape.steps, columns) } else { (steps, last) };
        for half in &self.halves {
            let waiting: Vec<usize> = half.iter().copied().filter(|n| own.contains(n) && *n < waiting).collect();
            if !waiting.is_empty() {
                self.see(agent, rollout * steps + seen, &waiting, Agent::bootstrap)?;
            }
        }
        Ok(outputs)
    }

    /// Noise in each image.
    fn images_of(&self, now: usize, n: usize) -> impl Iterator<Item = Vec<u8>> {
        self.images.iter().map(move |image| {
            let noise = noise_f32(&format!("{}.{now}.{n}", image.name), image.field.count);
            let noise = noise.iter();
            match image.field.dtype {
                Dtype::F32 => noise.flat_map(|number| number.to_ne_bytes()).collect(),
                Dtype::U16 => noise.flat_map(|number| (((number + 1.0) * 32767.0) as u16).to_ne_bytes()).collect(),
                _ => noise.map(|number| ((number + 1.0) * 127.0) as u8).collect(),
            }
        })
    }

    pub fn see<T>(
        &self,
        agent: &mut Agent,
        now: usize,
        columns: &[usize],
        act: impl FnOnce(&mut Agent, &StepInput) -> T,
    ) -> T {
        let frames: Vec<Box<RawFrame>> = columns.iter().filter(|_| self.has_frame).map(|&n| depth_mm(now, n)).collect();
        let frames: Vec<DepthFrame> = frames.iter().map(|frame| DepthFrame::Whole(frame)).collect();
        let numbers = |n| match self.width {
            3 => goal_m(now, n).to_vec(),
            width => noise_f32(&format!("numbers.{now}.{n}"), width),
        };
        let numbers: Vec<f32> = columns.iter().flat_map(|&n| numbers(n)).collect();
        let images: Vec<Vec<u8>> = columns.iter().flat_map(|&n| self.images_of(now, n)).collect();
        let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
        let previous_action: Vec<u8> = columns.iter().map(|&n| self.previous[n]).collect();
        let episode_start: Vec<bool> = previous_action.iter().map(|&action| action == NO_ACTION).collect();
        let masks: Vec<bool> =
            columns.iter().filter(|_| self.is_masked).flat_map(|&n| mask(now, n, self.actions)).collect();
        let places: Vec<usize> = columns.iter().map(|n| n - self.own.start).collect();
        let input = StepInput {
            columns: &places,
            frames: &frames,
            images: &images,
            numbers: &numbers,
            previous_action: &previous_action,
            episode_start: &episode_start,
            masks: &masks,
            gumbel: &[],
        };
        act(agent, &input)
    }
}

/// Which options may be chosen: at least one.
pub fn mask(now: usize, n: usize, options: usize) -> Vec<bool> {
    let drawn = noise(&format!("mask.{now}.{n}"), options);
    (0..options).map(|option| drawn[option] > 0.2 || option == (now + n) % options).collect()
}

pub fn weights_of(agent: &Agent) -> BTreeMap<String, Tensor> {
    let weights = agent.state().tensors;
    weights.into_iter().filter_map(|(name, tensor)| Some((name.strip_prefix("model.")?.to_owned(), tensor))).collect()
}
