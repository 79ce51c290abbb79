//! Auxiliary tasks.

use crate::shared::{assert_probes, doubles, fixture, noise, noise_tensor, weight_values};
use learner::auxiliary::{Cpca, InverseDynamics, Pass, Query, Sizes, Task, TaskLoss};
use learner::network::{Kept, Layout, Packing, Parameters};
use learner::rollout::Rollout;
use proto::stage::RolloutShape;
use std::collections::BTreeMap;
use tch::{Device, Kind, Tensor};

const STEPS: usize = 20;
const COLUMNS: usize = 4;
const CELLS: usize = STEPS * COLUMNS;
const SIZES: Sizes = Sizes { hidden: 24, actions: 21 };

/// The script's rows, of which the last column has one fewer.
struct Rows {
    packing: Packing,
    /// Cell (step, column) of each row.
    cells: Vec<i64>,
}

impl Rows {
    fn new() -> Self {
        let starts: Vec<bool> = noise("auxiliary.starts", CELLS).into_iter().map(|value| value > 0.8).collect();
        let length = |n: usize| STEPS - usize::from(n + 1 == COLUMNS);
        let packing = Packing::new(0..COLUMNS, length, |t, n| starts[t * COLUMNS + n]);
        let cells = packing.rows.iter().map(|&(t, n)| (t * COLUMNS + n) as i64).collect();
        Self { packing, cells }
    }

    /// A leaf \[rows, width\].
    fn leaf(&self, name: &str, width: i64) -> Tensor {
        let cells = noise_tensor(name, &[CELLS as i64, width]);
        cells.index_select(0, &Tensor::from_slice(&self.cells)).set_requires_grad(true)
    }

    /// Rows back to cells: the cell that no row has gets nothing.
    fn scatter(&self, rows: &Tensor) -> Tensor {
        let mut cells = Tensor::zeros([CELLS as i64, rows.size()[1]], (Kind::Float, Device::Cpu));
        let _ = cells.index_copy_(0, &Tensor::from_slice(&self.cells), rows);
        cells
    }

    /// What the script asks.
    fn queries(&self, horizon: usize) -> Vec<Query> {
        (1..=horizon)
            .flat_map(|offset| {
                let chosen = noise(&format!("auxiliary.chosen.{offset}"), CELLS);
                let later = (0i64..).zip(self.packing.later(offset)).zip(&self.cells);
                later
                    .filter(|&(_, &cell)| chosen[cell as usize] > 0.4)
                    .filter_map(|((row, later), _)| {
                        Some(Query { row, offset: offset as i64, later: later?, negative: 0 })
                    })
                    .collect::<Vec<_>>()
            })
            .collect()
    }

    /// The negative sample of each row. The script permutes the valid cells in the order of steps.
    fn negatives(&self) -> Vec<i64> {
        let mut valid = self.cells.clone();
        valid.sort_unstable();
        let keys = noise("auxiliary.negatives", valid.len());
        let mut order: Vec<usize> = (0..valid.len()).collect();
        order.sort_by(|&a, &b| keys[a].total_cmp(&keys[b]));
        let row_of = |cell: i64| self.cells.iter().position(|&other| other == cell).expect("a valid cell") as i64;
        self.cells.iter().map(|cell| row_of(valid[order[valid.binary_search(cell).expect("a valid cell")]])).collect()
    }
}

/// Parameters with the script's weights.
fn weights(layout: Layout) -> Parameters {
    let parameters = Parameters::new(layout, 1, Device::Cpu);
    tch::no_grad(|| {
        for (name, mut weight) in parameters.named() {
            weight.copy_(&weight_values(name, &weight.size()));
        }
    });
    parameters
}

/// Compares a loss over `asked` queries and its gradients with the script's.
fn check(name: &str, rows: &Rows, pass: &Pass, parameters: &Parameters, asked: usize, answer: TaskLoss) {
    let expected = fixture("auxiliary");
    let loss = doubles(&expected[&format!("{name}.loss")]);
    assert_eq!(asked as f64, loss[1], "{name}: questions");
    let ours = answer.loss.double_value(&[]);
    assert!((ours - loss[0]).abs() < 1e-5 * loss[0], "{name}: {ours} is not {}", loss[0]);
    let leaves: Vec<Tensor> = parameters.ids().map(|id| parameters[id].shallow_clone()).collect();
    let names = parameters.named().map(|(name, _)| name.to_owned());
    let inputs: Vec<&Tensor> = leaves.iter().chain([pass.beliefs, pass.embeddings]).collect();
    let gradients = Tensor::run_backward(&[answer.loss], &inputs, false, false);
    let count = leaves.len();
    let mut named: BTreeMap<String, Tensor> = names.zip(gradients[..count].iter().map(Tensor::shallow_clone)).collect();
    named.insert("auxiliary.beliefs".into(), rows.scatter(&gradients[count]));
    named.insert("auxiliary.embeddings".into(), rows.scatter(&gradients[count + 1]));
    assert_probes(&named, &expected[&format!("{name}.gradients")], 1e-5);
}

/// Inverse dynamics and CPC|A as tensor operations against the script's loops, one question at a time.
#[test]
fn auxiliary_tasks_are_their_definitions() {
    let rows = Rows::new();
    let (embeddings, beliefs) = (rows.leaf("auxiliary.embeddings", 544), rows.leaf("auxiliary.beliefs", SIZES.hidden));
    let taken: Vec<i64> = rows.packing.rows.iter().map(|&(t, n)| ((3 * t + 5 * n + t * n) % 21) as i64).collect();
    let shape = RolloutShape { steps: STEPS, environments_in_last_step: COLUMNS - 1, frames: (CELLS - 1) as u64 };
    let zeros = |size: &[i64]| Tensor::zeros(size, (Kind::Float, Device::Cpu));
    let rollout = Rollout::new(
        shape,
        COLUMNS,
        Kept::of_frames(zeros(&[CELLS as i64, 1, 1])),
        zeros(&[COLUMNS as i64, SIZES.hidden]),
    );
    let pass = Pass {
        rollout: &rollout,
        packing: &rows.packing,
        embeddings: &embeddings,
        beliefs: &beliefs,
        actions: &Tensor::from_slice(&taken),
    };

    let mut layout = Layout::default();
    let inverse = InverseDynamics::new(&mut layout, SIZES, 1.0);
    let parameters = weights(layout);
    let asked = rows.queries(1);
    let answer = inverse.loss(&parameters, &pass, &asked, asked.len() as u64);
    check("inverse_dynamics", &rows, &pass, &parameters, asked.len(), answer);

    let mut layout = Layout::default();
    let cpca = Cpca::new(&mut layout, SIZES, 1.0);
    let parameters = weights(layout);
    let negatives = rows.negatives();
    let mut asked = rows.queries(16);
    for query in &mut asked {
        query.negative = negatives[query.later as usize];
    }
    let answer = cpca.loss(&parameters, &pass, &asked, asked.len() as u64);
    check("cpca16", &rows, &pass, &parameters, asked.len(), answer);
}
