//! The three layers that have weights: linear, convolution, group normalisation.

use super::initialize::Initial;
use super::parameters::{Layout, ParameterId, Parameters};
use tch::Tensor;

/// `torch.nn.Linear`.
#[derive(Debug, Clone, Copy)]
pub struct Linear {
    weight: ParameterId,
    bias: ParameterId,
}

impl Linear {
    /// Declares `path.weight` \[outputs, inputs\] and `path.bias` \[outputs\].
    pub fn new(layout: &mut Layout, path: &str, [inputs, outputs]: [i64; 2], weight: Initial, bias: Initial) -> Self {
        Self {
            weight: layout.add(format!("{path}.weight"), &[outputs, inputs], weight),
            bias: layout.add(format!("{path}.bias"), &[outputs], bias),
        }
    }

    /// As PyTorch initialises it by default.
    pub fn with_default(layout: &mut Layout, path: &str, [inputs, outputs]: [i64; 2]) -> Self {
        let initial = Initial::linear_default(inputs);
        Self::new(layout, path, [inputs, outputs], initial, initial)
    }

    /// \[rows, inputs\] → \[rows, outputs\].
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        x.linear(&parameters[self.weight], Some(&parameters[self.bias]))
    }
}

/// A square `torch.nn.Conv2d`.
#[derive(Debug, Clone, Copy)]
pub struct Convolution {
    weight: ParameterId,
    bias: Option<ParameterId>,
    stride: i64,
    padding: i64,
}

impl Convolution {
    /// Declares `path.weight` \[outputs, inputs, size, size\], Kaiming normal, and a zero `path.bias` if wanted.
    pub fn new(
        layout: &mut Layout,
        path: &str,
        [inputs, outputs]: [i64; 2],
        size: i64,
        [stride, padding]: [i64; 2],
        bias: bool,
    ) -> Self {
        let initial = Initial::kaiming_normal(inputs * size * size);
        Self {
            weight: layout.add(format!("{path}.weight"), &[outputs, inputs, size, size], initial),
            bias: bias.then(|| layout.add(format!("{path}.bias"), &[outputs], Initial::Constant(0.0))),
            stride,
            padding,
        }
    }

    /// \[rows, inputs, height, width\] → \[rows, outputs, height', width'\].
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        let bias = self.bias.map(|id| &parameters[id]);
        x.conv2d(&parameters[self.weight], bias, [self.stride; 2], [self.padding; 2], [1; 2], 1)
    }
}

/// `torch.nn.GroupNorm`, ε = 1e-5.
#[derive(Debug, Clone, Copy)]
pub struct GroupNorm {
    weight: ParameterId,
    bias: ParameterId,
    groups: i64,
}

impl GroupNorm {
    /// Declares `path.weight` = 1 and `path.bias` = 0.
    pub fn new(layout: &mut Layout, path: &str, groups: i64, channels: i64) -> Self {
        Self {
            weight: layout.add(format!("{path}.weight"), &[channels], Initial::Constant(1.0)),
            bias: layout.add(format!("{path}.bias"), &[channels], Initial::Constant(0.0)),
            groups,
        }
    }

    /// Shape is kept.
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        x.group_norm(self.groups, Some(&parameters[self.weight]), Some(&parameters[self.bias]), 1e-5, true)
    }
}
