//! Proximal policy optimisation (Schulman et al. 2017) as DD-PPO runs it (Wijmans et al. 2020), on one page.
//!
//! Acting fills a rollout of T steps × N environments ([`crate::agent::Agent::step`]). [`Update::run`] trains on it:
//!
//! ```text
//! targets: advantages and returns by GAE          gae.rs
//! minibatches                                     minibatch.rs
//! for each epoch:
//!     for each minibatch:
//!         forward: encoder, GRU, actor, critic    network/
//!         loss: policy, value, entropy            loss.rs
//!               + auxiliary task                  auxiliary/
//!         backward
//!     sum of the gradients over learners          peers.rs
//!     clip, Adam                                  optimizer.rs
//! ```
//! An epoch is one step of the optimiser with the gradient of the whole batch, as in the reference. Minibatches only
//! bound memory (`ppo.environments_per_pass`): their gradients add up before the step.
//!
//! Shapes in comments: T steps, N environments of this learner, B rows of a minibatch, A actions, H width of the
//! belief, W weights. A batch is the frames of all learners.
//!
//! Beside the update: the multiplier of PPO-Lagrangian ([`lagrangian`]), the rule for stragglers ([`preemption`]), the
//! figures ([`metrics`]).

pub mod gae;
pub(crate) mod lagrangian;
pub mod loss;
pub mod metrics;
pub(crate) mod minibatch;
pub(crate) mod preemption;

use crate::auxiliary::{Auxiliary, Epoch, Pass, Query, count};
use crate::network::{Embedded, Network, OBSERVATION, Packing, all_finite};
use crate::optimizer::{Adam, clip, norm};
use crate::peers::{PeerError, Peers};
use crate::rollout::Rollout;
use loss::{Terms, terms};
use metrics::{EpochMetrics, UpdateMetrics};
use minibatch::Minibatch;
use proto::config::{AuxiliaryConfig, PpoConfig};
use proto::metric;
use std::collections::BTreeMap;
use tch::Tensor;

/// Everything an update works on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Update<'a> {
    /// The network; its weights change.
    pub network: &'a Network,
    /// The auxiliary task.
    pub auxiliary: &'a Auxiliary,
    /// The rollout.
    pub rollout: &'a Rollout,
    /// Constants of PPO.
    pub ppo: &'a PpoConfig,
    /// Constants of the auxiliary task.
    pub auxiliary_config: &'a AuxiliaryConfig,
    /// All learners: the batch is theirs together.
    pub peers: &'a Peers,
    /// Number, in the whole run, of the rollout's first column.
    pub first_column: usize,
    /// Step size of this update.
    pub learning_rate: f64,
    /// Seed of the run.
    pub seed: u64,
    /// Number of the rollout in the run.
    pub rollout_number: u64,
}

/// Why there is no update.
#[derive(Debug, thiserror::Error)]
pub enum UpdateError {
    /// A number is not finite; the text names it. All learners report the same.
    #[error("{0} is not finite")]
    NonFinite(String),
    /// The other learners are gone.
    #[error(transparent)]
    Peers(#[from] PeerError),
}

/// What losses are divided by to be means over the batch: counts over all learners.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Totals {
    /// Frames of the batch.
    pub frames: u64,
    /// Queries to the auxiliary task in this epoch.
    pub queries: u64,
}

impl<'a> Update<'a> {
    /// Runs all epochs and returns the figures by name. On an error weights and moments are as they were before.
    pub(crate) fn run(&self, adam: &mut Adam) -> Result<BTreeMap<String, f64>, UpdateError> {
        // [W], the network's own storage: writing to it changes the weights.
        let mut weights = self.network.parameters.flat();
        let (weights_before, adam_before) = (weights.copy(), adam.copy());
        self.epochs(&mut weights, adam).inspect_err(|_| {
            *adam = adam_before;
            tch::no_grad(|| weights.copy_(&weights_before));
        })
    }

