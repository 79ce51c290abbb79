//! The example of docs/own-parts.md, which only tests compile: reward prediction (Jaderberg et al., *Reinforcement
//! Learning with Unsupervised Auxiliary Tasks*, 2017), here as a regression: from the belief and the action taken, what
//! will this action be rewarded with?

use super::query::{Epoch, Query};
use super::task::{Pass, Sizes, Tally, Task, TaskLoss};
use crate::network::{Layout, Linear, Packing, Parameters};
use crate::peers::{PeerError, Peers};
use std::collections::BTreeMap;
use tch::{Kind, Reduction};

const SUMS: [&str; 2] = ["absolute_error", "asked"];

/// hidden → one expected reward an action.
#[derive(Debug)]
pub(crate) struct RewardPrediction {
    head: Linear,
}

impl RewardPrediction {
    pub(crate) fn new(layout: &mut Layout, Sizes { hidden, actions }: Sizes) -> Self {
        Self { head: Linear::with_default(layout, "auxiliary.reward_prediction", [hidden, actions]) }
    }
}

impl Task for RewardPrediction {
    /// Every row that has a successor in its episode.
    fn queries(&self, packings: &[&Packing], epoch: Epoch, peers: &Peers) -> Result<Vec<Vec<Query>>, PeerError> {
        epoch.queries(packings, 1, 1.0, peers)
    }

    /// Squared error. The sum over this pass is divided by the queries of all passes at all learners, so that the parts
    /// add up to the mean.
    fn loss(&self, parameters: &Parameters, pass: &Pass, queries: &[Query], count: u64) -> TaskLoss {
        let asked = pass.of_queries(queries, |query| query.row);
        let of_actions = self.head.forward(parameters, pass.beliefs);
        let expected = of_actions.gather(1, &pass.actions.unsqueeze(1), false).squeeze_dim(1).index_select(0, &asked);
        let rewards = pass.rollout.gather(pass.packing, |step| step.reward).index_select(0, &asked);

        let error = (expected.detach() - &rewards).abs().sum(Kind::Double);
        let loss = expected.mse_loss(&rewards, Reduction::Sum) / count as f64;
        TaskLoss { loss, sums: vec![error, pass.known(queries.len())] }
    }

    fn sums(&self) -> &'static [&'static str] {
        &SUMS
    }

    /// Mean absolute error: a curve of its own in every program that shows a run's figures.
    fn figures(&self, tally: &Tally) -> BTreeMap<String, f64> {
        let [error, asked] = SUMS.map(|name| tally.sum(name));
        let mean = (asked > 0.0).then(|| ("auxiliary/reward_error".to_owned(), error / asked));
        mean.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Kept;
    use crate::rollout::{Outcome, Rollout, Step};
    use proto::stage::RolloutShape;
    use tch::{Device, Tensor};

    const SIZES: Sizes = Sizes { hidden: 4, actions: 3 };
    const COLUMNS: usize = 2;
    const STEPS: usize = 5;

    /// Rewards 0.1, 0.2, ... in the order of steps.
    fn rollout() -> Rollout {
        let shape = RolloutShape { steps: STEPS, environments_in_last_step: COLUMNS, frames: (STEPS * COLUMNS) as u64 };
        let zeros = |size: &[i64]| Tensor::zeros(size, (Kind::Float, Device::Cpu));
        let kept = |rows: i64| Kept::of_frames(zeros(&[rows, 1, 1]));
        let rows = (STEPS * COLUMNS) as i64;
        let mut rollout = Rollout::new(shape, COLUMNS, kept(rows), zeros(&[COLUMNS as i64, SIZES.hidden]));
        for t in 0..STEPS {
            let steps = [(); COLUMNS].map(|()| Step::default());
            rollout.store(t, &[0, 1], &kept(COLUMNS as i64), &steps);
            for column in 0..COLUMNS {
                let reward = (t * COLUMNS + column + 1) as f32 / 10.0;
                rollout.record(t, column, Outcome { reward, ..Outcome::default() });
            }
        }
        rollout
    }

    #[test]
    fn the_loss_is_the_mean_squared_error_and_training_lowers_it() {
        let rollout = rollout();
        let packing = rollout.packing(0..COLUMNS);
        let mut layout = Layout::default();
        let task = RewardPrediction::new(&mut layout, SIZES);
        let parameters = Parameters::new(layout, 1, Device::Cpu);
        let rows = packing.rows.len() as i64;
        let beliefs =
            Tensor::arange(rows * SIZES.hidden, (Kind::Float, Device::Cpu)).reshape([rows, SIZES.hidden]) * 0.02;
        let actions = Tensor::zeros([rows], (Kind::Int64, Device::Cpu));
        let pass =
            Pass { rollout: &rollout, packing: &packing, embeddings: &beliefs, beliefs: &beliefs, actions: &actions };
        let epoch = Epoch { seed: 1, rollout: 0, epoch: 0, first_column: 0 };
        let queries = task.queries(&[&packing], epoch, &Peers::Alone).unwrap().remove(0);
        // The last step of each column has no successor.
        let count = (STEPS - 1) * COLUMNS;
        assert_eq!(queries.len(), count);

        let by_hand = |parameters: &Parameters| {
            let expected = task.head.forward(parameters, &beliefs);
            let error = |query: &Query| {
                let (t, column) = packing.rows[query.row as usize];
                expected.double_value(&[query.row, 0]) - f64::from(rollout.step(t, column).reward)
            };
            queries.iter().map(error).collect::<Vec<f64>>()
        };
        let errors = by_hand(&parameters);
        let TaskLoss { loss, sums } = task.loss(&parameters, &pass, &queries, count as u64);
        let sums: Vec<f64> = sums.iter().map(|sum| sum.double_value(&[])).collect();
        let tally = Tally::of(task.sums(), &sums);
        let mean = |values: &dyn Fn(f64) -> f64| errors.iter().map(|&error| values(error)).sum::<f64>() / count as f64;
        assert!((loss.double_value(&[]) - mean(&|error| error * error)).abs() < 1e-6);
        assert!((task.figures(&tally)["auxiliary/reward_error"] - mean(&f64::abs)).abs() < 1e-6);
        assert!(task.figures(&Tally::default()).is_empty());

        let gradient = parameters.gradient_of(&loss);
        tch::no_grad(|| {
            let _ = parameters.flat().g_add_(&(gradient * -0.1));
        });
        let squares = |errors: &[f64]| errors.iter().map(|error| error * error).sum::<f64>();
        assert!(squares(&by_hand(&parameters)) < squares(&errors));
    }
}
