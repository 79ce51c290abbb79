//! Checkpoints: the complete state that a run needs to continue exactly.
//!
//! A checkpoint is three files in `RUN/checkpoints/`: `rollout-K.safetensors` ([`tensors`]), `rollout-K.jsonl` (the
//! figures of all rollouts before it) and, written last, `rollout-K.json` ([`proto::checkpoint::Manifest`]), which names
//! the run and holds the hashes of the others and of itself. Each is written beside its place, flushed to the disk and
//! renamed, so at every moment the newest complete checkpoint is a good one.
//! [`store`] writes, finds, verifies and prunes them; [`part`] is about several learners.

mod part;
mod store;
mod tensors;
#[cfg(test)]
mod tests;

pub use part::Part;
pub use store::{CheckpointError, Loaded, Rejected, Store, read};
pub use tensors::{TensorsError, decode_tensors, encode_tensors};
pub(crate) use tensors::{decode, encode};

use crate::agent::AgentState;
use crate::collector::Boundary;

#[derive(Debug)]
pub struct Snapshot {
    /// The next rollout.
    pub rollout: u64,
    pub frames: u64,
    pub agent: AgentState,
    pub boundary: Boundary,
    pub weights: String,
}
