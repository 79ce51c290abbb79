//! Inverse dynamics (Ye et al., *Auxiliary Tasks and Exploration Enable `ObjectNav`*, ICCV 2021): which action led from
//! one observation to the next? Asked of the embeddings of both and of the belief at the end of the episode's part that
//! the rollout holds.

use super::{Answer, Pass, Query, Tally, column};
use crate::network::{Layout, Linear, OBSERVATION, Parameters};
use std::collections::BTreeMap;
use tch::{Kind, Reduction, Tensor};

/// \[embedding t, embedding t+1, final belief\] → one logit an action.
#[derive(Debug)]
pub struct InverseDynamics {
    decoder: Linear,
}

impl InverseDynamics {
    /// What its tally holds.
    pub const SUMS: [&str; 2] = ["right", "asked"];

    /// Declares the layer.
    pub fn new(layout: &mut Layout, [hidden, actions]: [i64; 2]) -> Self {
        let sizes = [2 * OBSERVATION + hidden, actions];
        Self { decoder: Linear::with_default(layout, "auxiliary.inverse_dynamics", sizes) }
    }

    /// This pass's share of the mean cross entropy over all `count` queries.
    pub fn loss(&self, parameters: &Parameters, pass: &Pass, queries: &[Query], count: u64) -> Answer {
        let rows = column(queries, |query| query.row, pass);
        let later = column(queries, |query| query.later, pass);
        let last = Tensor::from_slice(&pass.packing.last()).to_device(pass.beliefs.device());
        let known = [
            pass.embeddings.index_select(0, &rows),
            pass.embeddings.index_select(0, &later),
            pass.beliefs.index_select(0, &last.index_select(0, &rows)),
        ];
        let logits = self.decoder.forward(parameters, &Tensor::cat(&known, 1));
        let taken = pass.actions.index_select(0, &rows);

        let mut tally = Tally::default();
        let right = logits.detach().argmax(1, false).eq_tensor(&taken).sum(Kind::Int64);
        tally.add("right", right.int64_value(&[]) as f64);
        tally.add("asked", queries.len() as f64);
        let no_weight: Option<Tensor> = None;
        let loss = logits.cross_entropy_loss(&taken, no_weight, Reduction::Sum, -100, 0.0) / count as f64;
        Answer { loss, tally }
    }

    /// Share of actions guessed right.
    pub fn figures(&self, tally: &Tally) -> BTreeMap<String, f64> {
        let asked = tally.sum("asked");
        if asked > 0.0 {
            BTreeMap::from([("auxiliary/accuracy".to_owned(), tally.sum("right") / asked)])
        } else {
            BTreeMap::new()
        }
    }
}
