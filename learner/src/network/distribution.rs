//! The policy as a distribution over actions: log-probabilities, entropies, and what an action is drawn from.

use super::initialize::Initial;
use super::parameters::{Layout, ParameterId, Parameters};
use proto::task::ActionHead;
use tch::{Kind, Tensor};

/// In place of the logit of an option that a mask forbids: its probability is exactly 0, and so are its part of the entropy
/// and the gradient that goes through it (Huang and Ontañón 2022; sb3-contrib and `CleanRL` have the same number).
pub(crate) const FORBIDDEN_LOGIT: f64 = -1e8;

pub(crate) const HALF_LN_TAU: f64 = 0.918_938_533_204_672_7;

#[derive(Debug)]
pub enum Distribution {
    /// Independent choices: log-probabilities of the options of each, side by side, \[rows, options\]; options of each.
    Categorical { log_probs: Tensor, choices: Vec<i64> },
    /// Independent numbers: means \[rows, numbers\], and logarithms of standard deviations, which no observation changes,
    /// \[numbers\].
    Gaussian { means: Tensor, log_std: Tensor },
}

#[derive(Debug)]
pub(super) enum Maker {
    Categorical(Vec<i64>),
    Gaussian(ParameterId),
}

impl Maker {
    /// Declares the deviations, if there are some, with what their logarithms begin with.
    pub fn new(layout: &mut Layout, head: &ActionHead, log_std: f64) -> Self {
        if head.is_gaussian() {
            Self::Gaussian(layout.add("log_std".to_owned(), &[head.outputs() as i64], Initial::Constant(log_std)))
        } else {
            Self::Categorical(head.choices().map(|options| options as i64).collect())
        }
    }

    /// Logarithms of the standard deviations \[numbers\].
    pub fn log_std<'a>(&self, parameters: &'a Parameters) -> Option<&'a Tensor> {
        match self {
            Self::Categorical(_) => None,
            Self::Gaussian(id) => Some(&parameters[*id]),
        }
    }

    /// Of what the actor gives, \[rows, outputs\]. `masks` are true where an option may be chosen, \[rows, options\].
    pub fn distribution(&self, parameters: &Parameters, outputs: Tensor, masks: Option<&Tensor>) -> Distribution {
        match self {
            Self::Categorical(choices) => {
                let outputs = match masks {
                    Some(masks) => outputs.masked_fill(&masks.logical_not(), FORBIDDEN_LOGIT),
                    None => outputs,
                };
                let of_choice = |logits: Tensor| logits.log_softmax(-1, None);
                let log_probs = parts(outputs, choices).into_iter().map(of_choice).collect();
                Distribution::Categorical { log_probs: beside(log_probs), choices: choices.clone() }
            }
            Self::Gaussian(id) => Distribution::Gaussian { means: outputs, log_std: parameters[*id].shallow_clone() },
        }
    }
}

fn parts(columns: Tensor, choices: &[i64]) -> Vec<Tensor> {
    if choices.len() == 1 { vec![columns] } else { columns.split_with_sizes(choices, 1) }
}

/// The numbers \[rows\] of a table \[rows, options\] at the options \[rows, 1\].
fn chosen(table: &Tensor, options: &Tensor) -> Tensor {
    if !table.device().is_cuda() {
        return table.gather(1, options, false).squeeze_dim(1);
    }
    // The same numbers. The backward pass of `gather` waits for the GPU where it is to be deterministic.
    let all = Tensor::arange(table.size()[1], (Kind::Int64, table.device()));
    table.where_self(&options.eq_tensor(&all), &table.zeros_like()).sum_dim_intlist(1, false, Kind::Float)
}

/// Tables side by side; one alone without a copy.
fn beside(mut tables: Vec<Tensor>) -> Tensor {
    if tables.len() == 1 { tables.remove(0) } else { Tensor::cat(&tables, 1) }
}

impl Distribution {
    /// Log-probabilities \[rows\] of actions: i64 \[rows, choices\], or f32 \[rows, numbers\].
    pub fn log_prob(&self, actions: &Tensor) -> Tensor {
        match self {
            Self::Categorical { log_probs, choices } => {
                let of_choice = |(at, log_probs): (usize, Tensor)| chosen(&log_probs, &actions.narrow(1, at as i64, 1));
                let parts = parts(log_probs.shallow_clone(), choices).into_iter().enumerate();
                parts.map(of_choice).reduce(|sum, log_prob| sum + log_prob).expect("a policy chooses")
            }
            Self::Gaussian { means, log_std } => {
                let away = (actions - means) * (-log_std).exp();
                let log_probs = away.square() * -0.5 - log_std - HALF_LN_TAU;
                log_probs.sum_dim_intlist(-1, false, Kind::Float)
            }
        }
    }

    /// Entropies \[rows\], nats.
    pub fn entropy(&self) -> Tensor {
        match self {
            // Of independent choices they add up.
            Self::Categorical { log_probs, .. } => {
                -(log_probs.exp() * log_probs).sum_dim_intlist(-1, false, Kind::Float)
            }
            Self::Gaussian { means, log_std } => {
                (log_std + HALF_LN_TAU + 0.5).sum(Kind::Float).expand([means.size()[0]], false)
            }
        }
    }

    /// What it is given by, each \[rows, …\], by name.
    pub fn tables(self) -> Vec<(&'static str, Tensor)> {
        match self {
            Self::Categorical { log_probs, .. } => vec![("log_probs", log_probs)],
            Self::Gaussian { means, log_std } => {
                let log_std = log_std.expand_as(&means);
                vec![("means", means), ("log_stds", log_std)]
            }
        }
    }

    /// The same side by side, \[rows, …\]: what an action is drawn from.
    pub fn rows(self) -> Tensor {
        beside(self.tables().into_iter().map(|(_, table)| table).collect())
    }
}
