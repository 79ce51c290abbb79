//! Disturbance prediction, the paper's auxiliary task (Ni et al. section 3.2): from the belief `b_t` and the action
//! taken, will this action move an object?
//!
//! Disturbances are rare. Hence the focal loss (Lin et al. 2017), and an initial last bias that predicts "no
//! disturbance". As in the reference, rows without a successor in the rollout, and rows whose successor begins an
//! episode, are left out.

use super::query::{Epoch, Query};
use super::task::{Pass, Sizes, Tally, Task, TaskEntry, TaskLoss};
use crate::network::{Initial, Layout, Linear, Packing, Parameters};
use crate::peers::{PeerError, Peers};
use proto::config::AuxiliaryTask;
use std::collections::BTreeMap;
use tch::{Kind, Reduction, Tensor};

pub(crate) const ENTRY: TaskEntry = TaskEntry {
    task: AuxiliaryTask::Disturb,
    name: "disturb",
    allenact: Some("aux_models.Disturb_Pred.classifier."),
    declare: |layout, sizes, config| Box::new(Disturb::new(layout, sizes, config.focal_gamma)),
};

const SUMS: [&str; 4] = ["hits", "misses", "alarms", "quiet"];

/// Width of the hidden layer.
const WIDTH: i64 = 128;
/// Initial value of the last bias: a probability of 1.1%.
const LAST_BIAS: f64 = -4.5;

/// hidden → 128 → `ReLU` → one logit an action.
#[derive(Debug)]
pub struct Disturb {
    first: Linear,
    second: Linear,
    focal_gamma: f64,
}

impl Disturb {
    pub fn new(layout: &mut Layout, Sizes { hidden, actions }: Sizes, focal_gamma: f64) -> Self {
        let path = format!("auxiliary.{}", ENTRY.name);
        let bias = Initial::Constant(LAST_BIAS);
        Self {
            first: Linear::with_default(layout, &format!("{path}.0"), [hidden, WIDTH]),
            second: Linear::new(layout, &format!("{path}.2"), [WIDTH, actions], Initial::linear_default(WIDTH), bias),
            focal_gamma,
        }
    }

    /// Logits of all actions, \[rows, hidden\] → \[rows, actions\].
    pub fn logits(&self, parameters: &Parameters, beliefs: &Tensor) -> Tensor {
        self.second.forward(parameters, &self.first.forward(parameters, beliefs).relu())
    }
}

impl Task for Disturb {
    /// Every row that has a successor in its episode.
    fn queries(&self, packings: &[&Packing], epoch: Epoch, peers: &Peers) -> Result<Vec<Vec<Query>>, PeerError> {
        epoch.queries(packings, 1, 1.0, peers)
    }

    /// Focal loss.
    fn loss(&self, parameters: &Parameters, pass: &Pass, queries: &[Query], count: u64) -> TaskLoss {
        let asked = pass.of_queries(queries, |query| query.row);
        let logits = self.logits(parameters, pass.beliefs).gather(1, &pass.actions.unsqueeze(1), false).squeeze_dim(1);
        let logits = logits.index_select(0, &asked);
        let labels = pass.rollout.gather(pass.packing, |step| f32::from(u8::from(step.label)));
        let labels = labels.index_select(0, &asked);

        let loss = focal_loss(&logits, &labels, self.focal_gamma).sum(Kind::Float) / count as f64;
        TaskLoss { sums: outcomes(&logits.detach(), &labels).into(), loss }
    }

    fn sums(&self) -> &'static [&'static str] {
        &SUMS
    }

    /// Recall of either class, precision, accuracy, rates of label and prediction. A share of nothing is absent.
    fn figures(&self, tally: &Tally) -> BTreeMap<String, f64> {
        let [hits, misses, alarms, quiet] = SUMS.map(|name| tally.sum(name));
        let all = hits + misses + alarms + quiet;
        [
            ("recall_disturb", hits, hits + misses),
            ("recall_no_disturb", quiet, quiet + alarms),
            ("precision", hits, hits + alarms),
            ("accuracy", hits + quiet, all),
            ("label_rate", hits + misses, all),
            ("prediction_rate", hits + alarms, all),
        ]
        .into_iter()
        .filter(|&(_, _, of)| of > 0.0)
        .map(|(name, part, of)| (format!("auxiliary/{name}"), part / of))
        .collect()
    }

    fn label_logits(&self, parameters: &Parameters, beliefs: &Tensor) -> Option<Tensor> {
        Some(self.logits(parameters, beliefs))
    }
}

/// (1 − p)^γ · −ln p of each row, p the probability given to the true label. Logits and labels (0 or 1) \[rows\].
pub fn focal_loss(logits: &Tensor, labels: &Tensor, gamma: f64) -> Tensor {
    let surprise = logits.binary_cross_entropy_with_logits::<Tensor>(labels, None, None, Reduction::None);
    // 1 − p without the cancellation of 1 − exp(−surprise): the sigmoid of the logit for the wrong label.
    let sign: Tensor = 1.0 - labels * 2.0;
    let wrong = (sign * logits).sigmoid();
    wrong.pow_tensor_scalar(gamma) * surprise
}

/// Counts of the four outcomes of predicting "disturbs" where the logit is positive, in the order of [`SUMS`].
fn outcomes(logits: &Tensor, labels: &Tensor) -> [Tensor; 4] {
    let predicted = logits.gt(0.0);
    let disturbed = labels.gt(0.5);
    [
        predicted.logical_and(&disturbed),
        predicted.logical_not().logical_and(&disturbed),
        predicted.logical_and(&disturbed.logical_not()),
        predicted.logical_or(&disturbed).logical_not(),
    ]
    .map(|set| set.sum(Kind::Int64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_known_confusion_matrix() {
        let mut layout = Layout::default();
        let task = Disturb::new(&mut layout, Sizes { hidden: 4, actions: 3 }, 2.0);
        let logits = Tensor::from_slice(&[1f32, -1.0, 2.0, -2.0, -3.0, 0.5]);
        let labels = Tensor::from_slice(&[1f32, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let tally = |logits: &Tensor, labels: &Tensor| {
            let counts = outcomes(logits, labels).map(|count| count.int64_value(&[]) as f64);
            Tally::of(&SUMS, &counts)
        };
        let figures = task.figures(&tally(&logits, &labels));
        let figure = |name: &str| figures[&format!("auxiliary/{name}")];
        assert!((figure("recall_disturb") - 2.0 / 3.0).abs() < 1e-12);
        assert!((figure("recall_no_disturb") - 2.0 / 3.0).abs() < 1e-12);
        assert!((figure("precision") - 2.0 / 3.0).abs() < 1e-12);
        assert!((figure("accuracy") - 4.0 / 6.0).abs() < 1e-12);
        assert!((figure("label_rate") - 0.5).abs() < 1e-12);
        assert!((figure("prediction_rate") - 0.5).abs() < 1e-12);
        // Nothing was predicted to disturb: precision is a share of nothing.
        let none = tally(&Tensor::from_slice(&[-1f32]), &Tensor::from_slice(&[0f32]));
        assert!(!task.figures(&none).contains_key("auxiliary/precision"));
    }
}
