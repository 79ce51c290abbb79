//! Auxiliary tasks: what the belief is asked besides policy and value (SPEC section 4). One at a time.
//!
//! A task declares its own parameters, is given the beliefs and packing of a training pass, and answers
//! with a loss. Its normaliser is counted over the whole rollout beforehand, so that passes over parts of the columns
//! add up to the whole batch's mean.

mod disturb;

pub use disturb::{Disturb, focal_loss};

use crate::network::{Layout, Packing, Parameters};
use crate::rollout::Rollout;
use proto::config::{AuxiliaryConfig, AuxiliaryTask};
use std::collections::BTreeMap;
use tch::Tensor;

/// The task that is trained along.
#[derive(Debug)]
pub enum Auxiliary {
    /// None.
    None,
    /// Disturbance prediction, the paper's.
    Disturb(Disturb),
}

/// What a training pass offers to a task; rows in the order of the packing.
#[derive(Debug)]
pub struct Pass<'a> {
    /// The rollout that is trained on.
    pub rollout: &'a Rollout,
    /// Its rows of this pass.
    pub packing: &'a Packing,
    /// Beliefs \[rows, hidden\], with gradients.
    pub beliefs: &'a Tensor,
    /// Policy indices of the actions taken, i64 \[rows\].
    pub actions: &'a Tensor,
}

/// What a task says of one pass.
#[derive(Debug)]
pub struct Answer {
    /// This pass's share of the batch's mean loss, with gradient.
    pub loss: Tensor,
    /// Sums that the task's figures are made of.
    pub tally: Tally,
}

/// Sums over rows, by name: passes and epochs add up.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tally(BTreeMap<&'static str, f64>);

impl Tally {
    /// Adds to a sum.
    pub fn add(&mut self, name: &'static str, value: f64) {
        *self.0.entry(name).or_default() += value;
    }

    /// Adds another tally.
    pub fn merge(&mut self, other: &Self) {
        for (name, value) in &other.0 {
            self.add(name, *value);
        }
    }

    /// A sum; 0 if nothing was added.
    pub fn sum(&self, name: &str) -> f64 {
        self.0.get(name).copied().unwrap_or(0.0)
    }
}

impl Auxiliary {
    /// Declares the task's parameters.
    pub fn new(config: &AuxiliaryConfig, layout: &mut Layout, hidden: i64, actions: i64) -> Self {
        match config.task {
            AuxiliaryTask::None => Self::None,
            AuxiliaryTask::Disturb => Self::Disturb(Disturb::new(layout, [hidden, actions], config.focal_gamma)),
        }
    }

    /// Rows of a rollout that the task looks at.
    pub fn count(&self, rollout: &Rollout) -> u64 {
        match self {
            Self::None => 0,
            Self::Disturb(task) => task.count(rollout),
        }
    }

    /// The loss of a pass, of a rollout in which the task looks at `count` rows; `None` if it has nothing to say.
    pub fn loss(&self, parameters: &Parameters, pass: &Pass, count: u64) -> Option<Answer> {
        match self {
            Self::None => None,
            Self::Disturb(task) => task.loss(parameters, pass, count),
        }
    }

    /// The task's figures, named `auxiliary/…`, from the sums of all passes.
    pub fn figures(&self, tally: &Tally) -> BTreeMap<String, f64> {
        match self {
            Self::None => BTreeMap::new(),
            Self::Disturb(task) => task.figures(tally),
        }
    }
}
