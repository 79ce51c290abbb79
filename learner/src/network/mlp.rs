//! Layers with an activation behind each, and heads that may begin with some (`ppo.py` of `CleanRL`).

use super::initialize::Initial;
use super::layers::Linear;
use super::parameters::{Layout, Parameters};
use proto::config::{Activation, InitialWeights, NetworkConfig};
use std::f64::consts::SQRT_2;
use tch::Tensor;

/// A layer with the configured initial weights: orthogonal ones have this gain.
fn linear(layout: &mut Layout, path: &str, sizes: [i64; 2], initial: InitialWeights, gain: f64) -> Linear {
    match initial {
        InitialWeights::Orthogonal => {
            Linear::new(layout, path, sizes, Initial::Orthogonal { gain }, Initial::Constant(0.0))
        }
        InitialWeights::Uniform => Linear::with_default(layout, path, sizes),
    }
}

/// Any number of layers, each with an activation; of none what comes in comes out.
#[derive(Debug)]
pub struct Mlp {
    layers: Vec<Linear>,
    activation: Activation,
    /// Width of what comes out.
    outputs: i64,
}

impl Mlp {
    /// Declares layers of these widths. Every second entry of PyTorch's Sequential is an activation.
    pub fn new(layout: &mut Layout, path: &str, inputs: i64, widths: &[u32], config: &NetworkConfig) -> Self {
        let mut outputs = inputs;
        let layer = |(index, &width): (usize, &u32)| {
            let sizes = [outputs, i64::from(width)];
            outputs = sizes[1];
            linear(layout, &format!("{path}.{}", 2 * index), sizes, config.initial, SQRT_2)
        };
        Self { layers: widths.iter().enumerate().map(layer).collect(), activation: config.activation, outputs }
    }

    pub fn outputs(&self) -> i64 {
        self.outputs
    }

    /// \[rows, inputs\] → \[rows, outputs\].
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        let first = x.shallow_clone();
        let activate = match self.activation {
            Activation::Tanh => Tensor::tanh,
            Activation::Relu => Tensor::relu,
        };
        self.layers.iter().fold(first, |x, layer| activate(&layer.forward(parameters, &x)))
    }
}

/// Actor or critic.
#[derive(Debug)]
pub struct Head {
    own: Mlp,
    last: Linear,
}

impl Head {
    /// Declares a head with `outputs`. `widths`: of layers of its own before it.
    pub fn new(
        layout: &mut Layout,
        path: &str,
        [inputs, outputs]: [i64; 2],
        widths: &[u32],
        (config, gain): (&NetworkConfig, f64),
    ) -> Self {
        let own = Mlp::new(layout, path, inputs, widths, config);
        let path = if widths.is_empty() { path.to_owned() } else { format!("{path}.{}", 2 * widths.len()) };
        let last = linear(layout, &path, [own.outputs(), outputs], config.initial, gain);
        Self { own, last }
    }

    pub fn last(&self) -> Linear {
        self.last
    }

    /// \[rows, inputs\] → \[rows, outputs\].
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        self.last.forward(parameters, &self.own.forward(parameters, x))
    }
}
