//! Network, losses and gradient of an update's first epoch, by name and cell.

use super::batch::Batch;
use crate::auxiliary::{Auxiliary, Query};
use crate::network::{ActorCriticOutput, Network, Packing};
use crate::optimizer::norm;
use crate::peers::Peers;
use crate::ppo::gae::{self, Targets};
use crate::ppo::loss::Coefficients;
use crate::ppo::metrics::{SCALARS, StepMetrics};
use crate::ppo::minibatch::{Chunk, Whole};
use crate::ppo::moments::RewardScale;
use crate::ppo::{Totals, Update, UpdateError};
use crate::rollout::Rollout;
use crate::shards::Shards;
use proto::config::{Config, PpoConfig};
use proto::metric;
use std::collections::BTreeMap;
use tch::{Device, Tensor};

pub(super) struct Probed {
    /// Tables by cell, gradients by weight, and the figures as single numbers.
    pub tensors: BTreeMap<String, Tensor>,
    pub figures: BTreeMap<String, f64>,
}

/// Computes what an update with this batch begins with. All columns go through the network at once, whatever the
/// configuration gives; weights stay as they are.
pub(super) fn probe(
    config: &Config,
    network: &Network,
    auxiliary: &Auxiliary,
    reward_scale: RewardScale,
    batch: &Batch,
) -> Result<Probed, UpdateError> {
    let Batch { rollout, negatives } = batch;
    let shards = Shards::one(rollout.columns());
    let update = Update {
        network,
        auxiliary,
        rollout,
        ppo: &config.ppo,
        auxiliary_config: &config.auxiliary,
        peers: &Peers::Alone,
        shards: &shards,
        reward_scale,
        first_column: 0,
        learning_rate: config.ppo.learning_rate,
        seed: config.seed,
        rollout_number: 0,
        graphs: None,
    };
    // The batch is one minibatch.
    let ppo = PpoConfig { normalize_by_minibatch: false, ..config.ppo };
    let targets = gae::estimate(rollout, &ppo, reward_scale, &shards, update.peers)?;
    let columns: Vec<usize> = (0..rollout.columns()).collect();
    let whole = Whole::new(rollout, &targets);
    let chunks = Chunk::divide(&whole, &[(0, columns)], 0);
    let packing = rollout.packing(0..rollout.columns());
    let cells = Cells { rollout, packing: &packing };
    let mut queries = auxiliary.queries(&[&packing], update.epoch(0), update.peers)?.pop().unwrap_or_default();
    if let Some(negatives) = negatives {
        let rows: BTreeMap<usize, i64> = packing.rows.iter().map(|&row| cells.index(row)).zip(0..).collect();
        for query in &mut queries {
            // Checked when it was read: the cell is a frame of the batch.
            query.negative = rows[&negatives[cells.index(packing.rows[query.later as usize])]];
        }
    }
    let coefficients = Coefficients::of(&ppo, rollout.shape().frames, network.parameters.flat().device());
    let totals = Totals { coefficients: &coefficients, queries: queries.len() as u64 };
    let (gradient, step) = update.gradient(&whole, &chunks, std::slice::from_ref(&queries), totals)?;
    let metrics = step.read(&norm(&gradient), totals.queries, auxiliary, (&shards, update.peers))?;

    let mut tensors = cells.pass(network, &targets);
    if !queries.is_empty() {
        tensors.extend(cells.queries(&queries));
    }
    tensors.extend(gradients(network, &gradient));
    let figures = figures(config, auxiliary, &metrics);
    tensors.extend(figures.iter().map(|(name, &value)| (name.clone(), Tensor::from(value))));
    Ok(Probed { tensors, figures })
}

/// A batch's cells (step, column), in which rows of a packing are shown.
struct Cells<'a> {
    rollout: &'a Rollout,
    packing: &'a Packing,
}

