//! The network: visual encoder, goal and action embeddings, belief, actor and critic (`docs/method.md`, Network; Ni et
//! al. section 3.1 and appendix B). In a task without a frame layers with hyperbolic tangents take the place of encoder
//! and embedding; without memory they are the heads' own. Other images than the frame have encoders of their own.
//!
//! Modules hold parameter ids and shapes; all tensors live in [`Parameters`]. A forward pass has two parts: the
//! embedding of each observation ([`Network::embed`]), then the belief and the heads.

mod belief;
mod distribution;
mod embedding;
mod encoder;
mod frame;
mod images;
mod initialize;
mod layers;
mod mlp;
mod normalizer;
mod parameters;

pub use belief::{Belief, Packing};
pub use distribution::Distribution;
pub(crate) use distribution::{FORBIDDEN_LOGIT, HALF_LN_TAU};
pub(crate) use embedding::table_row;
pub use embedding::{coordinates, goal_coordinates};
pub(crate) use encoder::{ENCODERS, VISUAL};
pub use frame::{FramePreparation, RawFrame, Staging};
pub(crate) use images::PATH as IMAGES;
pub use initialize::Initial;
pub(crate) use initialize::fill_normal;
pub(crate) use layers::{Linear, Recurrent};
pub(crate) use normalizer::{EPSILON as VARIANCE_EPSILON, is_among as has_normalizer};
pub use parameters::{Layout, ParameterId, Parameters, Unfit, to_vec};
pub(crate) use parameters::{all_finite, fits};

use crate::ffi::kernels::{Heads, Kernels};
use embedding::{ActionEmbedding, GoalEmbedding};
use encoder::{Backward, VisualEncoder};
use images::Images;
use mlp::{Head, Mlp};
use normalizer::Normalizer;
use proto::config::{Config, EncoderPrecision, Memory};
use std::fmt;
use tch::{Device, Kind, Tensor};

/// Width of an observation's embedding: visual embedding and goal embedding. They come first in the rows of
/// [`Network::embed`].
pub(crate) const OBSERVATION: i64 = VISUAL + embedding::GOAL;

/// Frames that go through the encoder at once on the CPU. What a few hundred leave behind stays near the cache and is
/// recycled by the allocator; with thousands at once the small encoder took twice as long.
const CPU_FRAMES: i64 = 192;

/// What a rollout keeps of observations on the device, one row for each.
#[derive(Debug)]
pub struct Kept {
    /// Kept frames, see [`FramePreparation`]; \[rows, side, side\]. Of side 0 in a task without a frame.
    pub frames: Tensor,
    /// Bytes of all other images, u8 \[rows, bytes\]; of none in a task without such images.
    pub images: Tensor,
}

impl Kept {
    /// Of tasks that have no images but the frame.
    pub fn of_frames(frames: Tensor) -> Self {
        let images = Tensor::zeros([frames.size()[0], 0], (Kind::Uint8, frames.device()));
        Self { frames, images }
    }

    pub(crate) fn rows(&self) -> i64 {
        self.frames.size()[0]
    }

    /// The same of each part.
    pub(crate) fn map(&self, part: impl Fn(&Tensor) -> Tensor) -> Self {
        Self { frames: part(&self.frames), images: part(&self.images) }
    }

    /// Each part beside that of another.
    pub(crate) fn parts<'a>(&'a self, other: &'a Self) -> [(&'a Tensor, &'a Tensor); 2] {
        [(&self.frames, &other.frames), (&self.images, &other.images)]
    }
}

/// The network's inputs, one row for each observation.
#[derive(Debug)]
pub struct Observations {
    pub kept: Kept,
    /// Numbers beside frames and images, see [`coordinates`]; f32 \[rows, numbers\]. Those of the critic alone come last.
    pub numbers: Tensor,
    /// Rows of the action embedding, see [`table_row`]; i64 \[rows\].
    pub previous_actions: Tensor,
}

impl Observations {
    pub(crate) fn copy(&self) -> Self {
        let Self { kept, numbers, previous_actions } = self;
        Self { kept: kept.map(Tensor::copy), numbers: numbers.copy(), previous_actions: previous_actions.copy() }
    }

