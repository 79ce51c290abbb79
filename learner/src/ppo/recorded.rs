//! Passes over chunks as CUDA graphs: forward, loss and backward; and whole steps of the optimiser, where one is a single
//! pass. Launched operation by operation, those of a small network take the host ten times as long as they take the GPU.
//!
//! A pass is recorded where nothing but the number of its rows says what is launched: of a network without memory, an
//! auxiliary task, and an encoder in kernels of our own, which records its passes itself. The same operations are
//! launched in the same order, so no bit depends on whether, or when, a pass was recorded.

use super::metrics::SCALARS;
use super::minibatch::{Chunk, Whole};
use crate::ffi::graph::{Graph, GraphError, Memory, Recorder};
use crate::ffi::stream::Priority;
use crate::sizes::{Due, Sizes};
use std::collections::BTreeMap;
use tch::Tensor;

/// Runs before a recording: libraries choose algorithms and allocate at first use, which a recording does not allow.
const WARM_UPS: usize = 1;

/// All that an agent's updates have recorded.
#[derive(Debug, Default)]
pub(crate) struct PassGraphs {
    pub(super) passes: Graphs<Passed>,
    /// Steps of one pass, with the step's figures.
    pub(super) steps: Graphs<Tensor>,
}

/// What a pass over a chunk gives.
#[derive(Debug)]
pub(super) struct Passed {
    /// Of the chunk's part of the loss, \[W\].
    pub gradient: Tensor,
    pub scalars: [Tensor; SCALARS.len()],
}

/// Graphs by number of rows.
#[derive(Debug)]
pub(super) struct Graphs<T> {
    recorder: Option<Recorder>,
    recorded: BTreeMap<i64, Recorded<T>>,
    sizes: Sizes,
    /// Something could not be recorded.
    refused: bool,
}

/// A graph with what it reads and writes.
#[derive(Debug)]
struct Recorded<T> {
    graph: Graph,
    inputs: Inputs,
    result: T,
}

/// What is read besides the weights, and what is changed.
#[derive(Debug)]
pub(super) struct Inputs {
    pub chunk: Chunk,
    /// Numbers that differ from launch to launch.
    pub numbers: Vec<Tensor>,
    /// What is changed, always in its place.
    pub state: Vec<Tensor>,
}

impl<T> Default for Graphs<T> {
    fn default() -> Self {
        Self { recorder: None, recorded: BTreeMap::new(), sizes: Sizes::default(), refused: false }
    }
}

impl PassGraphs {
    /// Whether passes and steps were among those that were recorded.
    #[cfg(test)]
    pub(crate) fn have_launched(&self) -> [bool; 2] {
        let Self { passes, steps } = self;
        assert!(!passes.refused && !steps.refused);
        [!passes.recorded.is_empty(), !steps.recorded.is_empty()]
    }
}

impl<T> Graphs<T> {
    /// What `compute` gives for a chunk of a rollout, in the update of this number, and what it makes of `state`; none,
    /// and nothing is changed, where that is not recorded. It holds until the next one.
    ///
    /// # Panics
    /// If `state` has moved since it was recorded.
    pub(super) fn launch(
        &mut self,
        (whole, update): (&Whole, u64),
        chunk: &Chunk,
        (numbers, state): (&[&Tensor], &[&Tensor]),
        compute: impl Fn(&Inputs) -> T,
    ) -> Option<&T> {
        let rows = chunk.packing.rows.len() as i64;
        if !self.refused
            && let Some(due) = self.sizes.count(rows, update)
        {
            let numbers = numbers.iter().map(|tensor| tensor.copy()).collect();
            let state = state.iter().map(|tensor| tensor.shallow_clone()).collect();
            match self.record(Inputs { chunk: chunk.copy(whole), numbers, state }, due, compute) {
                Ok(recorded) => {
                    self.recorded.insert(rows, recorded);
                }
                Err(error) => {
                    tracing::warn!("training launches its kernels one by one, which takes longer: {error}");
                    self.refused = true;
                }
            }
        }
        let Recorded { graph, inputs, result } = self.recorded.get_mut(&rows)?;
        let stayed = inputs.state.iter().zip(state).all(|(own, now)| own.data_ptr() == now.data_ptr());
        assert!(stayed, "a recorded step changes weights and moments where they were");
        tch::no_grad(|| {
            inputs.chunk.take(chunk, whole);
            inputs.numbers.iter_mut().zip(numbers).for_each(|(own, now)| own.copy_(now));
        });
        // As in tch: a device that fails in the middle of a pass ends the process.
        graph.replay().unwrap_or_else(|error| panic!("{error}"));
        Some(result)
    }

    fn record(&mut self, inputs: Inputs, due: Due, compute: impl Fn(&Inputs) -> T) -> Result<Recorded<T>, GraphError> {
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
        let before: Vec<Tensor> = inputs.state.iter().map(Tensor::copy).collect();
        let recorded = recorder.record(WARM_UPS, || Ok(compute(&inputs)));
        // The runs that warm up have changed it.
        tch::no_grad(|| inputs.state.iter().zip(&before).for_each(|(own, before)| own.shallow_clone().copy_(before)));
        let (graph, result) = recorded?;
        Ok(Recorded { graph, inputs, result })
    }
}
