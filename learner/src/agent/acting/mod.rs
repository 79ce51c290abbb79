//! A step of the policy on a GPU: from an observation to what the host chooses an action from, as one CUDA graph for each
//! size of batch (`graphs.rs`). It also keeps what the step leaves: observations in the rollout's store, beliefs in their
//! table.
//!
//! Networks with an encoder in kernels of our own act by kernels from end to end (`kernels.rs`), all others by libtorch's
//! operations (`operations.rs`).

mod graphs;
mod inputs;
mod kernels;
mod operations;

pub(super) use kernels::parts_are_alike;

use super::sampling::Sampled;
use crate::ffi::graph::GraphError;
use crate::network::{Kept, Network};
use crate::rollout::Step;
use graphs::{Left, StepGraphs};
use kernels::ByKernels;
use operations::ByOperations;
use proto::camera::DepthFrame;
use proto::task::ActionHead;
use tch::{Device, Tensor};

#[derive(Debug)]
pub(super) enum Acting {
    Kernels(ByKernels),
    Operations(ByOperations),
}

/// What acts, and what it leaves its work in.
#[derive(Debug, Clone, Copy)]
pub(super) struct Policy<'a> {
    pub network: &'a Network,
    pub head: &'a ActionHead,
    /// The table \[columns + 1, state\]. What is not to be kept goes to its last row, and to that of the store.
    pub beliefs: &'a Tensor,
    /// The rollout's observations.
    pub store: &'a Kept,
}

/// One step for all rows of a batch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows<'a> {
    /// These, images and noise: as [`super::StepInput`] has them.
    pub frames: &'a [DepthFrame<'a>],
    pub images: &'a [u8],
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
    fn left(self) -> Left<'a> {
        Left { store: self.store, beliefs: self.beliefs }
    }

    /// Numbers that a policy leaves for each row: what an action is drawn from, and the value.
    fn outputs(self) -> usize {
        self.head.outputs() * if self.head.is_gaussian() { 2 } else { 1 } + 1
    }
}

impl Acting {
    /// For batches of at most `columns` rows. Nothing is recorded yet.
    pub fn new(network: &Network, columns: usize, device: Device) -> Result<Self, GraphError> {
        let graphs = StepGraphs::new(device)?;
        if network.kernels().is_some() && network.acts_in_parts() {
            return Ok(Self::Kernels(ByKernels::new(graphs, device)?));
        }
        Ok(Self::Operations(ByOperations::new(graphs, network, columns)?))
    }

    /// Whether what is made of a row is the same bits whichever rows are beside it.
    pub fn is_by_kernels(&self) -> bool {
        matches!(self, Self::Kernels(_))
    }

    /// Actors have started again: their frames may lie where others' lay.
    pub fn recheck_memory(&mut self) {
        if let Self::Kernels(kernels) = self {
            kernels.recheck_memory();
        }
    }

    pub fn step(&mut self, policy: Policy, rows: Rows) -> Result<Vec<Sampled>, GraphError> {
        // After a change of weights.
        policy.network.refresh();
        match self {
            Self::Kernels(kernels) => kernels.step(policy, rows),
            Self::Operations(operations) => operations.step(policy, rows),
        }
    }

    #[cfg(test)]
    fn graphs(&mut self) -> &mut StepGraphs {
        match self {
            Self::Kernels(kernels) => kernels.graphs(),
            Self::Operations(operations) => operations.graphs(),
        }
    }

    /// Whether steps were taken, each by a graph.
    #[cfg(test)]
    pub fn is_recorded(&mut self) -> bool {
        self.graphs().is_recorded()
    }

    /// From now on nothing is recorded.
    #[cfg(test)]
    fn refuse(&mut self) {
        self.graphs().refused = true;
    }
}
