//! The layers that have weights: linear, convolution, group normalisation, recurrent units.

use super::initialize::Initial;
use super::parameters::{Layout, ParameterId, Parameters};
use crate::ffi::arithmetic::is_reproducible;
use crate::ffi::convolution::convolution;
use tch::{Device, Tensor};

/// `torch.nn.Linear`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Linear {
    pub(super) weight: ParameterId,
    pub(super) bias: ParameterId,
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

    /// \[rows, inputs\] → \[rows, outputs\], in the kind of numbers that the input has.
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        let [weight, bias] = [self.weight, self.bias].map(|id| parameters[id].to_kind(x.kind()));
        x.linear(&weight, Some(&bias))
    }
}

/// A square `torch.nn.Conv2d`.
#[derive(Debug, Clone, Copy)]
pub struct Convolution {
    pub(super) weight: ParameterId,
    bias: Option<ParameterId>,
    pub(super) stride: i64,
    pub(super) padding: i64,
    as_products: bool,
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
            as_products: false,
        }
    }

    /// Declares one without padding, whose weight and bias start as they are said to.
    pub fn without_padding(
        layout: &mut Layout,
        path: &str,
        [inputs, outputs]: [i64; 2],
        [size, stride]: [i64; 2],
        [weight, bias]: [Initial; 2],
    ) -> Self {
        Self {
            weight: layout.add(format!("{path}.weight"), &[outputs, inputs, size, size], weight),
            bias: Some(layout.add(format!("{path}.bias"), &[outputs], bias)),
            stride,
            padding: 0,
            as_products: false,
        }
    }

    /// Computed as products of matrices on a CPU (`ffi/patches.cpp`). Where a map has few channels and windows are
    /// large that takes half of oneDNN's time; elsewhere oneDNN is quicker, and as reproducible.
    #[must_use]
    pub fn as_products(self) -> Self {
        Self { as_products: true, ..self }
    }

    /// \[rows, inputs, height, width\] → \[rows, outputs, height', width'\], in the kind of numbers that the input has.
    pub fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        let of = |id| parameters[id].to_kind(x.kind());
        let (weight, bias) = (of(self.weight), self.bias.map(of));
        if self.as_products && x.device() == Device::Cpu && is_reproducible() {
            return convolution(x, &weight, bias.as_ref(), [self.stride, self.padding])
                .expect("the layer was declared for maps of this many channels");
        }
        x.conv2d(&weight, bias.as_ref(), [self.stride; 2], [self.padding; 2], [1; 2], 1)
    }
}

/// `torch.nn.GroupNorm`, ε = 1e-5.
#[derive(Debug, Clone, Copy)]
pub struct GroupNorm {
    pub(super) weight: ParameterId,
    pub(super) bias: ParameterId,
    pub(super) groups: i64,
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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    Gru,
    Lstm,
}

/// A one-layer `torch.nn.GRU` or `torch.nn.LSTM`. Its state is the output, and of an LSTM the cell behind it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Recurrent {
    unit: Unit,
    /// Gates stacked, r, z, n or i, f, g, o: \[gates·hidden, inputs\], \[gates·hidden, hidden\], \[gates·hidden\],
    /// \[gates·hidden\], in the order that cuDNN wants them in memory.
    weights: [ParameterId; 4],
    hidden: i64,
}

impl Recurrent {
    /// Declares `path.weight_ih_l0`, `path.weight_hh_l0`, `path.bias_ih_l0`, `path.bias_hh_l0`.
    pub fn new(
        layout: &mut Layout,
        path: &str,
        unit: Unit,
        [inputs, hidden]: [i64; 2],
        [weight, bias]: [Initial; 2],
    ) -> Self {
        let gates = match unit {
            Unit::Gru => 3,
            Unit::Lstm => 4,
        };
        let rows = gates * hidden;
        let weights = [
            layout.add(format!("{path}.weight_ih_l0"), &[rows, inputs], weight),
            layout.add(format!("{path}.weight_hh_l0"), &[rows, hidden], weight),
            layout.add(format!("{path}.bias_ih_l0"), &[rows], bias),
            layout.add(format!("{path}.bias_hh_l0"), &[rows], bias),
        ];
        Self { unit, weights, hidden }
    }

    /// A GRU as PyTorch initialises it by default.
    pub fn gru_with_default(layout: &mut Layout, path: &str, [inputs, hidden]: [i64; 2]) -> Self {
        Self::new(layout, path, Unit::Gru, [inputs, hidden], [Initial::linear_default(hidden); 2])
    }

    /// Width of its output.
    pub fn hidden(&self) -> i64 {
        self.hidden
    }

    /// Width of its state.
    pub fn state(&self) -> i64 {
        match self.unit {
            Unit::Gru => self.hidden,
            Unit::Lstm => 2 * self.hidden,
        }
    }

    /// The output in states \[rows, state\].
    pub fn output(&self, states: &Tensor) -> Tensor {
        match self.unit {
            Unit::Gru => states.shallow_clone(),
            Unit::Lstm => states.narrow(1, 0, self.hidden),
        }
    }