    /// Takes the numbers of others, which are as many.
    pub(crate) fn take(&self, others: &Self) {
        let rest = [(&self.numbers, &others.numbers), (&self.previous_actions, &others.previous_actions)];
        let parts = self.kept.parts(&others.kept).into_iter().chain(rest);
        parts.for_each(|(own, other)| own.shallow_clone().copy_(other));
    }
}

#[derive(Debug)]
pub struct ActorCriticOutput {
    pub policy: Distribution,
    pub values: Tensor,
}

/// What embeds an observation.
#[derive(Debug)]
enum Embedding {
    Frame { encoder: Box<dyn VisualEncoder>, goal: GoalEmbedding },
    Numbers(Mlp),
}

#[derive(Debug)]
pub struct Network {
    pub parameters: Parameters,
    pub preparation: FramePreparation,
    pub belief: Belief,
    /// Width of what an observation gives by itself, which comes first in the rows of [`Network::embed`].
    observation: i64,
    /// How many of an observation's numbers the policy is given, and how many the critic alone.
    numbers: i64,
    privileged: i64,
    normalizer: Option<Normalizer>,
    embedding: Embedding,
    images: Images,
    previous_action: Option<ActionEmbedding>,
    actor: Head,
    policy: distribution::Maker,
    critic: Head,
}

/// The configuration demands bfloat16, and the encoder cannot compute in it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("learner.encoder_precision is \"bfloat16\": {0}")]
pub struct PrecisionError(String);

/// Embedded observations, and what their backward pass needs.
pub(crate) struct Embedded<'a> {
    /// One row an observation, see [`Network::embed`].
    pub rows: Tensor,
    /// See [`Network::privileged`].
    pub privileged: Option<Tensor>,
    /// Where autograd does not see the encoder: the visual embedding, at which autograd ends, and the encoder's own
    /// backward pass from there.
    fused: Option<(Tensor, Backward<'a>)>,
}

impl fmt::Debug for Embedded<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Embedded").field("rows", &self.rows).finish_non_exhaustive()
    }
}

impl Network {
    /// Builds the network that the configuration asks for, weights drawn from its seed. `declare` adds the parameters
    /// of what else is trained with it (an auxiliary head) and gets the belief's width.
    pub fn new<T>(config: &Config, device: Device, declare: impl FnOnce(&mut Layout, i64) -> T) -> (Self, T) {
        let mut layout = Layout::default();
        let preparation = FramePreparation::of(config, device);
        let action_head = config.action_head();
        let actions = action_head.outputs() as i64;
        let hidden = i64::from(config.network.hidden);
        let seen = config.spec().inputs().expect("a validated configuration's task has what networks take");
        let numbers = seen.policy_width() as i64;
        let privileged = seen.width() as i64 - numbers;
        let memory = config.network.memory;

        let normalize = config.normalize;
        let normalizer = (normalize.observations && seen.width() > 0)
            .then(|| Normalizer::new(&mut layout, numbers + privileged, normalize.observation_clip));
        // Layers that actor and critic share, and those that each has of its own.
        let (mut shared, mut own) = (&config.network.mlp[..], &[][..]);
        let (embedding, mut inputs) = if seen.frame.is_some() {
            let encoder = (encoder::entry(config.network.encoder).declare)(&mut layout, preparation.side());
            let goal = GoalEmbedding::new(&mut layout, "goal_embedder", numbers);
            (Embedding::Frame { encoder, goal }, OBSERVATION)
        } else {
            if numbers == 0 {
                shared = &[];
            } else if memory == Memory::None && seen.images.is_empty() {
                std::mem::swap(&mut shared, &mut own);
            }
            let mlp = Mlp::new(&mut layout, "mlp", numbers, shared, &config.network);
            let outputs = mlp.outputs();
            (Embedding::Numbers(mlp), outputs)
        };
        let observation = inputs;
        let images = Images::new(&mut layout, config);
        inputs += images.outputs();
        let previous_action = config.network.previous_action.then(|| {
            inputs += embedding::PREVIOUS_ACTION;
            ActionEmbedding::new(&mut layout, "previous_action_embedder", actions)
        });
        let belief = Belief::new(&mut layout, "belief", memory, [inputs, hidden]);
        let hidden = if memory == Memory::None { inputs } else { hidden };
        let mut head =
            |path: &str, sizes: [i64; 2], gain| Head::new(&mut layout, path, sizes, own, (&config.network, gain));
        let actor = head("actor", [hidden, actions], 0.01);
        let critic = head("critic", [hidden + privileged, 1], 1.0);
        let policy = distribution::Maker::new(&mut layout, &action_head, config.network.log_std);
        let declared = declare(&mut layout, hidden);

        let parameters = Parameters::new(layout, config.seed, device);
        let network = Self {
            parameters,
            preparation,
            belief,
            observation,
            numbers,
            privileged,
            normalizer,
            embedding,
            images,
            previous_action,
            actor,
            policy,
            critic,
        };
        (network, declared)
    }

