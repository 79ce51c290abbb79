//! Proximal policy optimisation (Schulman et al. 2017) as DD-PPO runs it (Wijmans et al. 2020), on one page.
//!
//! Acting fills a rollout of T steps × N environments ([`crate::agent::Agent::step`]). [`Update::run`] trains on it:
//!
//! ```text
//! targets: advantages and returns by GAE              gae.rs
//! minibatches and their chunks                        minibatch.rs; of frames, anew in each epoch
//! for each epoch:
//!     for each minibatch:
//!         for each chunk:
//!             forward: encoder, GRU, actor, critic    network/
//!             loss: policy, value, entropy            loss.rs
//!                   + auxiliary task                  auxiliary/
//!             backward
//!         sum of the gradients over shards, learners  tree.rs, peers.rs
//!         clip, Adam                                  optimizer.rs
//! figures, and whether all was finite                 metrics.rs
//! ```
//! With one minibatch, as in the reference, an epoch is one step of the optimiser with the gradient of the whole batch;
//! `ppo.minibatches` makes it several, and `ppo.target_kl` leaves epochs out. Chunks only bound memory
//! (`ppo.environments_per_pass`): their gradients add up before the step. With `learner.shards` all of it goes by shard
//! ([`crate::shards`]).
//!
//! Shapes in comments: T steps, N environments of this learner, B rows of a chunk, A actions, H width of the belief, W
//! weights. A minibatch has the frames of all learners.
//!
//! Beside the update: the multiplier of PPO-Lagrangian ([`lagrangian`]), the rule for stragglers ([`preemption`]), the
//! figures ([`metrics`]), and running statistics of what was met ([`running`]).

pub mod gae;
pub(crate) mod lagrangian;
pub mod loss;
pub mod metrics;
pub(crate) mod minibatch;
pub mod moments;
pub(crate) mod preemption;
mod recorded;
pub mod running;
mod tree;

use crate::auxiliary::{Auxiliary, Epoch, Pass, Query, count};
use crate::network::{Embedded, Network, Packing};
use crate::optimizer::{Adam, clip, norm};
use crate::peers::{PeerError, Peers};
use crate::rollout::Rollout;
use crate::shards::Shards;
use loss::{Coefficients, Terms, terms};
use metrics::{SCALARS, StepMetrics, StepSums, UpdateSums, means};
use minibatch::{Chunk, Deal, Whole};
use moments::RewardScale;
use proto::config::{AuxiliaryConfig, PpoConfig, Shuffle};
use proto::metric;
pub(crate) use recorded::PassGraphs;
use recorded::{Inputs, Passed};
use std::cell::RefCell;
use std::collections::BTreeMap;
use tch::Tensor;
use tree::Tree;

/// When an update looks at its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Look {
    /// When it is through: until then nobody waits for a number of the GPU.
    AtTheEnd,
    /// After each step, too, when its gradient is still there.
    AtEachStep,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Update<'a> {
    pub network: &'a Network,
    pub auxiliary: &'a Auxiliary,
    pub rollout: &'a Rollout,
    pub ppo: &'a PpoConfig,
    pub auxiliary_config: &'a AuxiliaryConfig,
    pub peers: &'a Peers,
    /// The rollout's columns as shards, which are computed by themselves.
    pub shards: &'a Shards,
    pub reward_scale: RewardScale,
    /// Number, in the whole run, of the rollout's first column.
    pub first_column: usize,
    pub learning_rate: f64,
    pub seed: u64,
    pub rollout_number: u64,
    /// Passes that were recorded in other updates; none where nothing is to be.
    pub graphs: Option<&'a RefCell<PassGraphs>>,
}

/// Rows of a minibatch: frames of this learner.
fn rows(chunks: &[Chunk]) -> u64 {
    chunks.iter().map(|chunk| chunk.packing.rows.len() as u64).sum()
}

#[derive(Debug, thiserror::Error)]
pub enum UpdateError {
    #[error("{0} is not finite")]
    NonFinite(String),
    #[error(transparent)]
    Peers(#[from] PeerError),
}

/// What makes losses means over the minibatch of all learners.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Totals<'a> {
    /// With the share of a frame.
    pub coefficients: &'a Coefficients,
    /// Queries to the auxiliary task of its rows in this epoch.
    pub queries: u64,
}

/// A chunk's part of the loss of its minibatch.
struct Loss<'a> {
    total: Tensor,
    embedded: Embedded<'a>,
    /// In the order of [`SCALARS`].
    scalars: [Tensor; SCALARS.len()],
    /// What the auxiliary task counted.
    counted: Vec<Tensor>,
}

