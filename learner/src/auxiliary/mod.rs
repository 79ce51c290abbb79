//! Auxiliary tasks: predictions from the belief besides policy and value (`docs/method.md`, Auxiliary tasks). A run
//! trains at most one.
//!
//! A task declares its own parameters, is given embeddings, beliefs and packing of a training pass and the queries to
//! answer, and answers with a loss. Queries are chosen, and counted, over the whole rollout beforehand, so that passes
//! over parts of the columns add up to the whole batch's mean.

mod cpca;
mod disturb;
mod inverse_dynamics;
mod query;

pub use cpca::Cpca;
pub use disturb::{Disturb, focal_loss};
pub use inverse_dynamics::InverseDynamics;
pub use query::{Epoch, Query, count};

use crate::network::{Layout, Packing, Parameters};
use crate::peers::{PeerError, Peers};
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
    /// Inverse dynamics.
    InverseDynamics {
        /// The task.
        task: InverseDynamics,
        /// Share of the valid steps that an epoch looks at.
        share: f64,
    },
    /// Action-conditional contrastive prediction, 16 steps ahead.
    Cpca {
        /// The task.
        task: Cpca,
        /// Share of the valid pairs of step and offset that an epoch looks at.
        share: f64,
    },
}

/// What a training pass offers to a task; rows in the order of the packing.
#[derive(Debug)]
pub struct Pass<'a> {
    /// The rollout that is trained on.
    pub rollout: &'a Rollout,
    /// Its rows of this pass.
    pub packing: &'a Packing,
    /// What each observation says by itself, previous action left out: \[rows, 512 + 32\], with gradients.
    pub embeddings: &'a Tensor,
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

/// One number a query, i64 \[queries\], on the pass's device.
fn column(queries: &[Query], number: impl Fn(&Query) -> i64, pass: &Pass) -> Tensor {
    Tensor::from_slice(&queries.iter().map(number).collect::<Vec<i64>>()).to_device(pass.beliefs.device())
}

impl Auxiliary {
    /// Declares the task's parameters.
    pub fn new(config: &AuxiliaryConfig, layout: &mut Layout, hidden: i64, actions: i64) -> Self {
        let (sizes, share) = ([hidden, actions], config.subsample);
        match config.task {
            AuxiliaryTask::None => Self::None,
            AuxiliaryTask::Disturb => Self::Disturb(Disturb::new(layout, sizes, config.focal_gamma)),
            AuxiliaryTask::InverseDynamics => {
                Self::InverseDynamics { task: InverseDynamics::new(layout, sizes), share }
            }
            AuxiliaryTask::Cpca16 => Self::Cpca { task: Cpca::new(layout, sizes), share },
        }
    }

    /// What the task asks of each pass in an epoch.
    pub fn queries(&self, packings: &[&Packing], epoch: Epoch, peers: &Peers) -> Result<Vec<Vec<Query>>, PeerError> {
        match self {
            Self::None => Ok(packings.iter().map(|_| Vec::new()).collect()),
            Self::Disturb(_) => epoch.queries(packings, 1, 1.0, peers),
            Self::InverseDynamics { share, .. } => epoch.queries(packings, 1, *share, peers),
            Self::Cpca { share, .. } => {
                let mut queries = epoch.queries(packings, cpca::HORIZON as usize, *share, peers)?;
                for (queries, packing) in queries.iter_mut().zip(packings) {
                    let elsewhere = epoch.permutation(packing);
                    for query in queries {
                        query.elsewhere = elsewhere[query.later as usize];
                    }
                }
                Ok(queries)
            }
        }
    }

    /// Names of the sums that the figures are made of, in a fixed order.
    pub fn sums(&self) -> &'static [&'static str] {
        match self {
            Self::None => &[],
            Self::Disturb(_) => &Disturb::SUMS,
            Self::InverseDynamics { .. } => &InverseDynamics::SUMS,
            Self::Cpca { .. } => &Cpca::SUMS,
        }
    }

    /// The loss of a pass, one of several in which `count` queries are answered; `None` if it has nothing to say.
    pub fn loss(&self, parameters: &Parameters, pass: &Pass, queries: &[Query], count: u64) -> Option<Answer> {
        if queries.is_empty() {
            return None;
        }
        match self {
            Self::None => None,
            Self::Disturb(task) => Some(task.loss(parameters, pass, queries, count)),
            Self::InverseDynamics { task, .. } => Some(task.loss(parameters, pass, queries, count)),
            Self::Cpca { task, .. } => Some(task.loss(parameters, pass, queries, count)),
        }
    }

    /// The task's figures, named `auxiliary/…`, from the sums of all passes.
    pub fn figures(&self, tally: &Tally) -> BTreeMap<String, f64> {
        match self {
            Self::None => BTreeMap::new(),
            Self::Disturb(task) => task.figures(tally),
            Self::InverseDynamics { task, .. } => task.figures(tally),
            Self::Cpca { task, .. } => task.figures(tally),
        }
    }
}
