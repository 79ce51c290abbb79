//! A step of the policy on a GPU as one CUDA graph for each size of batch: from frames in the actors' shared memory,
//! which the GPU reads itself, to sampled actions in the host's. Recorded when a size is first met; where that fails the
//! same kernels are launched one by one, to the same bits.
//!
//! The graph also keeps what the step leaves: frames in the rollout's store, beliefs in their table. Store and table
//! have one row more than are used; what is not to be kept goes there.

use super::sampling::{Sampled, forbid, normalize, sample};
use crate::ffi;
use crate::ffi::branches::Branches;
use crate::ffi::graph::{Graph, GraphError, Memory, Recorder};
use crate::ffi::host_memory::HostMemory;
use crate::ffi::kernels::{ActingKernels, CHOSEN_WORDS, Chosen, Kernels, Source, Undecided};
use crate::ffi::stream::{Priority, Streams};
use crate::network::{Network, Staging};
use crate::rollout::Step;
use proto::camera::DepthFrame;
use proto::task::{ActionHead, PolicyAction};
use std::ops::Range;
use tch::{Device, Kind, Tensor};

/// A batch of more rows goes through the encoder in two parts, beside one another: the GPU computes with the first
/// frames while it reads the others from the host's memory, and small kernels of both share it. Each part costs
/// launches of its own: more than two were slower on an H200 (BENCHMARKS.md).
const PART_ROWS: usize = 76;
const MOST_PARTS: usize = 2;
/// Steps before a recording.
const WARM_UPS: usize = 3;

/// Graphs and their memory.
#[derive(Debug)]
pub(super) struct Acting {
    recorder: Recorder,
    streams: Streams,
    branches: Branches,
    memory: HostMemory,
    /// Frames that the GPU cannot read where they are.
    staging: Staging,
    /// Frames were copied, and a warning was given.
    copied: bool,
    prepared: Vec<Prepared>,
    /// Something could not be recorded.
    refused: bool,
    device: Device,
}

/// What acts, and what it leaves its work in.
#[derive(Debug, Clone, Copy)]
pub(super) struct Policy<'a> {
    pub network: &'a Network,
    pub kernels: &'a Kernels,
    pub head: &'a ActionHead,
    /// Whether there are options that may not be chosen.
    pub masked: bool,
    /// The table \[columns + 1, state\].
    pub beliefs: &'a Tensor,
    /// The rollout's frames, \[frames + 1, side, side\].
    pub store: &'a Tensor,
}

/// One step for all rows of a batch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows<'a> {
    pub frames: &'a [DepthFrame<'a>],
    /// Rows of the store that get the frames.
    pub places: &'a [i64],
    /// Rows of the table of beliefs: where they are now, and where they go.
    pub columns: &'a [i64],
    pub beliefs_to: &'a [i64],
    /// Numbers, previous actions, episode starts.
    pub steps: &'a [Step],
    /// As [`super::StepInput`] has it.
    pub noise: &'a [f32],
}

/// What a step of so many rows reads and writes besides network and beliefs.
#[derive(Debug)]
struct Prepared {
    layout: InputBytes,
    /// Address of the store that it writes to.
    store: usize,
    /// None where it could not be recorded.
    graph: Option<Graph>,
    /// The inputs, in pinned memory.
    inputs: Tensor,
    /// What was chosen, \[rows, [`CHOSEN_WORDS`]\], or what the host chooses from, \[rows, …\]; in pinned memory.
    choices: Tensor,
}

impl Policy<'_> {
    /// Whether kernels choose an action, too; otherwise the host does.
    fn is_chosen_there(self) -> bool {
        !self.masked && matches!(self.head, ActionHead::Discrete(named) if ActingKernels::can_choose(named.len()))
    }

    /// Numbers of a row of what a step leaves for the host.
    fn words(self) -> usize {
        let given = self.head.outputs() * if self.head.is_gaussian() { 2 } else { 1 };
        if self.is_chosen_there() { CHOSEN_WORDS } else { given + 1 }
    }

    /// What was chosen for a row, or is now.
    fn read(self, row: &mut [f32], mask: &[bool], noise: &[f32]) -> Sampled {
        if self.is_chosen_there() {
            let Chosen { log_prob, value, action, finite } = Chosen::from_words(row);
            return Sampled { action: PolicyAction::Options(vec![action as i64]), log_prob, value, finite };
        }
        let finite = row.iter().all(|number| number.is_finite());
        let (value, row) = row.split_last_mut().expect("a row has at least the value");
        forbid(mask, row);
        normalize(self.head, row);
        let (action, log_prob) = sample(self.head, row, noise);
        Sampled { action, log_prob, value: *value, finite }
    }
}