    /// Selects bfloat16 for encoders if the configuration demands it, or if it is `auto` and there are kernels for it.
    pub(crate) fn choose_precision(&mut self, asked: EncoderPrecision) -> Result<(), PrecisionError> {
        let is_cuda = self.parameters.flat().device().is_cuda();
        let has_kernels = self.encoder().is_some_and(VisualEncoder::has_kernels);
        let fuse = |network: &mut Self| match &mut network.embedding {
            Embedding::Frame { encoder, .. } if has_kernels => encoder.fuse().map_err(|error| error.to_string()),
            _ => Ok(()),
        };
        match asked {
            EncoderPrecision::Float32 => Ok(()),
            EncoderPrecision::Auto => {
                if let Err(reason) = if is_cuda { fuse(self) } else { Ok(()) } {
                    tracing::warn!("the encoder computes in float32, which takes longer: {reason}");
                }
                Ok(())
            }
            EncoderPrecision::Bfloat16 if !has_kernels && self.images.are_none() => {
                Err(PrecisionError("only network.encoder \"resnet\" and images beside a frame have it".to_owned()))
            }
            EncoderPrecision::Bfloat16 if !is_cuda => Err(PrecisionError("it needs a CUDA device".to_owned())),
            EncoderPrecision::Bfloat16 => {
                self.images.use_bfloat16();
                fuse(self).map_err(PrecisionError)
            }
        }
    }

    /// What each observation gives by itself, of embeddings.
    pub(crate) fn observations_of(&self, embeddings: &Tensor) -> Tensor {
        embeddings.narrow(1, 0, self.observation)
    }

    /// The visual encoder, in a task with a frame.
    fn encoder(&self) -> Option<&dyn VisualEncoder> {
        match &self.embedding {
            Embedding::Frame { encoder, .. } => Some(&**encoder),
            Embedding::Numbers(_) => None,
        }
    }

    /// Whether the frame's encoder computes by kernels of our own, in bfloat16.
    pub(crate) fn is_fused(&self) -> bool {
        self.kernels().is_some()
    }

    /// Whether an encoder computes in bfloat16.
    pub(crate) fn is_in_bfloat16(&self) -> bool {
        self.is_fused() || self.images.are_in_bfloat16()
    }

    /// The kernels of our own, where the encoder computes with them.
    pub(crate) fn kernels(&self) -> Option<&Kernels> {
        self.encoder()?.kernels()
    }

    /// Renews what was derived from the weights, if they have changed. [`Network::embed`] does it by itself; a recorded
    /// one cannot.
    pub(crate) fn refresh(&self) {
        if let Some(encoder) = self.encoder() {
            encoder.refresh(&self.parameters);
        }
    }

    /// Embeddings of the observations: \[rows, 512 + 32\], or as wide as the last layer that sees numbers alone, and 16
    /// more with the previous action.
    pub fn embed(&self, observations: &Observations) -> Tensor {
        let scale_offset = FramePreparation::SCALE_OFFSET;
        let (parameters, frames) = (&self.parameters, &observations.kept.frames);
        let visual = self.encoder().and_then(|encoder| encoder.forward_fused(parameters, frames, scale_offset));
        self.embedded(observations, visual).rows
    }

