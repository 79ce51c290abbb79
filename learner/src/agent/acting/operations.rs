//! Acting by libtorch's operations, one graph for all of them: launched one by one, those of a small network take the host
//! ten times as long as they take the GPU.

use super::batch::{Policy, Rows};
use super::graphs::StepGraphs;
use super::inputs::{Inputs, There};
use super::reach::Reach;
use crate::agent::sampling::{Sampled, sample};
use crate::ffi::graph::GraphError;
use crate::ffi::kernels::RowKernels;
use crate::network::{Kept, Network, Observations, Staging};
use tch::{Device, Kind, Tensor};

#[derive(Debug)]
pub(in crate::agent) struct ByOperations {
    graphs: StepGraphs,
    kernels: RowKernels,
    /// Kept frames of a batch, \[columns, side, side\]: graphs know the address.
    frames: Tensor,
    staging: Staging,
    /// None where there are no images but a frame, or the host has to check them.
    reach: Option<Reach>,
    /// Images that the GPU cannot read where they are: rows of bytes in pinned memory.
    images: Tensor,
    device: Device,
}

impl ByOperations {
    pub(super) fn new(graphs: StepGraphs, network: &Network, columns: usize) -> Result<Self, GraphError> {
        let (frames, device) = (network.preparation.store(columns as i64), network.parameters.flat().device());
        let in_place = !network.images().are_none() && network.images().are_whole_numbers();
        Ok(Self {
            graphs,
            kernels: RowKernels::compile()?,
            frames,
            staging: Staging::default(),
            reach: in_place.then(Reach::open).transpose()?,
            images: network.images().store(0, Device::Cpu),
            device,
        })
    }

    pub fn recheck_memory(&mut self) {
        if let Some(reach) = &mut self.reach {
            reach.recheck();
        }
    }

    pub fn step(&mut self, policy: Policy, rows: Rows) -> Result<Vec<Sampled>, GraphError> {
        let addresses = self.addresses(policy.network, rows);
        let Self { graphs, kernels, frames, staging, .. } = self;
        let Rows { noise, places, columns, beliefs_to, steps, .. } = rows;
        let frames = frames.narrow(0, 0, steps.len() as i64);
        if !rows.frames.is_empty() {
            frames.shallow_clone().copy_(&policy.network.preparation.keep(rows.frames, staging));
        }
        let masks: Vec<bool> = steps.iter().flat_map(|step| &step.mask).copied().collect();
        let inputs = Inputs { addresses: &addresses, masks: &masks, noise: &[], places, columns, beliefs_to, steps };
        let launch = |there: &There, outputs: &Tensor| {
            launch(policy, kernels, &frames, there, outputs);
            Ok(())
        };
        let outputs = graphs.step(policy.left(), &inputs, policy.outputs(), launch)?;
        let outputs = outputs.chunks_exact(policy.outputs()).zip(noise.chunks_exact(policy.head.outputs()));
        let choose = |(row, noise): (&[f32], &[f32])| {
            let finite = row.iter().all(|number| number.is_finite());
            let (&value, row) = row.split_last().expect("a row has at least the value");
            let (action, log_prob) = sample(policy.head, row, noise);
            Sampled { action, log_prob, value, finite }
        };
        Ok(outputs.map(choose).collect())
    }

    /// Where the GPU finds the images, as [`Inputs`] has them: where actors wrote them if it can read them there, or in
    /// pinned memory.
    fn addresses(&mut self, network: &Network, Rows { images, steps, .. }: Rows) -> Vec<i64> {
        let (of_network, rows) = (network.images(), steps.len());
        if of_network.are_none() {
            return vec![];
        }
        let place = |image: &&[u8]| (image.as_ptr() as usize, image.len());
        if self.reach.as_mut().is_some_and(|reach| reach.covers(images.iter().map(place))) {
            let each = of_network.places().len();
            let of = |image: usize| images[image..].iter().step_by(each).map(|image| image.as_ptr() as i64);
            return (0..each).flat_map(of).collect();
        }
        let gathered = of_network.gather(images, rows);
        if self.images.size()[0] < rows as i64 {
            self.images = gathered.pin_memory(self.device);
        } else {
            self.images.narrow(0, 0, rows as i64).copy_(&gathered);
        }
        let (first, stride) = (self.images.data_ptr() as usize, self.images.size()[1] as usize);
        let of = |begin: usize| (0..rows).map(move |row| (first + row * stride + begin) as i64);
        of_network.places().flat_map(|place| of(place.start)).collect()
    }

    #[cfg(test)]
    pub(super) fn graphs(&mut self) -> &mut StepGraphs {
        &mut self.graphs
    }
}

fn launch(policy: Policy, kernels: &RowKernels, frames: &Tensor, there: &There, outputs: &Tensor) {
    let Policy { network, beliefs: table, store, .. } = policy;
    let (layout, rows) = (there.layout, frames.size()[0]);
    let kept = Kept { frames: frames.shallow_clone(), images: network.images().store(rows, frames.device()) };
    for (image, bytes) in (0..).zip(network.images().places()) {
        let addresses = there.part(&layout.addresses, Kind::Int64).narrow(0, image * rows, rows);
        // SAFETY: these are the addresses of `ByOperations::addresses`.
        unsafe { kernels.gather(&addresses, bytes, &kept.images) };
    }
    let numbers = there.table(&layout.numbers, Kind::Float);
    let previous_actions = there.part(&layout.previous_actions, Kind::Int64);
    let observations = Observations { kept, numbers, previous_actions };
    let before = table.index_select(0, &there.part(&layout.columns, Kind::Int64))
        * there.part(&layout.carried, Kind::Float).unsqueeze(1);
    let masks = (!layout.masks.is_empty()).then(|| there.table(&layout.masks, Kind::Bool));
    let (states, judged) = network.judge(&observations, &before, masks.as_ref());
    let places = there.part(&layout.places, Kind::Int64);
    let beliefs_to = there.part(&layout.beliefs_to, Kind::Int64);
    // SAFETY: `Inputs` has rows of this store and of this table.
    unsafe {
        for (store, new) in store.parts(&observations.kept) {
            kernels.scatter(new, &places, store);
        }
        if table.size()[1] > 0 {
            kernels.scatter(&states, &beliefs_to, table);
        }
    }
    kernels.copy(&judged, outputs);
}

