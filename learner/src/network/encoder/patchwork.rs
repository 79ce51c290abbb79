//! The example of docs/own-parts.md, which only tests compile: an encoder that sees a frame as squares of eight by
//! eight pixels, each of them through the same weights.

use super::visual::{PATH, VisualEncoder, visual_linear};
use crate::network::layers::{Convolution, Linear};
use crate::network::parameters::{Layout, Parameters};
use tch::Tensor;

/// Path of the linear layer: no other encoder may have a weight of this name.
const LINEAR: &str = "visual_encoder.patchwork.linear";

/// Side of a square, pixels, and numbers that are made of it.
const SQUARE: i64 = 8;
const CHANNELS: i64 = 16;

#[derive(Debug)]
pub(crate) struct Patchwork {
    squares: Convolution,
    linear: Linear,
}

/// Inputs of the linear layer for square frames of this side, pixels.
pub(crate) fn features(side: i64) -> i64 {
    CHANNELS * (side / SQUARE) * (side / SQUARE)
}

impl Patchwork {
    /// Declares both layers for square frames of this side, pixels.
    pub(crate) fn new(layout: &mut Layout, side: i64) -> Self {
        let path = format!("{PATH}.patchwork.squares");
        let squares = Convolution::new(layout, &path, [1, CHANNELS], SQUARE, [SQUARE, 0], true).as_products();
        Self { squares, linear: visual_linear(layout, LINEAR, features(side)) }
    }
}

impl VisualEncoder for Patchwork {
    fn forward(&self, parameters: &Parameters, frames: &Tensor) -> Tensor {
        let squares = self.squares.forward(parameters, frames).relu();
        self.linear.forward(parameters, &squares.flatten(1, -1)).relu()
    }
}

#[cfg(test)]
mod tests {
    use super::super::visual::VISUAL;
    use super::*;
    use tch::{Device, Kind};

    #[test]
    fn a_frame_becomes_an_embedding_that_depends_on_every_pixel() {
        for side in [224, 112, 56] {
            let mut layout = Layout::default();
            let encoder = Patchwork::new(&mut layout, side);
            let parameters = Parameters::new(layout, 1, Device::Cpu);
            assert!(parameters.named().all(|(name, _)| name.starts_with(PATH)));
            let frames = Tensor::ones([2, 1, side, side], (Kind::Float, Device::Cpu)).set_requires_grad(true);
            let embedding = encoder.forward(&parameters, &frames);
            assert_eq!(embedding.size(), [2, VISUAL]);
            let gradient = Tensor::run_backward(&[embedding.sum(Kind::Float)], &[&frames], false, false).remove(0);
            assert_eq!(gradient.ne(0.0).sum(Kind::Int64).int64_value(&[]), 2 * side * side);
        }
    }
}