    fn epochs(&self, weights: &mut Tensor, adam: &mut Adam) -> Result<BTreeMap<String, f64>, UpdateError> {
        // Advantages and returns, [T, N].
        let targets = gae::estimate(self.rollout, self.ppo, self.peers)?;
        let minibatches = Minibatch::divide(self.rollout, &targets, self.ppo.environments_per_pass);
        let packings: Vec<&Packing> = minibatches.iter().map(|minibatch| &minibatch.packing).collect();
        let frames = self.peers.total(self.rollout.shape().frames)?;
        let mut metrics = UpdateMetrics::default();

        for epoch in 0..self.ppo.epochs {
            // Forward, loss, backward, and the sum over learners: the gradient of the whole batch, [W].
            let queries = self.auxiliary.queries(&packings, self.epoch(epoch), self.peers)?;
            let totals = Totals { frames, queries: self.peers.total(count(&queries))? };
            let (mut gradient, epoch_metrics) = self.gradient(&minibatches, &queries, totals)?;
            self.check_finite(&epoch_metrics, &gradient)?;

            // Clip. GPUs of unlike kinds may sum the squares in unlike orders: all clip by the first learner's norm.
            let mut gradient_norm = norm(&gradient);
            self.peers.first(&mut gradient_norm)?;
            clip(&mut gradient, gradient_norm, self.ppo.max_gradient_norm);

            // Adam.
            adam.step(weights, &gradient, self.learning_rate);
            metrics.add_epoch(&epoch_metrics, gradient_norm);
        }

        if let Some(name) = self.network.parameters.first_non_finite(weights) {
            return Err(UpdateError::NonFinite(format!("weight {name}")));
        }
        let mut means = metrics.means(self.ppo.epochs, self.auxiliary);
        means.insert(metric::LEARNING_RATE.to_owned(), self.learning_rate);
        Ok(means)
    }

    /// Gradient of the batch's loss under the present weights, \[W\], before clipping, and the epoch's figures; both
    /// summed over minibatches and learners. `queries` has a list for each minibatch.
    pub(crate) fn gradient(
        &self,
        minibatches: &[Minibatch],
        queries: &[Vec<Query>],
        totals: Totals,
    ) -> Result<(Tensor, EpochMetrics), PeerError> {
        let mut gradient = self.network.parameters.flat().zeros_like();
        let mut metrics = EpochMetrics::default();
        for (minibatch, queries) in minibatches.iter().zip(queries) {
            // Forward and loss, then backward.
            let (loss, embedded) = self.loss(minibatch, queries, totals, &mut metrics);
            let _ = gradient.g_add_(&self.network.gradient_of(&loss, embedded));
        }
        // The sum over learners.
        metrics.sum_over_learners(self.auxiliary, self.peers)?;
        self.peers.sum_gradients(&mut gradient)?;
        Ok((gradient, metrics))
    }

    /// Forward pass and loss of a minibatch: its part of the batch's mean. The backward pass needs the embedding, too.
    fn loss(
        &self,
        minibatch: &Minibatch,
        queries: &[Query],
        totals: Totals,
        metrics: &mut EpochMetrics,
    ) -> (Tensor, Embedded<'a>) {
        let Self { network, rollout, ppo, .. } = *self;
        let Minibatch { packing, experience, .. } = minibatch;

        // Forward: embeddings [B, 512 + 32 + 16] → beliefs [B, H] → log-probabilities [B, A] and values [B].
        let embedded = minibatch.embed(network, rollout);
        let beliefs = network.belief.unroll(&network.parameters, &embedded.rows, packing, rollout.beliefs_at_start());
        let output = network.actor_critic(&beliefs);

        // Loss: clipped surrogate + c_v · clipped value loss − c_H · entropy, scalars.
        let Terms { policy, value, entropy, clip_fraction, approximate_kl } =
            terms(&output, experience, ppo.clip, totals.frames);
        let mut loss = &policy + &value * ppo.value_coefficient - &entropy * ppo.entropy_coefficient;

        // + w · the auxiliary task's loss, from what each observation gives by itself and from the beliefs.
        let embeddings = embedded.rows.narrow(1, 0, OBSERVATION);
        let pass = Pass { rollout, packing, embeddings: &embeddings, beliefs: &beliefs, actions: &experience.actions };
        let mut auxiliary = policy.zeros_like();
        if let Some(task) = self.auxiliary.loss(&network.parameters, &pass, queries, totals.queries) {
            loss += &task.loss * self.auxiliary_config.weight;
            auxiliary = task.loss;
            metrics.tally.merge(&task.tally);
        }
        metrics.add_pass(&[policy, value, entropy, auxiliary, clip_fraction, approximate_kl]);
        (loss, embedded)
    }

    fn check_finite(&self, metrics: &EpochMetrics, gradient: &Tensor) -> Result<(), UpdateError> {
        if let Some(name) = metrics.first_non_finite() {
            return Err(UpdateError::NonFinite(name.to_owned()));
        }
        if all_finite(gradient) {
            return Ok(());
        }
        let name = self.network.parameters.first_non_finite(gradient).unwrap_or("the sum");
        Err(UpdateError::NonFinite(format!("gradient of {name}")))
    }

    /// An epoch of this update, by which the auxiliary task's queries are drawn.
    pub(crate) fn epoch(&self, epoch: u32) -> Epoch {
        Epoch { seed: self.seed, rollout: self.rollout_number, epoch, first_column: self.first_column }
    }
}
