//! What a rollout was made of, kept small: everything but frames. Dumped when a number is not finite, so that the
//! cause can be looked for; the frames come back by replaying the recording.

use crate::agent::{Outcome, StepInput, StepOutput};
use std::collections::BTreeMap;
use tch::Tensor;

/// One rollout, row-major (step, column).
#[derive(Debug, Default)]
pub struct Trace {
    columns: usize,
    goal_m: Vec<f32>,
    previous_action: Vec<u8>,
    episode_start: Vec<bool>,
    actions: Vec<u8>,
    log_probs: Vec<f32>,
    values: Vec<f32>,
    rewards: Vec<f32>,
    ended: Vec<bool>,
    disturbed: Vec<bool>,
}

impl Trace {
    /// An empty trace of `steps` steps of `columns` environments. What is never written stays 0.
    pub fn new(steps: usize, columns: usize) -> Self {
        let cells = steps * columns;
        Self {
            columns,
            goal_m: vec![0.0; cells * 3],
            previous_action: vec![0; cells],
            episode_start: vec![false; cells],
            actions: vec![0; cells],
            log_probs: vec![0.0; cells],
            values: vec![0.0; cells],
            rewards: vec![0.0; cells],
            ended: vec![false; cells],
            disturbed: vec![false; cells],
        }
    }

    /// Notes what was seen and chosen in row `t`.
    pub fn step(&mut self, t: usize, input: &StepInput, output: &StepOutput) {
        for (i, column) in input.columns.iter().enumerate() {
            let cell = t * self.columns + column;
            self.goal_m[cell * 3..][..3].copy_from_slice(&input.goal_m[i]);
            self.previous_action[cell] = input.previous_action[i];
            self.episode_start[cell] = input.episode_start[i];
            self.actions[cell] = output.actions[i];
            self.log_probs[cell] = output.log_probs[i];
            self.values[cell] = output.values[i];
        }
    }

    /// Notes what the action of row `t` led to.
    pub fn outcome(&mut self, t: usize, column: usize, outcome: Outcome) {
        let cell = t * self.columns + column;
        self.rewards[cell] = outcome.reward;
        self.ended[cell] = outcome.ended;
        self.disturbed[cell] = outcome.disturbed;
    }

    /// The trace as named tensors of shape (T, N), the goal (T, N, 3).
    pub fn tensors(&self) -> BTreeMap<String, Tensor> {
        let columns = self.columns as i64;
        let shaped = |tensor: Tensor| tensor.reshape([-1, columns]);
        BTreeMap::from([
            ("rollout.goal_m".to_owned(), Tensor::from_slice(&self.goal_m).reshape([-1, columns, 3])),
            ("rollout.previous_action".to_owned(), shaped(Tensor::from_slice(&self.previous_action))),
            ("rollout.episode_start".to_owned(), shaped(Tensor::from_slice(&self.episode_start))),
            ("rollout.action".to_owned(), shaped(Tensor::from_slice(&self.actions))),
            ("rollout.log_prob".to_owned(), shaped(Tensor::from_slice(&self.log_probs))),
            ("rollout.value".to_owned(), shaped(Tensor::from_slice(&self.values))),
            ("rollout.reward".to_owned(), shaped(Tensor::from_slice(&self.rewards))),
            ("rollout.ended".to_owned(), shaped(Tensor::from_slice(&self.ended))),
            ("rollout.disturbed".to_owned(), shaped(Tensor::from_slice(&self.disturbed))),
        ])
    }
}