    /// The same, for [`Network::gradient_of`] a loss that is made of it. One such pass is to be over before the next one
    /// begins. `update` is the number of the update that it is part of, see [`VisualEncoder::forward_to_train`].
    pub(crate) fn embed_to_train<'a>(&'a self, observations: &Observations, update: u64) -> Embedded<'a> {
        let (parameters, frames) = (&self.parameters, &observations.kept.frames);
        let scale_offset = FramePreparation::SCALE_OFFSET;
        let train = |encoder: &'a dyn VisualEncoder| encoder.forward_to_train(parameters, frames, scale_offset, update);
        self.embedded(observations, self.encoder().and_then(train))
    }

    /// With what the encoder made of the frames by itself, if it did.
    fn embedded<'a>(&'a self, observations: &Observations, visual: Option<(Tensor, Backward<'a>)>) -> Embedded<'a> {
        let Observations { kept: Kept { frames, images }, numbers, previous_actions } = observations;
        let privileged = self.privileged(observations);
        let numbers = &self.normalized(numbers).narrow(1, 0, self.numbers);
        let (encoder, goal) = match &self.embedding {
            Embedding::Frame { encoder, goal } => (encoder, goal),
            Embedding::Numbers(mlp) => {
                let seen = self.beside_images(mlp.forward(&self.parameters, numbers), images);
                return Embedded { rows: self.beside(seen, previous_actions), privileged, fused: None };
            }
        };
        let see = |kept: &Tensor| encoder.forward(&self.parameters, &self.preparation.input(kept));
        let (visual, fused) = match visual {
            Some((visual, backward)) => {
                let visual = visual.set_requires_grad(true);
                (visual.shallow_clone(), Some((visual, backward)))
            }
            None => (in_parts(frames, see), None),
        };
        let goal = self.beside_images(goal.forward(&self.parameters, numbers), images);
        let told = self.beside(goal, previous_actions);
        Embedded { rows: Tensor::cat(&[visual, told], 1), privileged, fused }
    }

    /// The visual embedding \[rows, 512\] of kept frames, where the encoder computes with kernels of our own.
    ///
    /// # Panics
    /// If it does not.
    pub(crate) fn seen(&self, frames: &Tensor) -> Tensor {
        let encoder = self.encoder().expect("an encoder with kernels");
        let fused = encoder.forward_fused(&self.parameters, frames, FramePreparation::SCALE_OFFSET);
        fused.expect("an encoder with kernels").0
    }

    /// Whether a step can be taken by kernels of our own: with memory, and without images or numbers of the critic alone.
    pub(crate) fn acts_in_parts(&self) -> bool {
        self.belief.state() > 0 && self.images.are_none() && self.privileged == 0
    }

    /// What stands beside it in a row of [`Network::embed`]: embeddings of the numbers and, if the network has them, of
    /// previous actions.
    ///
    /// # Panics
    /// In a task without a frame.
    pub(crate) fn told(&self, numbers: &Tensor, previous_actions: &Tensor) -> Tensor {
        let Embedding::Frame { goal, .. } = &self.embedding else { panic!("numbers stand beside a frame") };
        self.beside(goal.forward(&self.parameters, &self.normalized(numbers)), previous_actions)
    }

    /// What the critic alone is given of observations \[rows, privileged\], if there is something: the asymmetric
    /// actor-critic (Pinto et al. 2018).
    pub fn privileged(&self, observations: &Observations) -> Option<Tensor> {
        let its_own = || self.normalized(&observations.numbers).narrow(1, self.numbers, self.privileged);
        (self.privileged > 0).then(its_own)
    }

    fn normalized(&self, numbers: &Tensor) -> Tensor {
        let normalizer = self.normalizer.as_ref();
        normalizer.map_or_else(|| numbers.shallow_clone(), |one| one.forward(&self.parameters, numbers))
    }

    /// Takes mean and variance of each number, if it normalises them.
    pub(crate) fn normalize_by(&self, known: &[[f32; 2]]) {
        if let Some(normalizer) = &self.normalizer {
            normalizer.set(&self.parameters, known);
        }
    }

    /// With what encoders make of images, if there are some.
    fn beside_images(&self, embedded: Tensor, images: &Tensor) -> Tensor {
        if self.images.are_none() {
            return embedded;
        }
        let see = |images: &Tensor| Tensor::cat(&self.images.forward(&self.parameters, images), 1);
        Tensor::cat(&[embedded, in_parts(images, see)], 1)
    }

    /// Images but the frame, and how they lie in the rows of a store.
    pub(crate) fn images(&self) -> &Images {
        &self.images
    }

    /// An empty store of so many rows.
    pub(crate) fn store(&self, rows: i64) -> Kept {
        let device = self.parameters.flat().device();
        Kept { frames: self.preparation.store(rows), images: self.images.store(rows, device) }
    }

    /// With the embeddings of previous actions, if the network has them.
    fn beside(&self, embedded: Tensor, previous_actions: &Tensor) -> Tensor {
        match &self.previous_action {
            Some(embedding) => Tensor::cat(&[embedded, embedding.forward(&self.parameters, previous_actions)], 1),
            None => embedded,
        }
    }

    /// Gradient of a loss, flat, in the order of [`Parameters::flat`]. `embedded` are the embeddings that the loss was
    /// computed from.
    pub(crate) fn gradient_of(&self, loss: &Tensor, embedded: Embedded) -> Tensor {
        let Embedded { rows, fused, .. } = embedded;
        match fused {
            Some((visual, backward)) => {
                // The graph keeps what it needs.
                drop(rows);
                self.parameters.gradient_through(loss, &visual, backward)
            }
            None => self.parameters.gradient_of(loss),
        }
    }

    /// What decides when it acts in kernels of our own.
    pub(crate) fn heads(&self) -> Heads<'_> {
        let of = |head: &Head| {
            let Linear { weight, bias } = head.last();
            [weight, bias].map(|id| &self.parameters[id])
        };
        let gate_biases = self.belief.recurrent().biases(&self.parameters);
        let log_std = self.policy.log_std(&self.parameters);
        Heads { gate_biases, actor: of(&self.actor), critic: of(&self.critic), log_std }
    }

    /// One step: observations and the belief's states before them \[rows, state\] → states after them, and of each row
    /// what an action is drawn from ([`Distribution::rows`]), and behind it the value. `masks` as
    /// [`Network::actor_critic`] has them.
    pub(crate) fn judge(
        &self,
        observations: &Observations,
        before: &Tensor,
        masks: Option<&Tensor>,
    ) -> (Tensor, Tensor) {
        let states = self.belief.step(&self.parameters, &self.embed(observations), before);
        let privileged = self.privileged(observations);
        let ActorCriticOutput { policy, values } =
            self.actor_critic(&self.belief.of(&states), privileged.as_ref(), masks);
        (states, Tensor::cat(&[policy.rows(), values.unsqueeze(1)], 1))
    }

    /// Beliefs \[rows, hidden\], or embeddings without memory → policy and value. `privileged`: see
    /// [`Network::privileged`]; `masks` are true where an option may be chosen, \[rows, options\].
    pub fn actor_critic(
        &self,
        beliefs: &Tensor,
        privileged: Option<&Tensor>,
        masks: Option<&Tensor>,
    ) -> ActorCriticOutput {
        let judged = privileged.map_or_else(|| beliefs.shallow_clone(), |more| Tensor::cat(&[beliefs, more], 1));
        let outputs = self.actor.forward(&self.parameters, beliefs);
        ActorCriticOutput {
            policy: self.policy.distribution(&self.parameters, outputs, masks),
            values: self.critic.forward(&self.parameters, &judged).squeeze_dim(1),
        }
    }
}

