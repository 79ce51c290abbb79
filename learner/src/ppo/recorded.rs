//! Passes over chunks as CUDA graphs: forward, loss and backward. Launched operation by operation, a pass of a small
//! network takes the host ten times as long as it takes the GPU.
//!
//! A pass is recorded where nothing but the number of its rows says what is launched: of a network without memory, an
//! auxiliary task, and an encoder in kernels of our own, which records its passes itself. The same operations are
//! launched in the same order, so no bit depends on whether, or when, a pass was recorded.

use super::loss::Coefficients;
use super::metrics::SCALARS;
use super::minibatch::{Chunk, Whole};
use crate::ffi::graph::{Graph, GraphError, Memory, Recorder};
use crate::ffi::stream::Priority;
use crate::sizes::{Due, Sizes};
use std::collections::BTreeMap;
use tch::Tensor;

/// Runs before a recording: libraries choose algorithms and allocate at first use, which a recording does not allow.
const WARM_UPS: usize = 1;

/// The recorded passes, by number of rows.
#[derive(Debug, Default)]
pub(crate) struct PassGraphs {
    recorder: Option<Recorder>,
    recorded: BTreeMap<i64, Recorded>,
    sizes: Sizes,
    /// Something could not be recorded.
    refused: bool,
}

/// What a pass over a chunk gives.
#[derive(Debug)]
pub(super) struct Passed {
    /// Of the chunk's part of the loss, \[W\].
    pub gradient: Tensor,
    pub scalars: [Tensor; SCALARS.len()],
}

/// A pass with what it reads and writes, besides the weights.
#[derive(Debug)]
struct Recorded {
    graph: Graph,
    chunk: Chunk,
    coefficients: Coefficients,
    pass: Passed,
}

impl PassGraphs {
    /// What `compute` gives for a chunk of a rollout, in the update of this number; none where that is not recorded. It
    /// holds until the next one.
    pub(super) fn pass(
        &mut self,
        (whole, update): (&Whole, u64),
        chunk: &Chunk,
        coefficients: &Coefficients,
        compute: impl Fn(&Chunk, &Coefficients) -> Passed,
    ) -> Option<&Passed> {
        let rows = chunk.packing.rows.len() as i64;
        if !self.refused
            && let Some(due) = self.sizes.count(rows, update)
        {
            match self.record((chunk.copy(whole), coefficients.copy()), due, compute) {
                Ok(recorded) => {
                    self.recorded.insert(rows, recorded);
                }
                Err(error) => {
                    tracing::warn!("training launches its kernels one by one, which takes longer: {error}");
                    self.refused = true;
                }
            }
        }
        let Recorded { graph, chunk: place, coefficients: numbers, pass } = self.recorded.get_mut(&rows)?;
        tch::no_grad(|| {
            place.take(chunk, whole);
            numbers.tensor().shallow_clone().copy_(coefficients.tensor());
        });
        // As in tch: a device that fails in the middle of a pass ends the process.
        graph.replay().unwrap_or_else(|error| panic!("{error}"));
        Some(pass)
    }

    /// Whether a pass was one of those that were recorded.
    #[cfg(test)]
    pub(crate) fn has_launched(&self) -> bool {
        !self.recorded.is_empty() && !self.refused
    }

    fn record(
        &mut self,
        (chunk, coefficients): (Chunk, Coefficients),
        due: Due,
        compute: impl Fn(&Chunk, &Coefficients) -> Passed,
    ) -> Result<Recorded, GraphError> {
        // A graph's kernels have the priority of the stream that they were recorded on: acting goes first.
        let recorder = match &mut self.recorder {
            Some(recorder) => recorder,
            none => none.insert(Recorder::open(Priority::Low, Memory::Shared)?),
        };
        if let Some(dropped) = due.in_place_of {
            // Its last launch may still run. What it has of the shared memory is free for the new recording.
            recorder.wait()?;
            self.recorded.remove(&dropped);
        }
        let (graph, pass) = recorder.record(WARM_UPS, || Ok(compute(&chunk, &coefficients)))?;
        Ok(Recorded { graph, chunk, coefficients, pass })
    }
}
