//! What an undisturbed run is, computed in a few loops without processes, messages or time: what every rollout holds,
//! the weights after it, and every step that must be in the recording.

use crate::environment::{FakeEnvironment, mix};
use crate::setup::{ACTIONS, MAX_STEPS, NOISE, Setup};
use learner::collector::{Noise, Signals};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::record::{End, HOLD, RecordHeader, flag};
use proto::stage::{RolloutShape, position_at, total_frames};
use std::collections::BTreeMap;
use wire::message::{EnvironmentState, Line};

/// The weights that a run begins with.
pub const FIRST_WEIGHTS: u64 = 1;

/// A step of the run: column, episode, step.
pub type StepName = (u32, u32, u32);

/// A rollout as it must be.
#[derive(Debug, Clone)]
pub struct Expected {
    /// Frames that were trained before it.
    pub before: u64,
    /// By column: a digest of all that was seen, done and got in it.
    pub digests: Vec<u64>,
    /// Weights after it.
    pub weights: u64,
}

#[derive(Debug)]
pub struct Model {
    pub rollouts: Vec<Expected>,
    /// Every step, with the hash of the state that it led to.
    pub steps: BTreeMap<StepName, u64>,
    pub frames: u64,
}

/// What the policy is given, as one number.
pub fn look(numbers: &[f32], noise: &[f32], previous_action: u8, start: bool) -> u64 {
    let numbers = numbers.iter().chain(noise).map(|value| u64::from(value.to_bits()));
    mix(numbers.chain([u64::from(previous_action), u64::from(start)]))
}

/// The policy.
pub fn choose(weights: u64, seen: u64) -> u8 {
    (mix([weights, seen]) % ACTIONS) as u8
}

/// What an action adds to its column's digest.
pub fn of_action(t: usize, column: usize, action: u8, seen: u64) -> u64 {
    mix([1, t as u64, column as u64, u64::from(action), seen])
}

pub fn of_outcome(t: usize, column: usize, reward: f32, [ended, time_limit, disturbed]: [bool; 3]) -> u64 {
    let flags = [ended, time_limit, disturbed].map(u64::from);
    mix([2, t as u64, column as u64, u64::from(reward.to_bits())].into_iter().chain(flags))
}

/// What the last observation adds.
pub fn of_bootstrap(column: usize, seen: u64) -> u64 {
    mix([3, column as u64, seen])
}

/// The weights after an update with the digests of all columns added up: of 53 bits, which a double holds.
pub fn updated(weights: u64, sum: u64) -> u64 {
    mix([weights, sum]) >> 11
}

fn seen_by(config: &Config, id: EnvironmentId, environment: &FakeEnvironment) -> u64 {
    let lines = environment.observe(0);
    let record = Line::bytes(&lines);
    let (header, layout) = (RecordHeader::of(record), config.spec().layout());
    let mut noise = vec![];
    Noise::Gumbel(NOISE).draw(config.seed, id, header.episode, header.step, &mut noise);
    let (_, goal) = config.spec().channel("goal_m").expect("the task has it");
    let start = header.has(flag::EPISODE_START);
    look(goal.of(record), &noise, record[layout.previous_action.offset], start)
}

impl Model {
    /// The run of a setup, undisturbed.
    pub fn of(setup: &Setup) -> Self {
        let config = &setup.config;
        let signals = Signals::of(config);
        let (actors, each) = (config.actors.count, config.actors.environments_per_actor);
        let ids: Vec<EnvironmentId> = (0..actors)
            .flat_map(|actor| (0..each).map(move |index| (actor, index)))
            .map(|(actor, index)| EnvironmentId::among(config.kitchens(), actor, index, each))
            .collect();
        let start = EnvironmentState::start_of(0);
        let mut environments: Vec<FakeEnvironment> =
            ids.iter().map(|&id| FakeEnvironment::rebuild(config.spec(), id, MAX_STEPS, &start)).collect();
        let mut model = Self { rollouts: vec![], steps: BTreeMap::new(), frames: total_frames(&config.stages) };
        let (mut frames, mut weights, mut acting) = (0, FIRST_WEIGHTS, FIRST_WEIGHTS);
        while let Some(position) = position_at(&config.stages, frames) {
            let composition = config.reward(&config.stages[position.stage].reward);
            let shape = RolloutShape::next(position.frames_left, config.ppo.rollout_steps as usize, ids.len());
            let mut digests = vec![0_u64; ids.len()];
            for t in 0..shape.steps {
                for (column, environment) in environments.iter_mut().enumerate() {
                    if t + 1 == shape.steps && column >= shape.environments_in_last_step {
                        environment.act(HOLD);
                        continue;
                    }
                    let seen = seen_by(config, ids[column], environment);
                    let action = choose(acting, seen);
                    environment.act(action);
                    let lines = environment.observe(0);
                    let record = Line::bytes(&lines);
                    let header = RecordHeader::of(record);
                    let part = |index| config.spec().layout().part(record, index);
                    let value = composition.of(part, 0.0);
                    let (end, label) = (header.end(), signals.label.is_some_and(|label| label.holds(part)));
                    let outcome = [end.is_some(), end == Some(End::Truncated), label];
                    let gained = of_action(t, column, action, seen).wrapping_add(of_outcome(t, column, value, outcome));
                    digests[column] = digests[column].wrapping_add(gained);
                    let fresh = model
                        .steps
                        .insert((column as u32, header.acted_episode, header.acted_step), header.outcome_hash);
                    assert!(fresh.is_none(), "a run takes every step once");
                }
            }
            for (column, environment) in environments.iter().enumerate() {
                let seen = seen_by(config, ids[column], environment);
                digests[column] = digests[column].wrapping_add(of_bootstrap(column, seen));
            }
            let sum = digests.iter().fold(0, |sum: u64, digest| sum.wrapping_add(*digest));
            let before = weights;
            weights = updated(before, sum);
            acting = if config.ppo.overlap { before } else { weights };
            model.rollouts.push(Expected { before: frames, digests, weights });
            frames += shape.frames;
        }
        model
    }

    /// Weights of a run that is complete.
    pub fn last_weights(&self) -> u64 {
        self.rollouts.last().map_or(FIRST_WEIGHTS, |rollout| rollout.weights)
    }
}