impl<'a> Update<'a> {
    /// Runs all epochs and returns the figures by name. On an error weights and moments are as they were before.
    pub(crate) fn run(&self, adam: &mut Adam) -> Result<BTreeMap<String, f64>, UpdateError> {
        // [W], the network's own storage: writing to it changes the weights.
        let mut weights = self.network.parameters.flat();
        let (weights_before, adam_before) = (weights.copy(), adam.copy());
        let mut attempt = |look| {
            self.peers.count_anew();
            self.epochs(&mut weights, adam, look).inspect_err(|_| {
                tch::no_grad(|| {
                    adam.restore(&adam_before);
                    weights.copy_(&weights_before);
                });
            })
        };
        match attempt(Look::AtTheEnd) {
            // All learners find it alike, and make the update again to name the weight. If a fault of the hardware has
            // passed meanwhile, it is made.
            Err(UpdateError::NonFinite(name)) if name == metric::GRADIENT_NORM => {
                tracing::warn!("rollout {}: a gradient is not finite: the update is made again", self.rollout_number);
                attempt(Look::AtEachStep)
            }
            done => done,
        }
    }

    fn epochs(&self, weights: &mut Tensor, adam: &mut Adam, look: Look) -> Result<BTreeMap<String, f64>, UpdateError> {
        // Advantages and returns, [T, N].
        let targets = gae::estimate(self.rollout, self.ppo, self.reward_scale, self.shards, self.peers)?;
        let whole = Whole::new(self.rollout, &targets);
        let shards = self.shards;
        // Minibatches, and the loss's coefficients for each; none where no learner has a column of it.
        let (mut minibatches, mut coefficients) = (vec![], vec![]);
        let factors = adam.factors(self.ppo.epochs as usize * self.ppo.minibatches as usize, self.learning_rate);
        let (mut sums, mut taken) = (UpdateSums::default(), 0);

        for epoch in 0..self.ppo.epochs {
            if epoch > 0 && self.is_far(&sums)? {
                break;
            }
            if epoch == 0 || self.ppo.shuffle == Shuffle::Rows {
                minibatches = self.minibatches(&whole, epoch);
                if self.ppo.normalize_advantages && self.ppo.normalize_by_minibatch {
                    for chunks in &mut minibatches {
                        Chunk::normalize(chunks, &targets, shards, self.peers)?;
                    }
                }
                let frames = self.peers.totals(minibatches.iter().map(|chunks| rows(chunks)))?;
                let of = |frames| (frames > 0).then(|| Coefficients::of(self.ppo, frames, weights.device()));
                coefficients = frames.into_iter().map(of).collect::<Vec<_>>();
            }
            let packings: Vec<&Packing> = minibatches.iter().flatten().map(|chunk| &chunk.packing).collect();
            let mut queries = self.auxiliary.queries(&packings, self.epoch(epoch), self.peers)?.into_iter();
            let queries: Vec<Vec<Vec<Query>>> =
                minibatches.iter().map(|chunks| queries.by_ref().take(chunks.len()).collect()).collect();
            let asked = self.peers.totals(queries.iter().map(|queries| count(queries)))?;
            for (((chunks, coefficients), queries), &asked) in
                minibatches.iter().zip(&coefficients).zip(&queries).zip(&asked)
            {
                let Some(coefficients) = coefficients else { continue };
                let factors = factors.select(0, taken);
                (taken, adam.steps) = (taken + 1, adam.steps + 1);
                if look == Look::AtTheEnd
                    && let Some(figures) = self.recorded_step(&whole, chunks, (coefficients, &factors), weights, adam)
                {
                    sums.add(figures, asked);
                    continue;
                }
                // Forward, loss, backward, and the sum over learners: the gradient of the whole minibatch, [W].
                let totals = Totals { coefficients, queries: asked };
                let (gradient, step) = self.gradient(&whole, chunks, queries, totals)?;

                // GPUs of unlike kinds may sum the squares in unlike orders: all clip by the first learner's norm.
                let mut gradient_norm = norm(&gradient);
                self.peers.first_scalar(&mut gradient_norm)?;
                if look == Look::AtEachStep {
                    let step = step.read(&gradient_norm, asked, self.auxiliary, (shards, self.peers))?;
                    self.check_finite(&step, &gradient)?;
                }
                self.follow(gradient, &gradient_norm, &factors, weights, adam);
                sums.add(step.with_norm(&gradient_norm), asked);
            }
        }

        let steps = sums.read(self.auxiliary, (shards, self.peers))?;
        if let Some(name) = steps.iter().find_map(StepMetrics::first_non_finite) {
            return Err(UpdateError::NonFinite(name.to_owned()));
        }
        // Weights are compared only when they are saved: all learners end here if one must.
        let broken = self.network.parameters.first_non_finite(weights);
        if self.peers.total(u64::from(broken.is_some()))? > 0 {
            return Err(UpdateError::NonFinite(
                broken.map_or("a weight of another learner".into(), |name| format!("weight {name}")),
            ));
        }
        let mut means = means(&steps, self.auxiliary);
        means.insert(metric::LEARNING_RATE.to_owned(), self.learning_rate);
        if self.peers.count() > 1 {
            means.insert(metric::EXCHANGED.to_owned(), self.peers.exchanged()?.bytes as f64);
        }
        Ok(means)
    }