/// Where each input lies among the bytes of all.
#[derive(Debug, Clone, PartialEq, Eq)]
struct InputBytes {
    rows: usize,
    frames: Range<usize>,
    places: Range<usize>,
    columns: Range<usize>,
    beliefs_to: Range<usize>,
    previous_actions: Range<usize>,
    numbers: Range<usize>,
    carried: Range<usize>,
    noise: Range<usize>,
}

impl InputBytes {
    fn new(rows: usize, [numbers, actions]: [usize; 2]) -> Self {
        let mut end = 0;
        let mut next = |bytes: usize| {
            let start = end;
            end += bytes.next_multiple_of(16);
            start..start + bytes
        };
        Self {
            rows,
            frames: next(rows * 8),
            places: next(rows * 8),
            columns: next(rows * 8),
            beliefs_to: next(rows * 8),
            previous_actions: next(rows * 8),
            numbers: next(rows * numbers * 4),
            carried: next(rows * 4),
            noise: next(rows * actions * 4),
        }
    }

    fn bytes(&self) -> usize {
        self.noise.end
    }
}

impl Acting {
    /// Nothing is recorded yet.
    pub fn new(device: Device) -> Result<Self, GraphError> {
        Ok(Self {
            recorder: Recorder::open(Priority::High, Memory::Apart)?,
            streams: Streams::open()?,
            branches: Branches::open(MOST_PARTS)?,
            memory: HostMemory::open()?,
            staging: Staging::default(),
            copied: false,
            prepared: vec![],
            refused: false,
            device,
        })
    }

    /// Actors have started again: their frames may lie where others' lay.
    pub fn recheck_memory(&mut self) {
        self.memory.recheck();
    }

    pub fn step(&mut self, policy: Policy, rows: Rows) -> Result<Vec<Sampled>, GraphError> {
        let count = rows.steps.len();
        let layout = InputBytes::new(count, [rows.steps[0].numbers.len(), rows.noise.len() / count]);
        let store = policy.store.data_ptr() as usize;
        // After a change of weights.
        policy.network.refresh();
        let frames = self.addresses(policy.kernels, rows.frames);
        let at = self.prepared.iter().position(|prepared| prepared.layout == layout && prepared.store == store);
        let at = if let Some(at) = at {
            at
        } else {
            self.prepared.retain(|prepared| prepared.store == store);
            let prepared = self.prepare(policy, layout, &frames, rows);
            self.prepared.push(prepared);
            self.prepared.len() - 1
        };
        let Prepared { layout, inputs, .. } = &mut self.prepared[at];
        fill(inputs, layout, &frames, rows);
        let prepared = &self.prepared[at];
        let launched = match &prepared.graph {
            Some(graph) => graph.replay(),
            None => self.launch(policy, prepared),
        };
        // Not for the device: another thread may keep it busy.
        self.streams.wait()?;
        launched?;
        // SAFETY: the GPU has written them, as the line above has waited for; no other tensor shares this memory.
        let words = unsafe { ffi::floats_mut(&mut self.prepared[at].choices) };
        let noise = rows.noise.chunks_exact(rows.noise.len() / count);
        let rows = words.chunks_exact_mut(policy.words()).zip(rows.steps).zip(noise);
        Ok(rows.map(|((row, step), noise)| policy.read(row, &step.mask, noise)).collect())
    }

    /// Where the GPU finds the frames: where they are if it can read them there, or in pinned memory.
    fn addresses(&mut self, kernels: &Kernels, frames: &[DepthFrame]) -> Vec<i64> {
        let sources: Vec<Source> = frames.iter().map(|frame| kernels.acting.source(frame)).collect();
        let mut admit = |source: &Source| {
            let (address, bytes) = source.bytes();
            self.memory.admit(address, bytes)
        };
        let Err(why) = sources.iter().try_for_each(&mut admit) else {
            return sources.into_iter().map(Source::word).collect();
        };
        if !std::mem::replace(&mut self.copied, true) {
            tracing::warn!(
                "acting copies frames for the GPU, which takes longer, as it cannot read them where they are: {why}"
            );
        }
        let gathered = self.staging.gather(frames, self.device);
        gathered.iter().map(|frame| kernels.acting.source(frame).word()).collect()
    }