#[cfg(test)]
mod tests {
    use super::super::Acting;
    use crate::agent::Agent;
    use crate::bench::Frames;
    use proto::config::{Config, Encoder};
    use proto::stage::RolloutShape;
    use proto::task::Spec;
    use tch::Device;

    /// Its images are whole numbers alone.
    const IN_PLACE: &str = "in_place";

    /// Images and numbers, with each memory and each kind of action, and frames with an encoder that has no kernels.
    fn configs() -> Vec<(&'static str, Config)> {
        let images = include_str!("../../../tests/support/images.toml");
        let discrete = "kind = \"discrete\"\nnames = [\"left\", \"stay\", \"right\"]";
        let masked = "kind = \"multi_discrete\"\ncounts = [2, 3]\n\n[[channels]]\nname = \"action_mask\"\n\
            role = \"mask\"\ndtype = \"u8\"\nshape = [5]\ndoc = \"\"";
        let numbers = "kind = \"box\"\nbounds = [[-1, 1], [0, 2]]";
        let (checked, sound) =
            ("dtype = \"f32\"\nshape = [2, 45, 36]\nrange = [-1, 1]", "dtype = \"u8\"\nshape = [2, 45, 36]");
        let of = |name: &'static str, actions: &str, settings: &str| {
            let images = if name == IN_PLACE { images.replacen(checked, sound, 1) } else { images.to_owned() };
            let named = images.replacen("\"images\"", &format!("\"acting_{name}\""), 1);
            Spec::declare(&named.replacen(discrete, actions, 1)).unwrap();
            let settings = format!("task = \"acting_{name}\"\n{settings}");
            (name, Config::resolve_with("gym", Some((&settings, "a test"))).unwrap())
        };
        let mut frames = Config::resolve("demo", None).unwrap();
        frames.network.encoder = Encoder::Cnn;
        vec![
            of("plain", discrete, "network.memory = \"none\""),
            of(IN_PLACE, discrete, "network.memory = \"none\""),
            of("bfloat16", discrete, "network.memory = \"none\"\nlearner.encoder_precision = \"bfloat16\""),
            of("gru", masked, "network.memory = \"gru\""),
            of("lstm", numbers, "network.memory = \"lstm\"\nnormalize.observations = true"),
            ("frames", frames),
        ]
    }

    /// To the last bit, by a graph, and where nothing can be recorded.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn a_step_by_a_graph_is_the_step_that_operations_make() {
        const STEPS: usize = 3;
        let _alone = crate::device::cuda_alone();
        for (name, mut config) in configs() {
            (config.actors.count, config.actors.environments_per_actor) = (3, 5);
            let frames = Frames::new(&config).unwrap();
            let mut agents = [(); 3].map(|()| Agent::new(&config, Device::Cuda(0)).unwrap());
            agents[1].acting.as_mut().unwrap().refuse();
            agents[2].acting = None;
            for agent in &mut agents {
                agent.begin_rollout(RolloutShape::next(3 * 15 - 4, STEPS, config.environments()));
            }
            let options = config.spec().mask().map_or(0, |_| config.action_head().outputs());
            for (t, half) in (0..=STEPS).flat_map(|t| [(t, 0), (t, 1)]) {
                let mut batch = frames.batch(half, t, frames.noise(half, t));
                let allowed = |at: usize| at % options % 3 != t % 3;
                batch.masks = (0..options * batch.columns.len()).map(allowed).collect();
                let [graph, refused, plain] = &mut agents;
                let outputs = [graph, refused, plain].map(|agent| agent.step(t, &batch.input()).unwrap());
                assert!(
                    outputs.iter().all(|output| *output == outputs[2]),
                    "{name}, step {t} of half {half}: {outputs:?}"
                );
                assert!(outputs[0].values.iter().any(|&value| value != 0.0));
            }
            let recorded = agents.each_mut().map(|agent| agent.acting.as_mut().is_some_and(Acting::is_recorded));
            assert_eq!(recorded, [true, false, false], "{name}");
            let [graph, refused, plain] = &agents;
            // What the first has registered with the driver the second cannot, and copies.
            let expected = if name == IN_PLACE { [Some(false), Some(true)] } else { [None; 2] };
            let missed = |agent: &Agent| match &agent.acting {
                Some(Acting::Operations(operations)) => operations.reach.as_ref().map(|reach| reach.missed),
                _ => None,
            };
            assert_eq!([graph, refused].map(missed), expected, "{name}");
            for agent in [graph, refused] {
                assert!(agent.beliefs.equal(&plain.beliefs), "{name}: beliefs");
                for (part, expected) in agent.rollout_tensors() {
                    let found = plain.rollout_tensors().remove(&part).unwrap().nan_to_num(7.0, None, None);
                    assert!(found.equal(&expected.nan_to_num(7.0, None, None)), "{name}: {part}");
                }
            }
        }
    }
}
