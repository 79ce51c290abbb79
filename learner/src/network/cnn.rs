//! The original baseline's encoder: three convolutions without padding (`docs/method.md`, Network). No rectifier
//! follows the third, as in the reference.

use super::layers::{Convolution, Linear};
use super::parameters::{Layout, Parameters};
use super::visual_linear;
use tch::Tensor;

/// (outputs, size, stride) of each convolution.
const CONVOLUTIONS: [(i64, i64, i64); 3] = [(32, 8, 4), (64, 4, 2), (32, 3, 1)];

/// The encoder.
#[derive(Debug)]
pub struct Cnn {
    convolutions: Vec<Convolution>,
    linear: Linear,
}

impl Cnn {
    /// Declares the encoder for square frames of this side, pixels.
    pub fn new(layout: &mut Layout, path: &str, mut side: i64) -> Self {
        let mut channels = 1;
        let mut convolutions = vec![];
        for (index, (outputs, size, stride)) in CONVOLUTIONS.into_iter().enumerate() {
            // Every second entry of PyTorch's Sequential is a rectifier.
            let path = format!("{path}.cnn.{}", 2 * index);
            convolutions
                .push(Convolution::new(layout, &path, [channels, outputs], size, [stride, 0], true).as_products());
            channels = outputs;
            side = (side - size) / stride + 1;
        }
        // After the third convolution: flatten, linear, rectifier.
        Self { convolutions, linear: visual_linear(layout, &format!("{path}.cnn.6"), channels * side * side) }
    }

    /// \[rows, 1, side, side\] → \[rows, 512\].
    pub fn forward(&self, parameters: &Parameters, frames: &Tensor) -> Tensor {
        let mut x = self.convolutions[0].forward(parameters, frames).relu_();
        x = self.convolutions[1].forward(parameters, &x).relu_();
        x = self.convolutions[2].forward(parameters, &x);
        self.linear.forward(parameters, &x.flatten(1, -1)).relu_()
    }
}
