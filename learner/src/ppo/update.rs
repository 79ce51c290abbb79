//! The update: a few epochs over the rollout, one optimiser step each.
//!
//! An epoch may go through the network in several passes over parts of the columns, which bounds memory; their
//! gradients add up to the whole batch's. What is written down here is the order of things: forward, loss, backward,
//! add up over learners, clip, step.

use super::gae::{Targets, estimate};
use super::loss::{Experience, Terms, terms};
use crate::auxiliary::{Auxiliary, Epoch, Pass, Query, Tally, count};
use crate::network::{Embedded, Network, OBSERVATION, Observations, Packing, all_finite, to_vec};
use crate::optimizer::{Adam, clip, norm};
use crate::peers::{PeerError, Peers};
use crate::rollout::Rollout;
use proto::config::{AuxiliaryConfig, PpoConfig};
use proto::metric;
use std::collections::BTreeMap;
use tch::Tensor;

/// Why there is no update.
#[derive(Debug, thiserror::Error)]
pub enum UpdateError {
    /// A number is not finite; which, in words. All learners say the same.
    #[error("{0} is not finite")]
    NonFinite(String),
    /// The other learners are gone.
    #[error(transparent)]
    Peers(#[from] PeerError),
}

/// Everything an update works on.
#[derive(Debug, Clone, Copy)]
pub struct Update<'a> {
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
    /// The column of the whole run that the rollout's first one is.
    pub first_column: usize,
    /// Step size of this update.
    pub learning_rate: f64,
    /// Seed of the run.
    pub seed: u64,
    /// Number of the rollout in the run.
    pub rollout_number: u64,
}

/// A part of the batch that goes through the network at once.
struct Share {
    packing: Packing,
    experience: Experience,
    /// What was seen, when one share is the whole batch: then it is made once, not in every epoch, and is little beside
    /// what the pass itself keeps. Of several shares each makes its own anew: they are there to save memory.
    observations: Option<Observations>,
}

/// What the auxiliary task asks of a pass.
#[derive(Clone, Copy)]
struct Asked<'a> {
    queries: &'a [Query],
    /// Queries of all passes of the epoch, at all learners.
    count: u64,
}

/// What the whole batch has of which this learner has a part.
#[derive(Clone, Copy)]
struct Whole {
    frames: u64,
    /// Queries of an epoch.
    queries: u64,
}

/// What the whole batch says of the weights as they are.
#[derive(Debug)]
pub struct BatchGradient {
    /// Of the loss, flat, in the order of the weights; before clipping.
    pub gradient: Tensor,
    /// Means over the batch, named by [`SCALARS`].
    pub scalars: [f64; SCALARS.len()],
    /// Sums that the auxiliary task's figures are made of.
    pub tally: Tally,
}

/// A look at a batch: see [`Update::look`].
#[derive(Debug)]
pub struct Look {
    /// Which (step, column) each row is.
    pub packing: Packing,
    /// Advantages and returns.
    pub targets: Targets,
    /// What the auxiliary task was asked.
    pub queries: Vec<Query>,
    /// Losses and gradient.
    pub batch: BatchGradient,
}

/// Names of the scalars of a pass, in the order in which they are read back from the device.
pub const SCALARS: [&str; 6] = [
    metric::POLICY_LOSS,
    metric::VALUE_LOSS,
    metric::ENTROPY,
    metric::AUXILIARY_LOSS,
    metric::CLIP_FRACTION,
    metric::APPROXIMATE_KL,
];