    /// Clips a gradient of this norm, and goes on by Adam.
    fn follow(&self, mut gradient: Tensor, norm: &Tensor, factors: &Tensor, weights: &Tensor, adam: &Adam) {
        clip(&mut gradient, norm, self.ppo.max_gradient_norm);
        adam.apply(weights, &gradient, factors, self.ppo.adam_epsilon);
    }

    /// A step of the optimiser by one graph, and its figures, as [`StepSums::with_norm`] has them. None, and nothing is
    /// changed, where a step is not one pass of this learner alone, or is not recorded.
    fn recorded_step(
        &self,
        whole: &Whole,
        chunks: &[Chunk],
        (coefficients, factors): (&Coefficients, &Tensor),
        weights: &Tensor,
        adam: &Adam,
    ) -> Option<Tensor> {
        let (Some(graphs), [chunk], Peers::Alone) = (self.graphs, chunks, self.peers) else { return None };
        if self.shards.columns().len() > 1 {
            return None;
        }
        let step = |inputs: &Inputs| {
            let [coefficients, factors] = &inputs.numbers[..] else { unreachable!("as they are given below") };
            let coefficients = Coefficients::from(coefficients.shallow_clone());
            let Passed { gradient: part, scalars } = self.plain_pass(whole, &inputs.chunk, &coefficients);
            let gradient = weights.zeros_like().g_add_(&part);
            let mut step = StepSums::new(self.auxiliary, self.shards, weights.device());
            step.add_pass(0, &scalars, &[]);
            let gradient_norm = norm(&gradient);
            self.follow(gradient, &gradient_norm, factors, weights, adam);
            step.with_norm(&gradient_norm)
        };
        let given: (&[_], &[_]) = (&[coefficients.tensor(), factors], &[weights, &adam.first, &adam.second]);
        let mut graphs = graphs.borrow_mut();
        graphs.steps.launch((whole, self.rollout_number), chunk, given, step).map(Tensor::copy)
    }

    fn minibatches(&self, whole: &Whole, epoch: u32) -> Vec<Vec<Chunk>> {
        let Self { ppo, rollout, shards, seed, first_column, .. } = *self;
        let deal = Deal { minibatches: ppo.minibatches, seed, rollout: self.rollout_number, first_column };
        match ppo.shuffle {
            Shuffle::Environments => {
                let dealt = deal.columns(shards);
                dealt.iter().map(|own| Chunk::divide(whole, own, ppo.environments_per_pass)).collect()
            }
            Shuffle::Rows => {
                let dealt = deal.rows(shards, epoch, |column| rollout.steps_of(column));
                // Not those of this rollout: of its last step a learner may have nothing.
                let rows_each = ppo.environments_per_pass as usize * ppo.rollout_steps as usize;
                dealt.into_iter().map(|own| Chunk::of_rows(whole, own, rows_each)).collect()
            }
        }
    }

    /// Whether the policy has moved further from the one that acted than `ppo.target_kl`, by the last step's minibatch. All
    /// learners find the same.
    fn is_far(&self, sums: &UpdateSums) -> Result<bool, PeerError> {
        let target = self.ppo.target_kl;
        if target == 0.0 {
            return Ok(false);
        }
        let last = sums.last().read(self.auxiliary, (self.shards, self.peers))?;
        Ok(last.first().is_some_and(|step| step.approximate_kl() > target))
    }

