//! What a step is taken with, and of what.

use super::graphs::Left;
use crate::network::{Kept, Network};
use crate::rollout::Step;
use proto::camera::DepthFrame;
use proto::task::ActionHead;
use tch::Tensor;

/// What acts, and what it leaves its work in.
#[derive(Debug, Clone, Copy)]
pub(in crate::agent) struct Policy<'a> {
    pub network: &'a Network,
    pub head: &'a ActionHead,
    /// The table \[columns + 1, state\]. What is not to be kept goes to its last row, and to that of the store.
    pub beliefs: &'a Tensor,
    /// The rollout's observations.
    pub store: &'a Kept,
}

/// One step for all rows of a batch.
#[derive(Debug, Clone, Copy)]
pub(in crate::agent) struct Rows<'a> {
    /// These, images and noise: as [`crate::agent::StepInput`] has them.
    pub frames: &'a [DepthFrame<'a>],
    pub images: &'a [&'a [u8]],
    pub noise: &'a [f32],
    /// Rows of the store that get the observations.
    pub places: &'a [i64],
    /// Rows of the table of beliefs: where they are now, and where they go.
    pub columns: &'a [i64],
    pub beliefs_to: &'a [i64],
    /// Numbers, previous actions, episode starts, masks.
    pub steps: &'a [Step],
}

impl<'a> Policy<'a> {
    pub(super) fn left(self) -> Left<'a> {
        Left { store: self.store, beliefs: self.beliefs }
    }

    /// Numbers that a policy leaves for each row: what an action is drawn from, and the value.
    pub(super) fn outputs(self) -> usize {
        self.head.outputs() * if self.head.is_gaussian() { 2 } else { 1 } + 1
    }
}