    /// One step: \[rows, inputs\] and states before it \[rows, state\] → states after it.
    pub fn step(&self, parameters: &Parameters, x: &Tensor, before: &Tensor) -> Tensor {
        let [weight_input, weight_hidden, bias_input, bias_hidden] = self.weights.map(|id| &parameters[id]);
        match self.unit {
            Unit::Gru => x.gru_cell(before, weight_input, weight_hidden, Some(bias_input), Some(bias_hidden)),
            Unit::Lstm => {
                let [output, cell] = &self.output_and_cell(before);
                let (output, cell) =
                    x.lstm_cell(&[output, cell], weight_input, weight_hidden, Some(bias_input), Some(bias_hidden));
                Tensor::cat(&[output, cell], 1)
            }
        }
    }

    /// Both of an LSTM's states, each \[rows, hidden\].
    fn output_and_cell(&self, states: &Tensor) -> [Tensor; 2] {
        [0, self.hidden].map(|begin| states.narrow(1, begin, self.hidden).contiguous())
    }

    /// What the gates of a step get from inputs \[rows, inputs\], without their biases: \[rows, gates · hidden\],
    /// reset, update, candidate, or of an LSTM input, forget, cell, output.
    pub fn input_gates(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        x.matmul(&parameters[self.weights[0]].tr())
    }

    /// The same from states before it \[rows, state\].
    pub fn state_gates(&self, parameters: &Parameters, before: &Tensor) -> Tensor {
        self.output(before).matmul(&parameters[self.weights[1]].tr())
    }

    /// The gates' biases: beside [`Recurrent::input_gates`] and [`Recurrent::state_gates`].
    pub fn biases<'a>(&self, parameters: &'a Parameters) -> [&'a Tensor; 2] {
        [self.weights[2], self.weights[3]].map(|id| &parameters[id])
    }

    /// Sequences of one length through a GRU: \[steps, rows, inputs\] and states before them \[rows, hidden\] → states
    /// after each step \[steps, rows, hidden\].
    pub fn sequence(&self, parameters: &Parameters, x: &Tensor, before: &Tensor) -> Tensor {
        assert_eq!(self.unit, Unit::Gru, "an LSTM has a cell, too");
        let weights = self.weights.map(|id| &parameters[id]);
        let (states, _) = x.gru(&before.unsqueeze(0), &weights, true, 1, 0.0, true, false, false);
        states
    }

    /// Sequences of different lengths as a packed sequence: rows \[rows, inputs\], `batch_sizes[k]` of which are k-th
    /// steps, and states before them \[sequences, state\] → outputs \[rows, hidden\].
    pub(crate) fn packed(&self, parameters: &Parameters, x: &Tensor, batch_sizes: &[i64], before: &Tensor) -> Tensor {
        let weights = self.weights.map(|id| &parameters[id]);
        let batch_sizes = Tensor::from_slice(batch_sizes);
        match self.unit {
            Unit::Gru => Tensor::gru_data(x, &batch_sizes, &before.unsqueeze(0), &weights, true, 1, 0.0, true, false).0,
            Unit::Lstm => {
                let [output, cell] = &self.output_and_cell(before).map(|state| state.unsqueeze(0));
                Tensor::lstm_data(x, &batch_sizes, &[output, cell], &weights, true, 1, 0.0, true, false).0
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::{Device, Kind};

    /// As the kernel of acting puts it together.
    #[test]
    fn a_unit_in_parts_takes_pytorchs_step() {
        for unit in [Unit::Gru, Unit::Lstm] {
            let mut layout = Layout::default();
            let initial = [Initial::Uniform { bound: 0.5 }; 2];
            let recurrent = Recurrent::new(&mut layout, "unit", unit, [7, 5], initial);
            let parameters = Parameters::new(layout, 1, Device::Cpu);
            let random = |width: i64| Tensor::randn([3, width], (Kind::Float, Device::Cpu));
            let (x, before) = (random(7), random(recurrent.state()));
            let [input_bias, before_bias] = recurrent.biases(&parameters);
            let from_input = recurrent.input_gates(&parameters, &x) + input_bias;
            let from_before = recurrent.state_gates(&parameters, &before) + before_bias;
            let part = |of: &Tensor, index: i64| of.narrow(1, 5 * index, 5);
            let gate = |index: i64| part(&from_input, index) + part(&from_before, index);
            let after = match unit {
                Unit::Gru => {
                    let [reset, update] = [0, 1].map(|index| gate(index).sigmoid());
                    let candidate = (part(&from_input, 2) + reset * part(&from_before, 2)).tanh();
                    &candidate + update * (&before - &candidate)
                }
                Unit::Lstm => {
                    let [input, forget, output] = [0, 1, 3].map(|index| gate(index).sigmoid());
                    let cell = forget * part(&before, 1) + input * gate(2).tanh();
                    Tensor::cat(&[output * cell.tanh(), cell], 1)
                }
            };
            assert!(after.allclose(&recurrent.step(&parameters, &x, &before), 1e-5, 1e-6, false), "{unit:?}");
        }
    }
}
