//! One CUDA graph for each size of batch. Recorded when a size is first met; where that fails the same kernels are
//! launched one by one, to the same bits.

use super::inputs::{Inputs, Layout, There};
use crate::ffi;
use crate::ffi::graph::{Graph, GraphError, Memory, Recorder};
use crate::ffi::stream::{Priority, Streams};
use crate::network::Kept;
use tch::{Device, Kind, Tensor};

/// Steps before a recording.
const WARM_UPS: usize = 3;

/// Graphs and their memory.
#[derive(Debug)]
pub(super) struct StepGraphs {
    recorder: Recorder,
    streams: Streams,
    prepared: Vec<Prepared>,
    /// Something could not be recorded.
    pub(super) refused: bool,
    device: Device,
}

/// What a step leaves its work in. Both have one row more than are used, the last: what is not to be kept goes there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Left<'a> {
    /// The rollout's observations.
    pub store: &'a Kept,
    /// The table of beliefs \[columns + 1, state\].
    pub beliefs: &'a Tensor,
}

/// What a step of so many rows reads and writes besides network and beliefs.
#[derive(Debug)]
struct Prepared {
    layout: Layout,
    /// Addresses of the store that it writes to.
    store: [usize; 2],
    /// None where it could not be recorded.
    graph: Option<Graph>,
    /// The inputs, in pinned memory.
    inputs: Tensor,
    /// What the host is given, \[rows, …\]; in pinned memory.
    outputs: Tensor,
}

impl StepGraphs {
    /// Nothing is recorded yet.
    pub fn new(device: Device) -> Result<Self, GraphError> {
        let recorder = Recorder::open(Priority::High, Memory::Apart)?;
        Ok(Self { recorder, streams: Streams::open()?, prepared: vec![], refused: false, device })
    }

    /// Takes a step, and waits for it. `launch` is given the inputs on the device and an output \[rows, words\] in pinned
    /// memory, whose numbers are returned. It launches the step's kernels on this thread's stream.
    pub fn step(
        &mut self,
        left: Left,
        inputs: &Inputs,
        words: usize,
        launch: impl Fn(&There, &Tensor) -> Result<(), GraphError>,
    ) -> Result<&mut [f32], GraphError> {
        let layout = Layout::of(inputs);
        let store = [&left.store.frames, &left.store.images].map(|part| part.data_ptr() as usize);
        let device = self.device;
        let launch = |prepared: &Prepared| {
            let _no_grad = tch::no_grad_guard();
            let bytes = prepared.inputs.to_device_(device, Kind::Uint8, true, false);
            launch(&There { layout: &prepared.layout, bytes }, &prepared.outputs)
        };
        let at = self.prepared.iter().position(|prepared| prepared.layout == layout && prepared.store == store);
        let at = if let Some(at) = at {
            at
        } else {
            self.prepared.retain(|prepared| prepared.store == store);
            let pinned = |size: &[i64], kind| Tensor::zeros(size, (kind, Device::Cpu)).pin_memory(device);
            let room = pinned(&[layout.bytes() as i64], Kind::Uint8);
            let outputs = pinned(&[layout.rows as i64, words as i64], Kind::Float);
            let mut prepared = Prepared { layout, store, graph: None, inputs: room, outputs };
            self.record(&mut prepared, left, inputs, launch);
            self.prepared.push(prepared);
            self.prepared.len() - 1
        };
        let Prepared { layout, inputs: room, .. } = &mut self.prepared[at];
        inputs.write(layout, room);
        let prepared = &self.prepared[at];
        let launched = match &prepared.graph {
            Some(graph) => graph.replay(),
            None => launch(prepared),
        };
        // Not for the device: another thread may keep it busy.
        self.streams.wait()?;
        launched?;
        // SAFETY: the GPU has written them, as the line above has waited for; no other tensor shares this memory.
        Ok(unsafe { ffi::floats_mut(&mut self.prepared[at].outputs) })
    }

    /// Records a step, unless something could not be recorded. The runs that warm up keep nothing.
    fn record(
        &mut self,
        prepared: &mut Prepared,
        Left { store, beliefs }: Left,
        inputs: &Inputs,
        launch: impl Fn(&Prepared) -> Result<(), GraphError>,
    ) {
        if self.refused {
            return;
        }
        let beyond = |rows: i64| vec![rows - 1; inputs.steps.len()];
        let (places, beliefs_to) = (beyond(store.rows()), beyond(beliefs.size()[0]));
        let inputs = Inputs { places: &places, beliefs_to: &beliefs_to, ..*inputs };
        inputs.write(&prepared.layout, &mut prepared.inputs);
        match self.recorder.record(WARM_UPS, || launch(prepared)) {
            Ok((graph, ())) => prepared.graph = Some(graph),
            Err(error) => {
                tracing::warn!("acting launches its kernels one by one, which takes longer: {error}");
                self.refused = true;
            }
        }
    }

    /// Whether steps were taken, each by a graph.
    #[cfg(test)]
    pub fn is_recorded(&self) -> bool {
        self.has_stepped() && self.prepared.iter().all(|prepared| prepared.graph.is_some())
    }

    #[cfg(test)]
    pub fn has_stepped(&self) -> bool {
        !self.prepared.is_empty()
    }
}
