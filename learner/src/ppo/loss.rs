//! The clipped surrogate of PPO: policy, value, entropy.
//!
//! Every term is a sum over the rows of a pass divided by the rows of the whole minibatch, so that the terms, and their
//! gradients, of all passes and of all learners add up to the minibatch's means.

use crate::device::upload;
use crate::network::ActorCriticOutput;
use proto::config::PpoConfig;
use tch::{Device, Kind, Tensor};

/// What the loss compares the network's output with, \[B\] each but for actions, in the order of the chunk's packing.
#[derive(Debug)]
pub struct Experience {
    /// The actions taken: options, i64 \[B, choices\], or numbers, f32 \[B, numbers\].
    pub actions: Tensor,
    /// Which options could be chosen, bool \[B, options\]; none in a task without masks.
    pub masks: Option<Tensor>,
    /// Their log-probabilities when they were taken.
    pub log_probs: Tensor,
    /// Values when the actions were taken.
    pub values: Tensor,
    /// `A_t`.
    pub advantages: Tensor,
    /// `R_t`.
    pub returns: Tensor,
}

impl Experience {
    fn parts(&self) -> impl Iterator<Item = &Tensor> {
        let Self { actions, masks, log_probs, values, advantages, returns } = self;
        [actions, log_probs, values, advantages, returns].into_iter().chain(masks)
    }

    pub(super) fn copy(&self) -> Self {
        let Self { actions, masks, log_probs, values, advantages, returns } = self;
        Self {
            actions: actions.copy(),
            masks: masks.as_ref().map(Tensor::copy),
            log_probs: log_probs.copy(),
            values: values.copy(),
            advantages: advantages.copy(),
            returns: returns.copy(),
        }
    }

    /// Takes the numbers of another one of as many rows.
    pub(super) fn take(&self, other: &Self) {
        self.parts().zip(other.parts()).for_each(|(own, other)| own.shallow_clone().copy_(other));
    }
}

/// The numbers that a loss has from its configuration and its minibatch, on the device: a recorded pass reads those of
/// its own update.
#[derive(Debug)]
pub struct Coefficients(Tensor);

impl Coefficients {
    /// Of a minibatch of so many rows, over all learners.
    pub fn of(ppo: &PpoConfig, batch_rows: u64, device: Device) -> Self {
        let clip = ppo.clip;
        let share = 1.0 / batch_rows as f64;
        let all = [share, clip, -clip, 1.0 - clip, 1.0 + clip, ppo.value_coefficient, ppo.entropy_coefficient];
        Self(upload(&all.map(|number| number as f32), device))
    }

    /// The tensor that holds them.
    pub(super) fn tensor(&self) -> &Tensor {
        &self.0
    }

    fn at(&self, index: i64) -> Tensor {
        self.0.select(0, index)
    }

    pub(super) fn value(&self) -> Tensor {
        self.at(5)
    }

    pub(super) fn entropy(&self) -> Tensor {
        self.at(6)
    }
}

impl From<Tensor> for Coefficients {
    /// Of what [`Coefficients::tensor`] gave, or a copy.
    fn from(tensor: Tensor) -> Self {
        Self(tensor)
    }
}

/// Scalars: shares of the minibatch's means. The first three carry gradients.
#[derive(Debug)]
pub struct Terms {
    /// −min(ρA, clip(ρ, 1−ε, 1+ε)A), ρ the ratio of the new to the old probability.
    pub policy: Tensor,
    /// `½·max((V−R)², (V_clipped−R)²)`, `V_clipped` within ε of the old value; `½·(V−R)²` where values are not clipped.
    pub value: Tensor,
    /// Entropy of the policy, nats.
    pub entropy: Tensor,
    /// Share of rows whose ratio is outside 1 ± ε.
    pub clip_fraction: Tensor,
    /// (ρ − 1) − ln ρ: an estimate of KL(old ‖ new) that is never negative (Schulman 2020).
    pub approximate_kl: Tensor,
}

/// The terms of the B rows of a chunk.
pub fn terms(
    output: &ActorCriticOutput,
    experience: &Experience,
    coefficients: &Coefficients,
    clip_value: bool,
) -> Terms {
    let [share, clip, minus_clip, least, most] = [0, 1, 2, 3, 4].map(|index| coefficients.at(index));
    let mean = |per_row: Tensor| per_row.sum(Kind::Float) * &share;

    let log_ratio = output.policy.log_prob(&experience.actions) - &experience.log_probs;
    let ratio = log_ratio.exp();
    let surrogate = &ratio * &experience.advantages;
    let clipped_surrogate = ratio.clamp_tensor(Some(&least), Some(&most)) * &experience.advantages;
    let policy = mean(-surrogate.minimum(&clipped_surrogate));

    let mut error = (&output.values - &experience.returns).square();
    if clip_value {
        let change = &output.values - &experience.values;
        let clipped_value = &experience.values + change.clamp_tensor(Some(&minus_clip), Some(&clip));
        error = error.maximum(&(clipped_value - &experience.returns).square());
    }
    let value = mean(error * 0.5);

    let entropy = mean(output.policy.entropy());

    let (ratio, log_ratio) = (ratio.detach(), log_ratio.detach());
    let clip_fraction = mean((&ratio - 1.0).abs().gt_tensor(&clip).to_kind(Kind::Float));
    let approximate_kl = mean(ratio - 1.0 - log_ratio);
    Terms { policy, value, entropy, clip_fraction, approximate_kl }
}
