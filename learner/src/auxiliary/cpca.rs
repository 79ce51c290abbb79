//! CPC|A: contrastive prediction of what comes after the next actions (Guo et al., *Neural Predictive Belief
//! Representations*, 2018), 16 steps ahead.
//!
//! From the belief `b_t` a second GRU runs on with the actions that were taken, without observations. After each step a
//! classifier gets the GRU's state and an observation's embedding, and predicts whether this observation is the one
//! that followed. Negative samples come from other rows of the batch.

use super::query::{Epoch, Query};
use super::task::{Pass, Sizes, Tally, Task, TaskEntry, TaskLoss};
use crate::device::upload;
use crate::network::{Initial, Layout, Linear, OBSERVATION, Packing, ParameterId, Parameters, Recurrent};
use crate::peers::{PeerError, Peers};
use proto::config::AuxiliaryTask;
use std::collections::BTreeMap;
use tch::{Kind, Reduction, Tensor};

pub(crate) const ENTRY: TaskEntry = TaskEntry {
    task: AuxiliaryTask::Cpca16,
    name: "cpca16",
    allenact: Some("aux_models.CPCA_16."),
    declare: |layout, sizes, config| Box::new(Cpca::new(layout, sizes, config.subsample)),
};

const SUMS: [&str; 3] = ["asked", "positives_right", "negatives_right"];

/// Number of steps predicted ahead.
const HORIZON: i64 = 16;
/// Width of an action's embedding.
const ACTION: i64 = 16;
/// Width of the classifier's hidden layer.
const WIDTH: i64 = 32;

/// Action embedding → GRU from the belief; \[embedding, state\] → 32 → `ReLU` → one logit.
#[derive(Debug)]
pub struct Cpca {
    action_embedder: ParameterId,
    context: Recurrent,
    first: Linear,
    second: Linear,
    /// Share of the valid pairs of step and offset that an epoch uses.
    share: f64,
}

impl Cpca {
    /// Declares embedding, GRU and classifier. `share` of the valid pairs of step and offset is used in an epoch.
    pub fn new(layout: &mut Layout, Sizes { hidden, actions }: Sizes, share: f64) -> Self {
        let path = format!("auxiliary.{}", ENTRY.name);
        let normal = Initial::Normal { deviation: 1.0 };
        Self {
            action_embedder: layout.add(format!("{path}.action_embedder.weight"), &[actions, ACTION], normal),
            context: Recurrent::gru_with_default(layout, &format!("{path}.context_model"), [ACTION, hidden]),
            first: Linear::with_default(layout, &format!("{path}.classifier.0"), [OBSERVATION + hidden, WIDTH]),
            second: Linear::with_default(layout, &format!("{path}.classifier.2"), [WIDTH, 1]),
            share,
        }
    }

    /// States of the second GRU, \[horizon, rows, hidden\]: k steps on from each row's belief with the actions taken.
    /// Beyond a segment's end the actions are arbitrary; no query uses these states.
    fn contexts(&self, parameters: &Parameters, pass: &Pass) -> Tensor {
        let taken: Vec<i64> =
            (0..HORIZON as usize).flat_map(|k| pass.packing.later(k).into_iter().map(|row| row.unwrap_or(0))).collect();
        let taken = upload(&taken, pass.beliefs.device());
        let actions = pass.actions.index_select(0, &taken);
        let embedded = Tensor::embedding(&parameters[self.action_embedder], &actions, -1, false, false);
        self.context.sequence(parameters, &embedded.view([HORIZON, -1, ACTION]), pass.beliefs)
    }
}

impl Task for Cpca {
    /// A share of the pairs of row and offset that lie in one episode, each with a negative sample from its pass.
    fn queries(&self, packings: &[&Packing], epoch: Epoch, peers: &Peers) -> Result<Vec<Vec<Query>>, PeerError> {
        let mut queries = epoch.queries(packings, HORIZON as usize, self.share, peers)?;
        for (queries, packing) in queries.iter_mut().zip(packings) {
            let negatives = epoch.permutation(packing);
            for query in queries {
                query.negative = negatives[query.later as usize];
            }
        }
        Ok(queries)
    }

    /// Cross entropy of the positive samples plus that of the negative ones.
    fn loss(&self, parameters: &Parameters, pass: &Pass, queries: &[Query], count: u64) -> TaskLoss {
        let device = pass.beliefs.device();
        let later = pass.of_queries(queries, |query| query.later);
        let negative = pass.of_queries(queries, |query| query.negative);

        let contexts = self.contexts(parameters, pass);
        let rows = pass.packing.rows.len() as i64;
        let at = pass.of_queries(queries, |query| (query.offset - 1) * rows + query.row);
        let contexts = contexts.view([-1, self.context.hidden()]).index_select(0, &at);

        let classify = |seen: &Tensor| {
            let input = Tensor::cat(&[pass.embeddings.index_select(0, seen), contexts.shallow_clone()], 1);
            self.second.forward(parameters, &self.first.forward(parameters, &input).relu()).squeeze_dim(1)
        };
        let cross_entropy = |logits: &Tensor, label: f64| {
            let labels = Tensor::full([logits.size()[0]], label, (Kind::Float, device));
            logits.binary_cross_entropy_with_logits::<Tensor>(&labels, None, None, Reduction::Sum) / count as f64
        };
        let (positive, negative) = (classify(&later), classify(&negative));

        let count = |set: Tensor| set.sum(Kind::Int64);
        let sums = vec![
            pass.known(queries.len()),
            count(positive.detach().gt(0.0)),
            count(negative.detach().gt(0.0).logical_not()),
        ];
        TaskLoss { loss: cross_entropy(&positive, 1.0) + cross_entropy(&negative, 0.0), sums }
    }

    fn sums(&self) -> &'static [&'static str] {
        &SUMS
    }

    /// Shares of positive and of negative samples that are classified correctly.
    fn figures(&self, tally: &Tally) -> BTreeMap<String, f64> {
        let asked = tally.sum("asked");
        ["positives_right", "negatives_right"]
            .into_iter()
            .filter(|_| asked > 0.0)
            .map(|name| (format!("auxiliary/{name}"), tally.sum(name) / asked))
            .collect()
    }
}