/// What is made of frames or images; on the CPU of some at a time.
fn in_parts(rows: &Tensor, see: impl Fn(&Tensor) -> Tensor) -> Tensor {
    if rows.device() != Device::Cpu || rows.size()[0] <= CPU_FRAMES {
        return see(rows);
    }
    let parts = rows.split(CPU_FRAMES, 0);
    Tensor::cat(&parts.iter().map(see).collect::<Vec<_>>(), 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::Encoder;
    use std::collections::BTreeSet;

    fn network(change: impl FnOnce(&mut Config)) -> Network {
        let mut config = Config::default();
        change(&mut config);
        Network::new(&config, Device::Cpu, |_, _| ()).0
    }

    #[test]
    fn the_papers_network_has_the_size_that_was_measured() {
        // 5.80 M with heads: the figure of the PyTorch twin in tests/reference.
        let count = network(|_| {}).parameters.count();
        assert!((5_700_000..5_900_000).contains(&count), "{count}");
    }

    #[test]
    fn a_parameters_start_does_not_depend_on_the_other_modules() {
        let with = network(|config| config.network.hidden = 64);
        let without = network(|config| {
            config.network.hidden = 64;
            config.network.previous_action = false;
        });
        let weights = |network: &Network| -> Vec<(String, Vec<f32>)> {
            network.parameters.named().map(|(name, tensor)| (name.to_owned(), to_vec(&tensor))).collect()
        };
        let with = weights(&with);
        let shared = weights(&without).into_iter().filter(|(name, _)| name != "belief.weight_ih_l0");
        assert!(shared.into_iter().all(|entry| with.contains(&entry)));
    }

    #[test]
    fn no_two_parameters_share_a_random_stream() {
        for encoder in [Encoder::Resnet, Encoder::Cnn] {
            let network = network(|config| {
                config.network.encoder = encoder;
                config.network.hidden = 16;
            });
            let names: Vec<&str> = network.parameters.named().map(|(name, _)| name).collect();
            let numbers: BTreeSet<u32> = names.iter().map(|name| initialize::number_of(name)).collect();
            assert_eq!(names.len(), numbers.len());
        }
    }

    /// The encoder's two ways agree as far as bfloat16 goes. `cargo nextest run --release --workspace --run-ignored
    /// only`.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn kernels_make_the_network_that_autograd_makes() {
        let _alone = crate::device::cuda_alone();
        let device = Device::Cuda(0);
        let build = || Network::new(&Config::default(), device, |_, _| ()).0;
        let (plain, mut fused) = (build(), build());
        let Embedding::Frame { encoder, .. } = &mut fused.embedding else { panic!("a frame") };
        encoder.fuse().unwrap();
        tch::manual_seed(2);
        let float = (Kind::Float, device);
        // Walls and edges, not noise.
        let depth_mm = (Tensor::rand([64, 1, 8, 8], float) * 4000.0 + 300.0).upsample_nearest2d([112, 112], None, None);
        let observations = Observations {
            kept: Kept::of_frames(depth_mm.squeeze_dim(1).round()),
            numbers: Tensor::randn([64, 3], float),
            previous_actions: Tensor::zeros([64], (Kind::Int64, device)),
        };
        let towards = Tensor::randn([64, OBSERVATION + embedding::PREVIOUS_ACTION], float);
        let pass = |network: &Network| {
            let embedded = network.embed_to_train(&observations, 0);
            let rows = embedded.rows.detach();
            let loss = (&embedded.rows * &towards).sum(Kind::Float);
            (rows, network.gradient_of(&loss, embedded))
        };
        let ((rows, gradient), (expected_rows, expected)) = (pass(&fused), pass(&plain));
        let error = (&rows - &expected_rows).norm().double_value(&[]) / expected_rows.norm().double_value(&[]);
        assert!(error < 0.03, "embeddings differ by {error}");
        let cosine = gradient.dot(&expected).double_value(&[])
            / (gradient.norm().double_value(&[]) * expected.norm().double_value(&[]));
        assert!(cosine > 0.98, "gradients agree only to a cosine of {cosine}");
        // Acting sees what training sees.
        let acting = tch::no_grad(|| fused.embed(&observations));
        assert!(acting.allclose(&rows, 1e-6, 1e-6, false));
    }
}
