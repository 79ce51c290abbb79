//! The batch, divided by columns into minibatches.

use super::gae::Targets;
use super::loss::Experience;
use crate::network::{Embedded, Network, Observations, Packing};
use crate::rollout::Rollout;
use tch::Tensor;

/// Rows of the batch that go through the network in one pass: those of some columns.
#[derive(Debug)]
pub(crate) struct Minibatch {
    /// Which (step, column) each row is.
    pub packing: Packing,
    /// What the loss compares the network's output with.
    pub experience: Experience,
    /// What was seen, if this minibatch is the whole batch: then it is gathered once, not in every epoch, and is little
    /// beside what the pass itself keeps. Of several minibatches each gathers its own anew, to save memory.
    observations: Option<Observations>,
}

impl Minibatch {
    /// Divides a rollout into minibatches of this many columns; 0 = all in one.
    pub(crate) fn divide(rollout: &Rollout, targets: &Targets, columns_each: u32) -> Vec<Self> {
        let columns = rollout.columns();
        let width = match columns_each {
            0 => columns,
            width => width as usize,
        };
        (0..columns)
            .step_by(width)
            .map(|first| {
                let packing = rollout.packing(first..columns.min(first + width));
                let device = rollout.beliefs_at_start().device();
                let target = |of: &dyn Fn((usize, usize)) -> f32| {
                    let values: Vec<f32> = packing.rows.iter().map(|&row| of(row)).collect();
                    Tensor::from_slice(&values).to_device(device)
                };
                let experience = Experience {
                    actions: rollout.gather(&packing, |step| step.action),
                    log_probs: rollout.gather(&packing, |step| step.log_prob),
                    values: rollout.gather(&packing, |step| step.value),
                    advantages: target(&|row| targets.advantage(row)),
                    returns: target(&|row| targets.value_target(row)),
                };
                let observations = (width >= columns).then(|| rollout.observations(&packing));
                Self { packing, experience, observations }
            })
            // In a rollout of one step, columns that hold have no rows.
            .filter(|minibatch| !minibatch.packing.rows.is_empty())
            .collect()
    }

    /// Embeds its observations, to train: \[rows, 512 + 32 + 16\].
    pub(crate) fn embed<'a>(&self, network: &'a Network, rollout: &Rollout) -> Embedded<'a> {
        match &self.observations {
            Some(observations) => network.embed_to_train(observations),
            None => network.embed_to_train(&rollout.observations(&self.packing)),
        }
    }
}
