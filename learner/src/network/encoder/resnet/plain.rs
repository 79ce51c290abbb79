//! The paper's encoder: `ResNet18` with group normalisation, base 32 planes (`docs/method.md`, Network).
//!
//! Sizes for the paper's 112 × 112 input: 56 after the first convolution, 28 after the pooling, then 28, 14, 7 and 4
//! after the four stages; compression keeps 4 × 4 × 128 = 2048 numbers.

use super::super::visual::{VISUAL, visual_linear};
use crate::network::layers::{Convolution, GroupNorm, Linear};
use crate::network::parameters::{Layout, Parameters};
use tch::Tensor;

pub(super) const BASE: i64 = 32;
const GROUPS: i64 = 16;
pub(super) const COMPRESSED: i64 = 128;
/// Path of the linear layer.
pub(super) const LINEAR: &str = "visual_encoder.fc.1";

#[derive(Debug)]
pub(super) struct Block {
    pub(super) first: (Convolution, GroupNorm),
    pub(super) second: (Convolution, GroupNorm),
    pub(super) projection: Option<(Convolution, GroupNorm)>,
}

impl Block {
    fn new(layout: &mut Layout, path: &str, [inputs, outputs]: [i64; 2], stride: i64) -> Self {
        let mut convolution = |path: String, [inputs, outputs]: [i64; 2], size: i64, stride: i64, index: usize| {
            let padding = size / 2;
            (
                Convolution::new(layout, &format!("{path}.{index}"), [inputs, outputs], size, [stride, padding], false),
                GroupNorm::new(layout, &format!("{path}.{}", index + 1), GROUPS, outputs),
            )
        };
        // Indices as in PyTorch's Sequential(conv, norm, relu, conv, norm).
        let first = convolution(format!("{path}.convs"), [inputs, outputs], 3, stride, 0);
        let second = convolution(format!("{path}.convs"), [outputs, outputs], 3, 1, 3);
        let projection = (stride != 1 || inputs != outputs)
            .then(|| convolution(format!("{path}.downsample"), [inputs, outputs], 1, stride, 0));
        Self { first, second, projection }
    }

    fn forward(&self, parameters: &Parameters, x: &Tensor) -> Tensor {
        let through = apply(parameters, self.first, x).relu_();
        let mut through = apply(parameters, self.second, &through);
        match self.projection {
            Some(projection) => through.g_add_(&apply(parameters, projection, x)),
            None => through.g_add_(x),
        }
        .relu_()
    }
}

fn apply(parameters: &Parameters, (convolution, norm): (Convolution, GroupNorm), x: &Tensor) -> Tensor {
    norm.forward(parameters, &convolution.forward(parameters, x))
}

#[derive(Debug)]
pub(super) struct Resnet {
    pub(super) stem: (Convolution, GroupNorm),
    pub(super) blocks: Vec<Block>,
    pub(super) compression: (Convolution, GroupNorm),
    pub(super) linear: Linear,
}

impl Resnet {
    /// Declares the encoder for square frames of this side, pixels.
    pub(super) fn new(layout: &mut Layout, path: &str, side: i64) -> Self {
        let backbone = format!("{path}.backbone");
        let stem = (
            Convolution::new(layout, &format!("{backbone}.conv1.0"), [1, BASE], 7, [2, 3], false),
            GroupNorm::new(layout, &format!("{backbone}.conv1.1"), GROUPS, BASE),
        );
        let mut blocks = vec![];
        let mut channels = BASE;
        for stage in 0..4i64 {
            let planes = BASE << stage;
            for index in 0..2 {
                let stride = if stage > 0 && index == 0 { 2 } else { 1 };
                let path = format!("{backbone}.layer{}.{index}", stage + 1);
                blocks.push(Block::new(layout, &path, [channels, planes], stride));
                channels = planes;
            }
        }
        let compression = (
            Convolution::new(layout, &format!("{path}.compression.0"), [channels, COMPRESSED], 3, [1, 1], false),
            GroupNorm::new(layout, &format!("{path}.compression.1"), 1, COMPRESSED),
        );
        let linear = visual_linear(layout, LINEAR, features(side));
        Self { stem, blocks, compression, linear }
    }

    /// \[rows, 1, side, side\] → \[rows, 512\].
    pub(super) fn forward(&self, parameters: &Parameters, frames: &Tensor) -> Tensor {
        let x = apply(parameters, self.stem, frames).relu_();
        let mut x = x.max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false);
        for block in &self.blocks {
            x = block.forward(parameters, &x);
        }
        let x = apply(parameters, self.compression, &x).relu_();
        let x = self.linear.forward(parameters, &x.flatten(1, -1)).relu_();
        debug_assert_eq!(x.size()[1], VISUAL);
        x
    }
}

/// Numbers that the convolutions leave of a square frame. The stem's convolution and pooling and the first block of the
/// last three stages each halve the side, rounding up.
pub(super) fn features(side: i64) -> i64 {
    let side = (0..5).fold(side, |side, _| (side + 1) / 2);
    COMPRESSED * side * side
}