    /// Room for steps of so many rows, and the graph of one unless something could not be recorded.
    fn prepare(&mut self, policy: Policy, layout: InputBytes, frames: &[i64], rows: Rows) -> Prepared {
        let Policy { beliefs, store, .. } = policy;
        let pinned = |size: &[i64], kind| Tensor::zeros(size, (kind, Device::Cpu)).pin_memory(self.device);
        let inputs = pinned(&[layout.bytes() as i64], Kind::Uint8);
        let choices = pinned(&[layout.rows as i64, policy.words() as i64], Kind::Float);
        let mut prepared = Prepared { store: store.data_ptr() as usize, graph: None, inputs, choices, layout };
        if self.refused {
            return prepared;
        }
        // The runs that warm up keep nothing.
        let beyond = |tensor: &Tensor| vec![tensor.size()[0] - 1; rows.steps.len()];
        let (places, beliefs_to) = (beyond(store), beyond(beliefs));
        let rows = Rows { places: &places, beliefs_to: &beliefs_to, ..rows };
        fill(&mut prepared.inputs, &prepared.layout, frames, rows);
        match self.recorder.record(WARM_UPS, || self.launch(policy, &prepared)) {
            Ok((graph, ())) => prepared.graph = Some(graph),
            Err(error) => {
                tracing::warn!("acting launches its kernels one by one, which takes longer: {error}");
                self.refused = true;
            }
        }
        prepared
    }

    /// Launches a step's kernels on this thread's stream.
    fn launch(&self, policy: Policy, prepared: &Prepared) -> Result<(), GraphError> {
        let Policy { network, kernels, beliefs, store, .. } = policy;
        let Prepared { layout, inputs, choices, .. } = prepared;
        let device = self.device;
        let _no_grad = tch::no_grad_guard();
        let inputs = inputs.to_device_(device, Kind::Uint8, true, false);
        let part =
            |range: &Range<usize>, kind| inputs.narrow(0, range.start as i64, range.len() as i64).view_dtype(kind);
        let side = store.size()[1];
        let kept = Tensor::empty([layout.rows as i64, side, side], (Kind::Float, device));
        let (frames, places) = (part(&layout.frames, Kind::Int64), part(&layout.places, Kind::Int64));
        let recurrent = network.belief.recurrent();
        let (seen, told, before, from_before) = self.branches.joined(|branches| {
            let mut seen = vec![];
            let parts = parts(layout.rows);
            let alone = parts.len() == 1;
            // The encoder sees the first frames while others are on their way.
            for rows in parts {
                let of = |tensor: &Tensor| tensor.narrow(0, rows.start as i64, rows.len() as i64);
                let kept = of(&kept);
                // SAFETY: `fill` puts there the addresses of `addresses` and rows of this store, before each launch.
                unsafe { kernels.acting.observe(&of(&frames), &of(&places), &kept, store, alone) };
                seen.push(branches.fork(|| network.seen(&kept))?);
            }
            // Beside the encoder, too.
            let numbers = part(&layout.numbers, Kind::Float).view([layout.rows as i64, -1]);
            let told = network.told(&numbers, &part(&layout.previous_actions, Kind::Int64));
            let before = beliefs.index_select(0, &part(&layout.columns, Kind::Int64))
                * part(&layout.carried, Kind::Float).unsqueeze(1);
            let from_before = recurrent.state_gates(&network.parameters, &before);
            Ok::<_, GraphError>((seen, told, before, from_before))
        })?;
        let embedded = Tensor::cat(&[Tensor::cat(&seen, 0), told], 1);
        let from_input = recurrent.input_gates(&network.parameters, &embedded);
        let noise = part(&layout.noise, Kind::Float).view([layout.rows as i64, -1]);
        let row = Undecided { from_input: &from_input, from_before: &from_before, before: &before, noise: &noise };
        let to = part(&layout.beliefs_to, Kind::Int64);
        let heads = network.heads();
        // SAFETY: `fill` puts rows of the table there.
        unsafe {
            if policy.is_chosen_there() {
                kernels.acting.decide(&heads, &row, &to, beliefs, choices);
            } else {
                kernels.acting.answer(&heads, &row, &to, beliefs, choices);
            }
        }
        Ok(())
    }
}

