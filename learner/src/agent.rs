//! The agent: network, beliefs, rollout and optimiser behind one struct.

use proto::config::Config;
use proto::message::FRAME_PIXELS;
use proto::stage::RolloutShape;
use std::collections::BTreeMap;
use tch::{Device, Tensor};

/// What the policy sees of some columns in one step. All slices have one entry a column, in the same order.
#[derive(Debug, Clone, Copy)]
pub struct StepInput<'a> {
    /// Columns (actor · environments per actor + environment), ascending.
    pub columns: &'a [usize],
    /// Depth frames, millimetres, row-major; may point into shared memory.
    pub frames: &'a [&'a [u16; FRAME_PIXELS]],
    /// Wrist→object, or object→goal once the target is held; robot's frame, metres.
    pub goal_m: &'a [[f32; 3]],
    /// `A_large` index of the previous action, or `NO_ACTION`.
    pub previous_action: &'a [u8],
    /// True at an episode's first observation: the belief is zeroed before it is used.
    pub episode_start: &'a [bool],
    /// Gumbel noise, `columns.len() * actions`: the action is argmax(logits + noise).
    pub gumbel: &'a [f32],
}

/// What the policy chose, one entry a column of the input.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StepOutput {
    /// `A_large` indices.
    pub actions: Vec<u8>,
    /// Log-probability of the action.
    pub log_probs: Vec<f32>,
    /// Value of the observation.
    pub values: Vec<f32>,
}

/// What an action led to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Reward under the stage in force.
    pub reward: f32,
    /// The episode ended, for whatever reason.
    pub ended: bool,
    /// It ended by the step limit.
    pub time_limit: bool,
    /// Label of the auxiliary task: this action disturbed something.
    pub disturbed: bool,
}

/// What went wrong in the agent.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// A number that should be finite is not. Weights and optimiser are as they were before the update.
    #[error("{what} is not finite")]
    NonFinite {
        /// Which number.
        what: String,
    },
    /// A saved state does not fit this agent.
    #[error("the saved state does not fit: {0}")]
    State(String),
    /// Libtorch reported an error.
    #[error(transparent)]
    Torch(#[from] tch::TchError),
}

/// Everything of an agent that a checkpoint keeps, on the CPU.
#[derive(Debug)]
pub struct AgentState {
    /// Weights as `model.…`, Adam's moments as `adam.first` and `adam.second`, the beliefs as `beliefs`.
    pub tensors: BTreeMap<String, Tensor>,
    /// Optimiser steps taken in this stage.
    pub adam_steps: u64,
}

/// The agent.
#[derive(Debug)]
pub struct Agent {}

impl Agent {
    /// A fresh agent: weights are a function of `config.seed` and nothing else.
    pub fn new(_config: &Config, _device: Device) -> Result<Self, AgentError> {
        unimplemented!()
    }
    /// Begins a rollout and remembers the beliefs it starts from.
    pub fn begin_rollout(&mut self, _shape: RolloutShape) {
        unimplemented!()
    }
    /// Infers step `t` for some columns, stores what was seen and chosen, and advances their beliefs.
    pub fn step(&mut self, _t: usize, _input: &StepInput) -> Result<StepOutput, AgentError> {
        unimplemented!()
    }
    /// Records what action `t` of a column led to. Not called for a column that held.
    pub fn record(&mut self, _t: usize, _column: usize, _outcome: Outcome) {
        unimplemented!()
    }
    /// Values of the observations after the last action. Beliefs stay where they are.
    pub fn bootstrap(&mut self, _input: &StepInput) -> Result<(), AgentError> {
        unimplemented!()
    }
    /// Trains on the rollout. `progress` is the share of the stage's frames trained on before it.
    pub fn update(&mut self, _progress: f64, _rollout: u64) -> Result<BTreeMap<String, f64>, AgentError> {
        unimplemented!()
    }
    /// Puts the beliefs back to where the rollout began.
    pub fn abandon_rollout(&mut self) {
        unimplemented!()
    }
    /// A new stage: a fresh optimiser.
    pub fn start_stage(&mut self) {
        unimplemented!()
    }
    /// Everything a checkpoint keeps.
    pub fn state(&self) -> AgentState {
        unimplemented!()
    }
    /// Goes on from a saved state.
    pub fn load_state(&mut self, _state: &AgentState) -> Result<(), AgentError> {
        unimplemented!()
    }
    /// SHA-256 over (name, shape, little-endian f32 bytes) of all weights in name order, 64 hex digits.
    pub fn weights_digest(&self) -> String {
        unimplemented!()
    }
    /// Trainable parameters.
    pub fn parameter_count(&self) -> u64 {
        unimplemented!()
    }
}
