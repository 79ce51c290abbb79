//! Acting by kernels: from frames in the actors' shared memory, which the GPU reads itself, to sampled actions in the
//! host's.

use super::batch::{Policy, Rows};
use super::graphs::StepGraphs;
use super::inputs::{Inputs, There};
use super::reach::Reach;
use crate::agent::sampling::{Sampled, forbid, normalize, sample};
use crate::ffi::branches::Branches;
use crate::ffi::graph::GraphError;
use crate::ffi::kernels::{ActingKernels, CHOSEN_WORDS, Chosen, Kernels, Source, Undecided};
use crate::network::Staging;
use proto::camera::DepthFrame;
use proto::task::{ActionHead, PolicyAction};
use std::ops::Range;
use tch::{Device, Kind, Tensor};

/// A batch of more rows goes through the encoder in two parts, beside one another: the GPU computes with the first
/// frames while it reads the others from the host's memory, and small kernels of both share it. Each part costs
/// launches of its own: more than two were slower on an H200 (BENCHMARKS.md).
const PART_ROWS: usize = 76;
const MOST_PARTS: usize = 2;

#[derive(Debug)]
pub(in crate::agent) struct ByKernels {
    graphs: StepGraphs,
    branches: Branches,
    reach: Reach,
    /// Frames that the GPU cannot read where they are.
    staging: Staging,
    device: Device,
}

/// How rows are chosen for.
#[derive(Debug, Clone, Copy)]
struct Chooser<'a> {
    policy: Policy<'a>,
    /// Kernels choose an action, too; otherwise the host does.
    there: bool,
}

impl Chooser<'_> {
    /// Numbers of a row of what a step leaves for the host.
    fn words(self) -> usize {
        if self.there { CHOSEN_WORDS } else { self.policy.outputs() }
    }

    /// What was chosen for a row, or is now.
    fn read(self, row: &mut [f32], mask: &[bool], noise: &[f32]) -> Sampled {
        if self.there {
            let Chosen { log_prob, value, action, finite } = Chosen::from_words(row);
            return Sampled { action: PolicyAction::Options(vec![action as i64]), log_prob, value, finite };
        }
        let finite = row.iter().all(|number| number.is_finite());
        let (value, row) = row.split_last_mut().expect("a row has at least the value");
        let head = self.policy.head;
        forbid(mask, row);
        normalize(head, row);
        let (action, log_prob) = sample(head, row, noise);
        Sampled { action, log_prob, value: *value, finite }
    }
}

impl ByKernels {
    pub(super) fn new(graphs: StepGraphs, device: Device) -> Result<Self, GraphError> {
        Ok(Self {
            graphs,
            branches: Branches::open(MOST_PARTS)?,
            reach: Reach::open()?,
            staging: Staging::default(),
            device,
        })
    }

    pub fn recheck_memory(&mut self) {
        self.reach.recheck();
    }

    pub fn step(&mut self, policy: Policy, rows: Rows) -> Result<Vec<Sampled>, GraphError> {
        let kernels = policy.network.kernels().expect("a network that acts by kernels");
        let addresses = self.addresses(kernels, rows.frames);
        let Rows { noise, places, columns, beliefs_to, steps, .. } = rows;
        let few = matches!(policy.head, ActionHead::Discrete(named) if ActingKernels::can_choose(named.len()));
        let chooser = Chooser { policy, there: few && steps[0].mask.is_empty() };
        let inputs = Inputs { addresses: &addresses, masks: &[], noise, places, columns, beliefs_to, steps };
        let Self { graphs, branches, .. } = self;
        let launch = |there: &There, choices: &Tensor| launch(chooser, (kernels, branches), there, choices);
        let words = graphs.step(policy.left(), &inputs, chooser.words(), launch)?;
        let noise = noise.chunks_exact(noise.len() / steps.len());
        let rows = words.chunks_exact_mut(chooser.words()).zip(steps).zip(noise);
        Ok(rows.map(|((row, step), noise)| chooser.read(row, &step.mask, noise)).collect())
    }

    /// Where the GPU finds the frames: where they are if it can read them there, or in pinned memory.
    fn addresses(&mut self, kernels: &Kernels, frames: &[DepthFrame]) -> Vec<i64> {
        let sources: Vec<Source> = frames.iter().map(|frame| kernels.acting.source(frame)).collect();
        if self.reach.covers(sources.iter().map(|source| source.bytes())) {
            return sources.into_iter().map(Source::word).collect();
        }
        let gathered = self.staging.gather(frames, self.device);
        gathered.iter().map(|frame| kernels.acting.source(frame).word()).collect()
    }

