//! A step of the policy on a GPU: from an observation to what the host chooses an action from, as one CUDA graph for each
//! size of batch (`graphs.rs`). It also keeps what the step leaves: observations in the rollout's store, beliefs in their
//! table.
//!
//! Networks with an encoder in kernels of our own act by kernels from end to end (`kernels.rs`), all others by libtorch's
//! operations (`operations.rs`).

mod batch;
mod graphs;
mod inputs;
mod kernels;
mod operations;
mod reach;

pub(super) use batch::{Policy, Rows};
pub(super) use kernels::parts_are_alike;

use super::sampling::Sampled;
use crate::ffi::graph::GraphError;
use crate::network::Network;
use graphs::StepGraphs;
use kernels::ByKernels;
use operations::ByOperations;
use tch::Device;

#[derive(Debug)]
pub(super) enum Acting {
    Kernels(ByKernels),
    Operations(ByOperations),
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
        match self {
            Self::Kernels(kernels) => kernels.recheck_memory(),
            Self::Operations(operations) => operations.recheck_memory(),
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
