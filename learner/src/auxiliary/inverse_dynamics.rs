//! Inverse dynamics (Ye et al., *Auxiliary Tasks and Exploration Enable `ObjectNav`*, ICCV 2021): which action led from
//! one observation to the next? Asked of the embeddings of both and of the belief at the end of the episode's part that
//! the rollout holds.

use super::query::{Epoch, Query};
use super::task::{Pass, Sizes, Tally, Task, TaskEntry, TaskLoss};
use crate::device::upload;
use crate::network::{Layout, Linear, OBSERVATION, Packing, Parameters};
use crate::peers::{PeerError, Peers};
use proto::config::AuxiliaryTask;
use std::collections::BTreeMap;
use tch::{Kind, Reduction, Tensor};

pub(crate) const ENTRY: TaskEntry = TaskEntry {
    task: AuxiliaryTask::InverseDynamics,
    name: "inverse_dynamics",
    allenact: Some("aux_models.InvDyn.decoder."),
    declare: |layout, sizes, config| Box::new(InverseDynamics::new(layout, sizes, config.subsample)),
};

const SUMS: [&str; 2] = ["right", "asked"];

/// \[embedding t, embedding t+1, final belief\] → one logit an action.
#[derive(Debug)]
pub struct InverseDynamics {
    decoder: Linear,
    /// Share of the valid steps that an epoch uses.
    share: f64,
}

impl InverseDynamics {
    /// Declares the layer. `share` of the valid steps is used in an epoch.
    pub fn new(layout: &mut Layout, Sizes { hidden, actions }: Sizes, share: f64) -> Self {
        let sizes = [2 * OBSERVATION + hidden, actions];
        Self { decoder: Linear::with_default(layout, &format!("auxiliary.{}", ENTRY.name), sizes), share }
    }
}

impl Task for InverseDynamics {
    /// A share of the rows that have a successor in their episode.
    fn queries(&self, packings: &[&Packing], epoch: Epoch, peers: &Peers) -> Result<Vec<Vec<Query>>, PeerError> {
        epoch.queries(packings, 1, self.share, peers)
    }

    /// Cross entropy of the actions taken.
    fn loss(&self, parameters: &Parameters, pass: &Pass, queries: &[Query], count: u64) -> TaskLoss {
        let rows = pass.of_queries(queries, |query| query.row);
        let later = pass.of_queries(queries, |query| query.later);
        let last = upload(&pass.packing.last(), pass.beliefs.device());
        let known = [
            pass.embeddings.index_select(0, &rows),
            pass.embeddings.index_select(0, &later),
            pass.beliefs.index_select(0, &last.index_select(0, &rows)),
        ];
        let logits = self.decoder.forward(parameters, &Tensor::cat(&known, 1));
        let taken = pass.actions.index_select(0, &rows);

        let right = logits.detach().argmax(1, false).eq_tensor(&taken).sum(Kind::Int64);
        let no_weight: Option<Tensor> = None;
        let loss = logits.cross_entropy_loss(&taken, no_weight, Reduction::Sum, -100, 0.0) / count as f64;
        TaskLoss { loss, sums: vec![right, pass.known(queries.len())] }
    }

    fn sums(&self) -> &'static [&'static str] {
        &SUMS
    }

    /// Share of actions guessed right.
    fn figures(&self, tally: &Tally) -> BTreeMap<String, f64> {
        let asked = tally.sum("asked");
        if asked > 0.0 {
            BTreeMap::from([("auxiliary/accuracy".to_owned(), tally.sum("right") / asked)])
        } else {
            BTreeMap::new()
        }
    }
}