    #[cfg(test)]
    pub(super) fn graphs(&mut self) -> &mut StepGraphs {
        &mut self.graphs
    }
}

/// Launches a step's kernels on this thread's stream.
fn launch(
    chooser: Chooser,
    (kernels, branches): (&Kernels, &Branches),
    there: &There,
    choices: &Tensor,
) -> Result<(), GraphError> {
    let Policy { network, beliefs, store, .. } = chooser.policy;
    let (layout, store) = (there.layout, &store.frames);
    let side = store.size()[1];
    let kept = Tensor::empty([layout.rows as i64, side, side], (Kind::Float, store.device()));
    let (frames, places) = (there.part(&layout.addresses, Kind::Int64), there.part(&layout.places, Kind::Int64));
    let recurrent = network.belief.recurrent();
    let (seen, told, before, from_before) = branches.joined(|branches| {
        let mut seen = vec![];
        let parts = parts(layout.rows);
        let alone = parts.len() == 1;
        // The encoder sees the first frames while others are on their way.
        for rows in parts {
            let of = |tensor: &Tensor| tensor.narrow(0, rows.start as i64, rows.len() as i64);
            let kept = of(&kept);
            // SAFETY: `Inputs` has the addresses of `addresses` and rows of this store.
            unsafe { kernels.acting.observe(&of(&frames), &of(&places), &kept, store, alone) };
            seen.push(branches.fork(|| network.seen(&kept))?);
        }
        // Beside the encoder, too.
        let numbers = there.table(&layout.numbers, Kind::Float);
        let told = network.told(&numbers, &there.part(&layout.previous_actions, Kind::Int64));
        let before = beliefs.index_select(0, &there.part(&layout.columns, Kind::Int64))
            * there.part(&layout.carried, Kind::Float).unsqueeze(1);
        let from_before = recurrent.state_gates(&network.parameters, &before);
        Ok::<_, GraphError>((seen, told, before, from_before))
    })?;
    let embedded = Tensor::cat(&[Tensor::cat(&seen, 0), told], 1);
    let from_input = recurrent.input_gates(&network.parameters, &embedded);
    let noise = there.table(&layout.noise, Kind::Float);
    let row = Undecided { from_input: &from_input, from_before: &from_before, before: &before, noise: &noise };
    let to = there.part(&layout.beliefs_to, Kind::Int64);
    let heads = network.heads();
    // SAFETY: `Inputs` has rows of the table.
    unsafe {
        if chooser.there {
            kernels.acting.decide(&heads, &row, &to, beliefs, choices);
        } else {
            kernels.acting.answer(&heads, &row, &to, beliefs, choices);
        }
    }
    Ok(())
}

/// Rows of a batch that go through the encoder together.
fn parts(rows: usize) -> Vec<Range<usize>> {
    let count = rows.div_ceil(PART_ROWS).min(MOST_PARTS);
    let end = |part: usize| part * rows / count;
    (0..count).map(|part| end(part)..end(part + 1)).collect()
}

/// Whether the parts of such a batch are equally long: only then does it not matter in which a row is.
pub(in crate::agent) fn parts_are_alike(rows: usize) -> bool {
    let parts = parts(rows);
    parts.iter().all(|part| part.len() == parts[0].len())
}

#[cfg(test)]
mod tests {
    use super::super::Acting;
    use super::*;
    use crate::agent::Agent;
    use crate::bench::Frames;
    use proto::config::Config;
    use proto::stage::RolloutShape;

    /// Whether steps were taken, each by a graph.
    fn is_recorded(agent: &mut Agent) -> bool {
        agent.acting.as_mut().is_some_and(Acting::is_recorded)
    }

    /// Whether steps were taken, each with frames where actors wrote them.
    fn has_copied_nothing(agent: &Agent) -> bool {
        let Some(Acting::Kernels(kernels)) = &agent.acting else { return false };
        kernels.graphs.has_stepped() && !kernels.reach.missed
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
            assert!(is_recorded(&mut graph) && has_copied_nothing(&graph));
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
            refused.acting.as_mut().unwrap().refuse();
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
            assert!(is_recorded(&mut recorded) && !is_recorded(&mut refused));
            assert_eq!([&recorded, &refused].map(has_copied_nothing), [false, true]);
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
}
