//! What an auxiliary task is to training, and what the registry holds of each.

use super::query::{Epoch, Query};
use crate::device::upload;
use crate::network::{Layout, Packing, Parameters};
use crate::peers::{PeerError, Peers};
use crate::rollout::Rollout;
use proto::config::{AuxiliaryConfig, AuxiliaryTask};
use std::collections::BTreeMap;
use std::fmt;
use tch::{Kind, Tensor};

/// An auxiliary task: parameters of its own, and a loss on what a training pass computes.
pub trait Task: fmt::Debug + Send {
    /// What it is asked in an epoch: one list for each pass. Counted over all learners, so that losses of passes add up
    /// to the minibatch's mean.
    fn queries(&self, packings: &[&Packing], epoch: Epoch, peers: &Peers) -> Result<Vec<Vec<Query>>, PeerError>;

    /// Loss of these queries of one pass: their sum over `count`, the queries of all passes at all learners.
    fn loss(&self, parameters: &Parameters, pass: &Pass, queries: &[Query], count: u64) -> TaskLoss;

    /// Names of the sums that [`Task::figures`] needs, in the order of [`TaskLoss::sums`].
    fn sums(&self) -> &'static [&'static str];

    /// The task's figures, named `auxiliary/…`, from these sums over all passes.
    fn figures(&self, tally: &Tally) -> BTreeMap<String, f64>;

    /// Logits of the task's label, \[rows, hidden\] → \[rows, actions\]; `None` if the task does not
    /// predict it.
    fn label_logits(&self, _parameters: &Parameters, _beliefs: &Tensor) -> Option<Tensor> {
        None
    }
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct TaskEntry {
    pub task: AuxiliaryTask,
    /// The configuration's name for it. Its weights are named `auxiliary.NAME.…`.
    pub name: &'static str,
    /// Where the names of its weights begin in AllenAct, up to and including the dot; `None` if AllenAct has no such
    /// task.
    pub allenact: Option<&'static str>,
    pub declare: fn(&mut Layout, Sizes, &AuxiliaryConfig) -> Box<dyn Task>,
}

#[derive(Debug, Clone, Copy)]
pub struct Sizes {
    pub hidden: i64,
    pub actions: i64,
}

/// A task's inputs from a training pass; rows in the order of the packing.
#[derive(Debug)]
pub struct Pass<'a> {
    pub rollout: &'a Rollout,
    /// Its rows of this pass.
    pub packing: &'a Packing,
    /// Embedded observations without the previous action: \[rows, 512 + 32\], with gradients.
    pub embeddings: &'a Tensor,
    /// Beliefs \[rows, hidden\], with gradients.
    pub beliefs: &'a Tensor,
    /// Policy indices of the actions taken, i64 \[rows\].
    pub actions: &'a Tensor,
}

impl Pass<'_> {
    /// A number that is known already, as one of [`TaskLoss::sums`].
    pub(crate) fn known(&self, number: usize) -> Tensor {
        Tensor::full([], number as f64, (Kind::Double, self.beliefs.device()))
    }

    /// One number a query, i64 \[queries\], on the pass's device.
    pub(crate) fn of_queries(&self, queries: &[Query], number: impl Fn(&Query) -> i64) -> Tensor {
        upload(&queries.iter().map(number).collect::<Vec<i64>>(), self.beliefs.device())
    }
}

#[derive(Debug)]
pub struct TaskLoss {
    /// This pass's part of the batch's mean loss, with gradient.
    pub loss: Tensor,
    /// What this pass adds to each of [`Task::sums`]: scalars on its device, read only when the update is through.
    pub sums: Vec<Tensor>,
}

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tally(BTreeMap<&'static str, f64>);

impl Tally {
    pub fn of(names: &[&'static str], sums: &[f64]) -> Self {
        Self(names.iter().copied().zip(sums.iter().copied()).collect())
    }

    pub fn merge(&mut self, other: &Self) {
        for (name, value) in &other.0 {
            *self.0.entry(name).or_default() += value;
        }
    }

    /// A sum; 0 if nothing was added.
    pub fn sum(&self, name: &str) -> f64 {
        self.0.get(name).copied().unwrap_or(0.0)
    }
}