    /// Gradient of a minibatch's loss under the present weights, \[W\], before clipping, summed over chunks, shards and
    /// learners, and this learner's part of the step's figures. Chunks come by shard; `queries` has a list for each.
    pub(crate) fn gradient(
        &self,
        whole: &Whole,
        chunks: &[Chunk],
        queries: &[Vec<Query>],
        totals: Totals,
    ) -> Result<(Tensor, StepSums), PeerError> {
        let weights = self.network.parameters.flat();
        let coefficients = totals.coefficients;
        let mut step = StepSums::new(self.auxiliary, self.shards, weights.device());
        let mut tree = Tree::default();
        let mut chunks = chunks.iter().zip(queries).peekable();
        for shard in 0..self.shards.columns().len() {
            let mut gradient = weights.zeros_like();
            while let Some((chunk, queries)) = chunks.next_if(|(chunk, _)| chunk.shard == shard) {
                let mut graphs = self.graphs.map(RefCell::borrow_mut);
                let pass = |inputs: &Inputs| {
                    let [coefficients] = &inputs.numbers[..] else { unreachable!("as they are given below") };
                    self.plain_pass(whole, &inputs.chunk, &Coefficients::from(coefficients.shallow_clone()))
                };
                let (of, given): (_, (&[_], &[_])) = ((whole, self.rollout_number), (&[coefficients.tensor()], &[]));
                let recorded = graphs.as_mut().and_then(|graphs| graphs.passes.launch(of, chunk, given, pass));
                if let Some(Passed { gradient: part, scalars }) = recorded {
                    let _ = gradient.g_add_(part);
                    step.add_pass(shard, scalars, &[]);
                    continue;
                }
                // Forward and loss, then backward.
                let Loss { total, embedded, scalars, counted } =
                    self.loss(whole, chunk, (queries, totals.queries), coefficients);
                let _ = gradient.g_add_(&self.network.gradient_of(&total, embedded));
                step.add_pass(shard, &scalars, &counted);
            }
            tree.add(gradient);
        }
        assert!(chunks.peek().is_none(), "chunks come by shard");
        // The sum over learners.
        let gradient = if self.shards.are_fixed() {
            tree.over(self.peers)?
        } else {
            let mut gradient = tree.root();
            self.peers.sum_gradients(&mut gradient)?;
            gradient
        };
        Ok((gradient, step))
    }

    /// A pass of a network without auxiliary task.
    fn plain_pass(&self, whole: &Whole, chunk: &Chunk, coefficients: &Coefficients) -> Passed {
        let Loss { total, embedded, scalars, counted: _ } = self.loss(whole, chunk, (&[], 0), coefficients);
        let gradient = self.network.gradient_of(&total, embedded);
        Passed { gradient, scalars: scalars.map(|scalar| scalar.detach()) }
    }

    /// Forward pass and loss of a chunk: its part of the minibatch's mean. The backward pass needs the embedding, too.
    /// `all_queries`: of the minibatch, over all learners.
    fn loss(
        &self,
        whole: &Whole,
        chunk: &Chunk,
        (queries, all_queries): (&[Query], u64),
        coefficients: &Coefficients,
    ) -> Loss<'a> {
        let Self { network, rollout, ppo, .. } = *self;
        let Chunk { packing, experience, .. } = chunk;

        // Forward: embeddings [B, 512 for the frame and each image + 32 + 16] → beliefs [B, H] → the policy and values [B].
        let embedded = chunk.embed(network, whole, self.rollout_number);
        let beliefs = network.belief.unroll(&network.parameters, &embedded.rows, packing, rollout.beliefs_at_start());
        let output = network.actor_critic(&beliefs, embedded.privileged.as_ref(), experience.masks.as_ref());

        // Loss: clipped surrogate + c_v · clipped value loss − c_H · entropy, scalars.
        let Terms { policy, value, entropy, clip_fraction, approximate_kl } =
            terms(&output, experience, coefficients, ppo.clip_value);
        let mut total = &policy + &value * coefficients.value() - &entropy * coefficients.entropy();

        // + w · the auxiliary task's loss, from what each observation gives by itself and from the beliefs.
        let embeddings = network.observations_of(&embedded.rows);
        // Such tasks are of one choice.
        let options = experience.actions.select(1, 0);
        let pass = Pass { rollout, packing, embeddings: &embeddings, beliefs: &beliefs, actions: &options };
        let (mut auxiliary, mut counted) = (policy.zeros_like(), Vec::new());
        if let Some(task) = self.auxiliary.loss(&network.parameters, &pass, queries, all_queries) {
            total += &task.loss * self.auxiliary_config.weight;
            (auxiliary, counted) = (task.loss, task.sums);
        }
        let scalars = [policy, value, entropy, auxiliary, clip_fraction, approximate_kl];
        Loss { total, embedded, scalars, counted }
    }

    fn check_finite(&self, step: &StepMetrics, gradient: &Tensor) -> Result<(), UpdateError> {
        match (step.first_non_finite(), self.network.parameters.first_non_finite(gradient)) {
            (None, _) => Ok(()),
            // The gradient's norm says less than which weight it is.
            (Some(metric::GRADIENT_NORM), Some(weight)) => Err(UpdateError::NonFinite(format!("gradient of {weight}"))),
            (Some(name), _) => Err(UpdateError::NonFinite(name.to_owned())),
        }
    }

    /// An epoch of this update, by which the auxiliary task's queries are drawn.
    pub(crate) fn epoch(&self, epoch: u32) -> Epoch {
        Epoch { seed: self.seed, rollout: self.rollout_number, epoch, first_column: self.first_column }
    }
}