impl Update<'_> {
    /// Runs all epochs. On an error weights and moments are as they were before.
    pub fn run(&self, adam: &mut Adam) -> Result<BTreeMap<String, f64>, UpdateError> {
        let mut weights = self.network.parameters.flat();
        let (weights_before, adam_before) = (weights.copy(), adam.copy());
        self.epochs(&mut weights, adam).inspect_err(|_| {
            *adam = adam_before;
            tch::no_grad(|| weights.copy_(&weights_before));
        })
    }

    fn epochs(&self, weights: &mut Tensor, adam: &mut Adam) -> Result<BTreeMap<String, f64>, UpdateError> {
        let targets = estimate(self.rollout, self.ppo, self.peers)?;
        let shares = self.shares(&targets);
        let packings: Vec<&Packing> = shares.iter().map(|share| &share.packing).collect();
        let frames = self.peers.total(self.rollout.shape().frames)?;
        let mut sums = [0.0; SCALARS.len()];
        let mut gradient_norms = 0.0;
        let mut tally = Tally::default();

        for epoch in 0..self.ppo.epochs {
            let queries = self.auxiliary.queries(&packings, self.epoch(epoch), self.peers)?;
            let whole = Whole { frames, queries: self.peers.total(count(&queries))? };
            let mut batch = self.gradient(&shares, &queries, whole);
            self.add_up(&mut batch)?;
            for ((sum, scalar), name) in sums.iter_mut().zip(batch.scalars).zip(SCALARS) {
                if !scalar.is_finite() {
                    return Err(UpdateError::NonFinite(name.to_owned()));
                }
                *sum += scalar;
            }
            tally.merge(&batch.tally);
            let mut gradient = batch.gradient;
            if !all_finite(&gradient) {
                let name = self.network.parameters.first_non_finite(&gradient).unwrap_or("the sum");
                return Err(UpdateError::NonFinite(format!("gradient of {name}")));
            }
            let mut length = norm(&gradient);
            // Unlike GPUs may add its squares up in unlike order: all clip by the same number.
            self.peers.first(&mut length)?;
            gradient_norms += length;
            clip(&mut gradient, length, self.ppo.max_gradient_norm);
            adam.step(weights, &gradient, self.learning_rate);
        }
        if let Some(name) = self.network.parameters.first_non_finite(weights) {
            return Err(UpdateError::NonFinite(format!("weight {name}")));
        }

        let epochs = f64::from(self.ppo.epochs);
        let mut metrics = self.auxiliary.figures(&tally);
        metrics.extend(SCALARS.iter().zip(sums).map(|(name, sum)| ((*name).to_owned(), sum / epochs)));
        if matches!(self.auxiliary, Auxiliary::None) {
            metrics.remove(metric::AUXILIARY_LOSS);
        }
        metrics.insert(metric::GRADIENT_NORM.to_owned(), gradient_norms / epochs);
        metrics.insert(metric::LEARNING_RATE.to_owned(), self.learning_rate);
        Ok(metrics)
    }

    fn epoch(&self, epoch: u32) -> Epoch {
        Epoch { seed: self.seed, rollout: self.rollout_number, epoch, first_column: self.first_column }
    }

    /// Makes one learner's part of a batch the whole.
    fn add_up(&self, batch: &mut BatchGradient) -> Result<(), PeerError> {
        let names = self.auxiliary.sums();
        let mut numbers = batch.scalars.to_vec();
        numbers.extend(names.iter().map(|name| batch.tally.sum(name)));
        self.peers.sum(&mut numbers)?;
        let (scalars, sums) = numbers.split_at(SCALARS.len());
        batch.scalars.copy_from_slice(scalars);
        batch.tally = Tally::default();
        for (name, sum) in names.iter().zip(sums) {
            batch.tally.add(name, *sum);
        }
        self.peers.sum_gradients(&mut batch.gradient)
    }

    /// Losses and gradient of the first epoch, weights left alone: what an update would begin with. All columns go
    /// through the network at once, whatever the configuration says. `revise` may change what the auxiliary task asks.
    pub fn look(&self, revise: impl FnOnce(&Packing, &mut Vec<Query>)) -> Result<Look, UpdateError> {
        let ppo = PpoConfig { environments_per_pass: 0, ..*self.ppo };
        let at_once = Update { ppo: &ppo, ..*self };
        let targets = estimate(self.rollout, &ppo, self.peers)?;
        let shares = at_once.shares(&targets);
        let packing = self.rollout.packing(0..self.rollout.columns());
        let mut queries = self.auxiliary.queries(&[&packing], self.epoch(0), self.peers)?.pop().unwrap_or_default();
        revise(&packing, &mut queries);
        let whole = Whole {
            frames: self.peers.total(self.rollout.shape().frames)?,
            queries: self.peers.total(queries.len() as u64)?,
        };
        let mut batch = at_once.gradient(&shares, std::slice::from_ref(&queries), whole);
        self.add_up(&mut batch)?;
        Ok(Look { packing, targets, queries, batch })
    }

    /// Forward and backward of this learner's part of the batch.
    fn gradient(&self, shares: &[Share], queries: &[Vec<Query>], whole: Whole) -> BatchGradient {
        let mut batch = BatchGradient {
            gradient: self.network.parameters.flat().zeros_like(),
            scalars: [0.0; SCALARS.len()],
            tally: Tally::default(),
        };
        for (share, queries) in shares.iter().zip(queries) {
            let asked = Asked { queries, count: whole.queries };
            let (loss, embedded, scalars) = self.forward(share, asked, whole.frames, &mut batch.tally);
            for (sum, scalar) in batch.scalars.iter_mut().zip(scalars) {
                *sum += f64::from(scalar);
            }
            let _ = batch.gradient.g_add_(&self.network.gradient_of(&loss, embedded));
        }
        batch
    }

    /// The columns, divided as the configuration says.
    fn shares(&self, targets: &Targets) -> Vec<Share> {
        let columns = self.rollout.columns();
        let width = match self.ppo.environments_per_pass {
            0 => columns,
            width => width as usize,
        };
        (0..columns)
            .step_by(width)
            .map(|first| {
                let packing = self.rollout.packing(first..columns.min(first + width));
                let device = self.rollout.beliefs_at_start().device();
                let target = |of: &dyn Fn((usize, usize)) -> f32| {
                    let values: Vec<f32> = packing.rows.iter().map(|&row| of(row)).collect();
                    Tensor::from_slice(&values).to_device(device)
                };
                let experience = Experience {
                    actions: self.rollout.gather(&packing, |step| step.action),
                    log_probs: self.rollout.gather(&packing, |step| step.log_prob),
                    values: self.rollout.gather(&packing, |step| step.value),
                    advantages: target(&|row| targets.advantage(row)),
                    returns: target(&|row| targets.value_target(row)),
                };
                let observations = (width >= columns).then(|| self.rollout.observations(&packing));
                Share { packing, experience, observations }
            })
            // In a rollout of one step, columns that hold have no rows.
            .filter(|share| !share.packing.rows.is_empty())
            .collect()
    }

    /// The loss of one pass, what it was made of, and its scalars in the order of [`SCALARS`].
    fn forward(
        &self,
        share: &Share,
        asked: Asked,
        batch_frames: u64,
        tally: &mut Tally,
    ) -> (Tensor, Embedded, Vec<f32>) {
        let Share { packing, experience, observations } = share;
        let Self { network, rollout, .. } = self;
        let embedded = match observations {
            Some(observations) => network.embed_to_train(observations),
            None => network.embed_to_train(&rollout.observations(packing)),
        };
        let beliefs = network.belief.unroll(&network.parameters, &embedded.rows, packing, rollout.beliefs_at_start());
        let judgement = network.judge(&beliefs);

        let Terms { policy, value, entropy, clip_fraction, approximate_kl } =
            terms(&judgement, experience, self.ppo.clip, batch_frames);
        let mut loss = &policy + &value * self.ppo.value_coefficient - &entropy * self.ppo.entropy_coefficient;

        let embeddings = embedded.rows.narrow(1, 0, OBSERVATION);
        let pass = Pass { rollout, packing, embeddings: &embeddings, beliefs: &beliefs, actions: &experience.actions };
        let mut auxiliary = policy.zeros_like();
        let Asked { queries, count } = asked;
        if let Some(answer) = self.auxiliary.loss(&network.parameters, &pass, queries, count) {
            loss += &answer.loss * self.auxiliary_config.weight;
            auxiliary = answer.loss;
            tally.merge(&answer.tally);
        }
        let scalars = [policy, value, entropy, auxiliary, clip_fraction, approximate_kl];
        (loss, embedded, to_vec(&Tensor::stack(&scalars, 0)))
    }
}
