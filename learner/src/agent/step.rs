//! What an agent is given and gives in one step.

use crate::network::Kept;
use proto::camera::DepthFrame;
use tch::{Device, Tensor};

/// What the policy sees of some columns in one step. All slices have one entry a column, in the same order.
#[derive(Debug, Clone, Copy)]
pub struct StepInput<'a> {
    /// Columns of this learner (place of the actor among its own · environments per actor + environment), ascending but
    /// for rows of which nothing is kept.
    pub columns: &'a [usize],
    /// Depth frames; may point into shared memory. None at all in a task without a frame.
    pub frames: &'a [DepthFrame<'a>],
    /// Bytes of all other images, `columns.len() * images`, row-major; may point into shared memory, too.
    pub images: &'a [&'a [u8]],
    /// The task's numbers, `columns.len() * numbers`, row-major: [`proto::task::Inputs::read`].
    pub numbers: &'a [f32],
    /// Index of the previous action; meaningless at an episode's first observation.
    pub previous_action: &'a [u8],
    /// True at an episode's first observation: the belief is zeroed before it is used.
    pub episode_start: &'a [bool],
    /// Whether each option may be chosen, `columns.len() * options`, row-major; empty in a task without masks, and where
    /// nothing is chosen.
    pub masks: &'a [bool],
    /// What chooses actions, as many draws a column as [`crate::collector::Noise`] has, row-major. Unused by
    /// [`crate::agent::Agent::bootstrap`].
    pub gumbel: &'a [f32],
}

impl StepInput<'_> {
    /// # Panics
    /// If the slices differ in length, there is no column, or columns do not ascend.
    pub(super) fn check(&self) {
        let Self { columns, frames, images, numbers, previous_action, episode_start, masks, .. } = *self;
        let rows = columns.len();
        let of_rows = [previous_action.len(), episode_start.len()] == [rows; 2] && [0, rows].contains(&frames.len());
        let are_whole = [numbers.len(), images.len(), masks.len()].iter().all(|count| count.is_multiple_of(rows));
        assert!(rows > 0 && of_rows && are_whole, "one entry a column");
        assert!(columns.is_sorted_by(|a, b| a < b), "columns ascend");
    }
}

/// Columns that are inferred together: owns what a [`StepInput`] borrows.
#[derive(Debug, Clone, PartialEq)]
pub struct Batch<'a> {
    pub(crate) columns: Vec<usize>,
    /// Row of the rollout that each column is at; as many as it has, after the last action. Columns beyond these fill the
    /// batch up, and nothing is kept of them.
    pub(crate) at: Vec<usize>,
    pub(crate) frames: Vec<DepthFrame<'a>>,
    pub(crate) images: Vec<&'a [u8]>,
    pub(crate) numbers: Vec<f32>,
    pub(crate) previous_action: Vec<u8>,
    pub(crate) episode_start: Vec<bool>,
    pub(crate) masks: Vec<bool>,
    pub(crate) gumbel: Vec<f32>,
}

impl Batch<'_> {
    /// Row of the rollout that each column is at.
    pub fn rows(&self) -> impl Iterator<Item = usize> {
        self.at.iter().copied()
    }

    pub fn input(&self) -> StepInput<'_> {
        StepInput {
            columns: &self.columns,
            frames: &self.frames,
            images: &self.images,
            numbers: &self.numbers,
            previous_action: &self.previous_action,
            episode_start: &self.episode_start,
            masks: &self.masks,
            gumbel: &self.gumbel,
        }
    }
}

/// What the policy chose, one entry a column of the input.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StepOutput {
    /// Bytes of the actions, one behind the other.
    pub actions: Vec<u8>,
    pub log_probs: Vec<f32>,
    pub values: Vec<f32>,
}

/// What the policy chose outside of a rollout, one entry a column of the input.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Choice {
    /// Bytes of the actions, one behind the other.
    pub actions: Vec<u8>,
    /// Whether the auxiliary task predicts the task's label of the action; none if it predicts something else.
    pub foretold: Option<Vec<bool>>,
}

/// The network's outputs for the observations of some columns.
pub(super) struct Inference {
    pub kept: Kept,
    /// What [`crate::network::Belief::step`] gives.
    pub beliefs: Tensor,
    /// [`crate::network::Distribution::rows`], one behind the other.
    pub policy: Vec<f32>,
    pub values: Vec<f32>,
}

/// Some rows of a tensor; all of it where they are all, without a copy.
pub(super) fn pick(tensor: &Tensor, rows: &[usize]) -> Tensor {
    if rows.len() as i64 == tensor.size()[0] {
        return tensor.shallow_clone();
    }
    tensor.index_select(0, &column_indices(rows, tensor.device()))
}

pub(super) fn column_indices(columns: &[usize], device: Device) -> Tensor {
    let columns: Vec<i64> = columns.iter().map(|&column| column as i64).collect();
    Tensor::from_slice(&columns).to_device(device)
}