impl Cells<'_> {
    fn index(&self, (t, n): (usize, usize)) -> usize {
        t * self.rollout.columns() + n
    }

    fn of_rows(&self) -> Vec<i64> {
        self.packing.rows.iter().map(|&row| self.index(row) as i64).collect()
    }

    /// Rows \[rows, …\] → (T, N, …), 0 in cells without a row.
    fn table(&self, rows: &Tensor) -> Tensor {
        let rows = rows.detach().to_device(Device::Cpu);
        let (steps, columns, width) = (self.rollout.shape().steps, self.rollout.columns(), &rows.size()[1..]);
        let size = [&[(steps * columns) as i64], width].concat();
        let mut table = Tensor::zeros(&size, (rows.kind(), Device::Cpu));
        let _ = table.index_copy_(0, &Tensor::from_slice(&self.of_rows()), &rows);
        table.view([&[steps as i64, columns as i64], width].concat().as_slice())
    }

    /// The forward pass once more, for what the losses do not contain, and the targets.
    fn pass(&self, network: &Network, targets: &Targets) -> BTreeMap<String, Tensor> {
        let Self { rollout, packing } = self;
        let _no_grad = tch::no_grad_guard();
        let (table, rows) = (rollout.table(), rollout.rows(packing));
        let observations = rollout.observations(&table, &rows);
        let embeddings = network.embed(&observations);
        let beliefs = network.belief.unroll(&network.parameters, &embeddings, packing, rollout.beliefs_at_start());
        let (privileged, masks) =
            (network.privileged(&observations), table.masks.map(|masks| masks.index_select(0, &rows)));
        let ActorCriticOutput { policy, values } = network.actor_critic(&beliefs, privileged.as_ref(), masks.as_ref());
        let last = (network.belief.state() > 0).then(|| self.last_states(network, &self.table(&embeddings)));
        let target = |of: &dyn Fn((usize, usize)) -> f32| {
            Tensor::from_slice(&packing.rows.iter().map(|&row| of(row)).collect::<Vec<f32>>())
        };
        let others = [
            ("values", values),
            ("embeddings", embeddings),
            ("beliefs", beliefs),
            ("advantages", target(&|row| targets.advantage(row))),
            ("returns", target(&|row| targets.value_target(row))),
        ];
        let tables = policy.tables().into_iter().chain(others);
        let tables = tables.map(|(name, rows)| (name.to_owned(), self.table(&rows)));
        tables.chain(last.map(|states| ("next_beliefs".to_owned(), states))).collect()
    }

    /// States \[columns, state\] behind the last observation of each column, of a table of embeddings: one step after the
    /// other, as in acting.
    fn last_states(&self, network: &Network, embeddings: &Tensor) -> Tensor {
        let device = network.parameters.flat().device();
        let of_column = |column: usize| {
            let state = self.rollout.beliefs_at_start().narrow(0, column as i64, 1);
            (0..self.rollout.steps_of(column)).fold(state, |state, t| {
                let carried = if self.rollout.step(t, column).episode_start { state.zeros_like() } else { state };
                let seen = embeddings.get(t as i64).narrow(0, column as i64, 1).to_device(device);
                network.belief.step(&network.parameters, &seen, &carried)
            })
        };
        let states: Vec<Tensor> = (0..self.rollout.columns()).map(of_column).collect();
        Tensor::cat(&states, 0).to_device(Device::Cpu)
    }

    /// What the auxiliary task was asked: (step, column, offset) of each query, and each cell's negative sample, -1
    /// where there is none.
    fn queries(&self, queries: &[Query]) -> [(String, Tensor); 2] {
        let rows = &self.packing.rows;
        let asked: Vec<i64> = queries
            .iter()
            .flat_map(|query| {
                let (t, n) = rows[query.row as usize];
                [t as i64, n as i64, query.offset]
            })
            .collect();
        let mut negatives = vec![-1; self.rollout.shape().steps * self.rollout.columns()];
        for query in queries {
            negatives[self.index(rows[query.later as usize])] = self.index(rows[query.negative as usize]) as i64;
        }
        [
            ("auxiliary.asked".to_owned(), Tensor::from_slice(&asked).view([-1, 3])),
            (
                "auxiliary.negatives".to_owned(),
                Tensor::from_slice(&negatives).view([-1, self.rollout.columns() as i64]),
            ),
        ]
    }
}

/// `gradient.NAME` of every weight, from the flat gradient.
fn gradients(network: &Network, flat: &Tensor) -> BTreeMap<String, Tensor> {
    let mut offset = 0;
    network
        .parameters
        .named()
        .map(|(name, weight)| {
            let count = weight.numel() as i64;
            let gradient = flat.narrow(0, offset, count).view(weight.size().as_slice());
            offset += count;
            (format!("gradient.{name}"), gradient.to_device(Device::Cpu).copy())
        })
        .collect()
}

/// Losses by their names in the metrics, the total loss, the auxiliary task's figures and the gradient's norm.
fn figures(config: &Config, auxiliary: &Auxiliary, metrics: &StepMetrics) -> BTreeMap<String, f64> {
    let mut figures = auxiliary.figures(&metrics.tally);
    figures.extend(SCALARS.iter().zip(metrics.scalars).map(|(name, value)| ((*name).to_owned(), value)));
    let [policy, value, entropy, task, ..] = metrics.scalars;
    let ppo = &config.ppo;
    let total =
        policy + ppo.value_coefficient * value - ppo.entropy_coefficient * entropy + config.auxiliary.weight * task;
    figures.insert("loss/total".to_owned(), total);
    figures.insert(metric::GRADIENT_NORM.to_owned(), metrics.gradient_norm);
    figures
}
