//! Layers with hyperbolic tangents behind them, and heads that may begin with some (`ppo.py` of `CleanRL`).

use super::initialize::Initial;
use super::layers::Linear;
use super::parameters::{Layout, Parameters};
use std::f64::consts::SQRT_2;
use tch::Tensor;

/// Any number of layers, each with a hyperbolic tangent; of none what comes in comes out.
#[derive(Debug)]
pub struct Mlp {
    layers: Vec<Linear>,
    /// Width of what comes out.
    outputs: i64,
}

impl Mlp {
    /// Declares layers of these widths: orthogonal with gain √2, zero biases. Every second entry of PyTorch's Sequential
    /// is a tangent.
    pub fn new(layout: &mut Layout, path: &str, inputs: i64, widths: &[u32]) -> Self {
        let mut outputs = inputs;
        let layer = |(index, &width): (usize, &u32)| {
            let sizes = [outputs, i64::from(width)];
            outputs = sizes[1];
            let weight = Initial::Orthogonal { gain: SQRT_2 };
            Linear::new(layout, &format!("{path}.{}", 2 * index), sizes, weight, Initial::Constant(0.0))
        };
        Self { layers: widths.iter().enumerate().map(layer).collect(), outputs }
    }

    pub fn outputs(&self) -> i64 {
        self.outputs
    }

    /// \[rows, inputs\] → \[rows, outputs\].
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        let first = x.shallow_clone();
        self.layers.iter().fold(first, |x, layer| layer.forward(parameters, &x).tanh())
    }
}

/// Actor or critic.
#[derive(Debug)]
pub struct Head {
    own: Mlp,
    last: Linear,
}

impl Head {
    /// Declares a head with `outputs`: orthogonal with this gain, zero bias. `widths`: of layers of its own before it.
    pub fn new(layout: &mut Layout, path: &str, [inputs, outputs]: [i64; 2], widths: &[u32], gain: f64) -> Self {
        let own = Mlp::new(layout, path, inputs, widths);
        let path = if widths.is_empty() { path.to_owned() } else { format!("{path}.{}", 2 * widths.len()) };
        let weight = Initial::Orthogonal { gain };
        let last = Linear::new(layout, &path, [own.outputs(), outputs], weight, Initial::Constant(0.0));
        Self { own, last }
    }

    /// Its last layer.
    pub fn last(&self) -> Linear {
        self.last
    }

    /// \[rows, inputs\] → \[rows, outputs\].
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        self.last.forward(parameters, &self.own.forward(parameters, x))
    }
}