/// Rows of a batch that go through the encoder together.
fn parts(rows: usize) -> Vec<Range<usize>> {
    let count = rows.div_ceil(PART_ROWS).min(MOST_PARTS);
    let end = |part: usize| part * rows / count;
    (0..count).map(|part| end(part)..end(part + 1)).collect()
}

/// Whether the parts of such a batch are equally long: only then does it not matter in which a row is.
pub(super) fn parts_are_alike(rows: usize) -> bool {
    let parts = parts(rows);
    parts.iter().all(|part| part.len() == parts[0].len())
}

/// Writes the inputs of a step into their pinned memory.
fn fill(inputs: &mut Tensor, layout: &InputBytes, frames: &[i64], rows: Rows) {
    fn put<const BYTES: usize>(to: &mut [u8], numbers: impl Iterator<Item = [u8; BYTES]>) {
        for (to, number) in to.chunks_exact_mut(BYTES).zip(numbers) {
            to.copy_from_slice(&number);
        }
    }
    // SAFETY: the GPU reads them in steps alone, and each of those was waited for; no other tensor shares this memory.
    let bytes = unsafe { ffi::bytes_mut(inputs) };
    let integers = |to: &mut [u8], numbers: &[i64]| put(to, numbers.iter().map(|number| number.to_ne_bytes()));
    integers(&mut bytes[layout.frames.clone()], frames);
    integers(&mut bytes[layout.places.clone()], rows.places);
    integers(&mut bytes[layout.columns.clone()], rows.columns);
    integers(&mut bytes[layout.beliefs_to.clone()], rows.beliefs_to);
    let steps = rows.steps.iter();
    put(&mut bytes[layout.previous_actions.clone()], steps.clone().map(|step| step.previous_action.to_ne_bytes()));
    let numbers = steps.clone().flat_map(|step| &step.numbers);
    put(&mut bytes[layout.numbers.clone()], numbers.map(|number| number.to_ne_bytes()));
    let carried = steps.map(|step| if step.episode_start { 0.0f32 } else { 1.0 });
    put(&mut bytes[layout.carried.clone()], carried.map(f32::to_ne_bytes));
    put(&mut bytes[layout.noise.clone()], rows.noise.iter().map(|number| number.to_ne_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::Agent;
    use crate::bench::Frames;
    use proto::config::Config;
    use proto::stage::RolloutShape;

    impl Acting {
        /// Whether steps were taken, each by a graph.
        pub(in crate::agent) fn is_recorded(&self) -> bool {
            !self.prepared.is_empty() && self.prepared.iter().all(|prepared| prepared.graph.is_some())
        }

        /// Whether steps were taken, each with frames where actors wrote them.
        fn has_copied_nothing(&self) -> bool {
            !self.prepared.is_empty() && !self.copied
        }
    }

    /// What a graph does, in parts or whole, is what the agent does without one: as far as bfloat16 goes, because other
    /// sizes of batches may have other convolutions.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn a_graph_does_what_the_agent_does_step_by_step() {
        let _alone = crate::device::cuda_alone();
        let mut config = Config::resolve("recipe", None).unwrap();
        for [actors, environments] in [[1, 20], [19, 16], [19, 32]] {
            (config.actors.count, config.actors.environments_per_actor) = (actors, environments);
            let frames = Frames::new(&config).unwrap();
            assert!(frames.batch(0, 0, vec![]).input().frames.iter().all(|frame| matches!(frame, DepthFrame::Sums(_))));
            let [mut graph, mut plain] = [(); 2].map(|()| Agent::new(&config, Device::Cuda(0)).unwrap());
            plain.acting = None;
            for agent in [&mut graph, &mut plain] {
                agent.begin_rollout(RolloutShape::next(u64::MAX, 4, config.environments()));
            }
            for (t, half) in (0..4).flat_map(|t| [(t, 0), (t, 1)]) {
                let batch = frames.batch(half, t, frames.noise(half, t));
                let [done, expected] = [&mut graph, &mut plain].map(|agent| agent.step(t, &batch.input()).unwrap());
                let same = done.actions.iter().zip(&expected.actions).filter(|(a, b)| a == b).count();
                assert!(same * 50 >= batch.columns.len() * 49, "{same} actions of {} agree", batch.columns.len());
                let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.02);
                assert!(close(&done.values, &expected.values), "{:?} {:?}", done.values, expected.values);
            }
            assert!(graph.acting.as_ref().is_some_and(Acting::is_recorded));
            assert!(graph.acting.as_ref().is_some_and(Acting::has_copied_nothing));
            let stored = |agent: &Agent| {
                let rollout = agent.rollout.as_ref().unwrap();
                rollout.kept().frames.narrow(0, 0, 4 * config.environments() as i64)
            };
            assert!(stored(&graph).equal(&stored(&plain)), "the store has all frames");
            assert!(graph.beliefs.allclose(&plain.beliefs, 0.0, 0.02, false), "and the table the beliefs");
        }
    }

    /// To the last bit, in parts and whole. One of the agents copies frames besides, as the other has registered them.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn a_step_that_could_not_be_recorded_or_read_in_place_is_the_same_step() {
        let _alone = crate::device::cuda_alone();
        let mut config = Config::resolve("recipe", None).unwrap();
        for [actors, environments] in [[1, 20], [19, 16]] {
            (config.actors.count, config.actors.environments_per_actor) = (actors, environments);
            let frames = Frames::new(&config).unwrap();
            let [mut recorded, mut refused] = [(); 2].map(|()| Agent::new(&config, Device::Cuda(0)).unwrap());
            refused.acting.as_mut().unwrap().refused = true;
            for agent in [&mut recorded, &mut refused] {
                agent.begin_rollout(RolloutShape::next(u64::MAX, 4, config.environments()));
            }
            for (t, half) in (0..=4).flat_map(|t| [(t, 0), (t, 1)]) {
                let batch = frames.batch(half, t, frames.noise(half, t));
                let [done, expected] =
                    [&mut refused, &mut recorded].map(|agent| agent.step(t, &batch.input()).unwrap());
                assert_eq!(done.actions, expected.actions);
                let bits = |numbers: &[f32]| numbers.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(&done.values), bits(&expected.values), "step {t} of half {half}");
                assert_eq!(bits(&done.log_probs), bits(&expected.log_probs), "step {t} of half {half}");
            }
            assert!(recorded.acting.as_ref().is_some_and(Acting::is_recorded));
            assert!(refused.acting.as_ref().is_some_and(|acting| !acting.is_recorded()));
            let in_place =
                [&recorded, &refused].map(|agent| agent.acting.as_ref().is_some_and(Acting::has_copied_nothing));
            assert_eq!(in_place, [false, true]);
            assert!(recorded.beliefs.equal(&refused.beliefs), "beliefs");
            let (one, other) = (recorded.rollout_tensors(), refused.rollout_tensors());
            assert!(one["rollout.frames"].equal(&other["rollout.frames"]), "the store");
        }
    }

    #[test]
    fn parts_are_all_rows_in_order() {
        for (rows, count) in [(1, 1), (10, 1), (76, 1), (77, 2), (152, 2), (304, 2), (1000, 2)] {
            let parts = parts(rows);
            assert_eq!(parts.len(), count, "{rows}");
            assert!(parts.iter().all(|part| !part.is_empty()));
            assert_eq!(parts_are_alike(rows), rows != 77);
            assert_eq!(parts.into_iter().flatten().collect::<Vec<_>>(), (0..rows).collect::<Vec<_>>());
        }
    }

    #[test]
    fn inputs_lie_one_after_the_other_on_16_bytes() {
        let layout = InputBytes::new(3, [3, 21]);
        let InputBytes { rows: _, frames, places, columns, beliefs_to, previous_actions, numbers, carried, noise } =
            layout.clone();
        let parts = [frames, places, columns, beliefs_to, previous_actions, numbers, carried, noise];
        assert!(parts.is_sorted_by(|a, b| a.end <= b.start && b.start - a.end < 16));
        assert!(parts.iter().all(|part| part.start.is_multiple_of(16)));
        assert_eq!(layout.bytes(), parts[7].end);
        assert_eq!(parts[7].len(), 3 * 21 * 4);
    }
}
