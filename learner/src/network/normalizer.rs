//! Numbers less their mean, divided by their deviation, then clipped: `NormalizeObservation` of Gymnasium. Mean and
//! variance lie among the weights, under the names of PyTorch's running statistics; no loss has a gradient there.

use super::initialize::Initial;
use super::parameters::{Layout, ParameterId, Parameters};
use tch::Tensor;

/// Beside a variance of which the root is taken (Gymnasium).
pub(crate) const EPSILON: f64 = 1e-8;
/// What the names begin with.
const PATH: &str = "observation_norm";

#[derive(Debug)]
pub struct Normalizer {
    mean: ParameterId,
    variance: ParameterId,
    clip: f64,
}

impl Normalizer {
    /// Declares mean 0 and variance 1 of so many numbers.
    pub fn new(layout: &mut Layout, numbers: i64, clip: f64) -> Self {
        let mut add = |name: &str, value| layout.add(format!("{PATH}.{name}"), &[numbers], Initial::Constant(value));
        Self { mean: add("running_mean", 0.0), variance: add("running_var", 1.0), clip }
    }

    /// \[rows, numbers\] → the same.
    pub fn forward(&self, parameters: &Parameters, numbers: &Tensor) -> Tensor {
        let [mean, variance] = [self.mean, self.variance].map(|id| parameters[id].detach());
        ((numbers - mean) / (variance + EPSILON).sqrt()).clamp(-self.clip, self.clip)
    }

    pub fn set(&self, parameters: &Parameters, known: &[[f32; 2]]) {
        for (which, id) in [self.mean, self.variance].into_iter().enumerate() {
            let values: Vec<f32> = known.iter().map(|both| both[which]).collect();
            tch::no_grad(|| parameters[id].detach().copy_(&Tensor::from_slice(&values)));
        }
    }
}

/// Whether weights of these names have such statistics.
pub(crate) fn is_among<'a>(mut names: impl Iterator<Item = &'a String>) -> bool {
    names.any(|name| name.starts_with(PATH))
}
