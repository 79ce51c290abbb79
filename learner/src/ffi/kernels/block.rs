//! The kernels of a basic block of the first stage (`block.cu`).

use super::map::{Affine, Statistics, address, has_channels_last, int, launch, map, optional, over_rows, shape};
use crate::ffi::cuda::{CudaError, Kernel, Module};
use tch::{Kind, Tensor};

/// As in `block.cu`.
const CHANNELS: i64 = 32;
const GROUPS: i64 = 16;
const WIDE: i64 = 28;
const WARPS: i64 = 12;

/// Blocks, each of which works on one map after another and adds up the weights' gradients over its maps: one for each
/// of the 132 multiprocessors of an H100. The same number on every device, because it is part of the order of sums.
const BLOCKS: i64 = 132;

/// Bytes of a map, and of `BlockRoom`.
const MAP_BYTES: i64 = WIDE * WIDE * CHANNELS * 2;
const ROOM_BYTES: i64 = 2 * CHANNELS * (9 * CHANNELS + 8) * 2 + 64 + (WARPS * CHANNELS * 2 + CHANNELS * 2) * 4;

#[derive(Debug)]
pub struct BlockKernels {
    forward: Kernel,
    backward: Kernel,
}

/// A basic block as the kernels take it: for both convolutions and their norms.
#[derive(Debug, Clone, Copy)]
pub struct Block<'a> {
    /// Weights, bfloat16 \[32, 32, 3, 3\], channels last in memory.
    pub weights: [&'a Tensor; 2],
    /// 32 channels in 16 groups.
    pub norms: [Affine<'a>; 2],
}

#[derive(Debug)]
pub struct BlockGradients {
    /// Of its input, a feature map.
    pub input: Tensor,
    /// Of the weights, f32 \[32, 32, 3, 3\].
    pub weights: [Tensor; 2],
    /// Of bias and weight of the norms, f32 \[2, 32\].
    pub affine: [Tensor; 2],
}

impl BlockKernels {
    pub(super) fn find(module: &Module) -> Result<Self, CudaError> {
        let bytes = |maps: i64| u32::try_from(maps * MAP_BYTES + ROOM_BYTES).expect("a few hundred kilobytes");
        Ok(Self {
            forward: module.kernel(c"block_forward", bytes(2))?,
            backward: module.kernel(c"block_backward", bytes(3))?,
        })
    }
}

impl Block<'_> {
    fn check(&self) {
        for weight in self.weights {
            assert!(weight.kind() == Kind::BFloat16 && weight.size() == [CHANNELS, CHANNELS, 3, 3]);
            assert!(has_channels_last(weight), "channels come last");
        }
        for norm in self.norms {
            norm.check(CHANNELS);
            assert_eq!(norm.groups, GROUPS);
        }
    }
}

impl BlockKernels {
    /// Whether they are for maps like this one.
    pub fn fit(x: &Tensor) -> bool {
        x.size()[1..] == [CHANNELS, WIDE, WIDE]
    }

    /// `relu(norm(convolution(relu(norm(convolution(x))))) + x)`, 3 × 3, of a map \[rows, 32, 28, 28\]. Panics if the
    /// map does not [fit](Self::fit).
    pub fn forward(&self, x: &Tensor, block: Block) -> (Tensor, Statistics) {
        block.check();
        let rows = shape(x)[0];
        let y = map(x, shape(x));
        let statistics = Tensor::empty([rows, 2, GROUPS, 2], (Kind::Float, x.device()));
        let [first, second] = block.norms;
        launch(
            self.forward,
            rows.min(BLOCKS),
            WARPS as u32 * 32,
            &[
                address(x),
                address(block.weights[0]),
                address(first.weight),
                address(first.bias),
                address(block.weights[1]),
                address(second.weight),
                address(second.bias),
                address(&y),
                address(&statistics),
                int(rows),
            ],
        );
        (y, Statistics(statistics))
    }

    /// Gradients of [`BlockKernels::forward`], `y` its output, for those of its output's users, one or two. Panics if
    /// the map does not [fit](Self::fit).
    pub fn backward(
        &self,
        dy: [Option<&Tensor>; 2],
        y: &Tensor,
        x: &Tensor,
        statistics: &Statistics,
        block: Block,
    ) -> BlockGradients {
        block.check();
        let rows = shape(x)[0];
        let [one, two] = dy.map(|dy| optional(dy, shape(x)));
        assert!(dy[0].is_some() && shape(y) == shape(x), "somebody uses the output");
        let (dx, blocks, float) = (map(x, shape(x)), rows.min(BLOCKS), (Kind::Float, x.device()));
        let weights = Tensor::empty([2, blocks, CHANNELS, 3, 3, CHANNELS], float);
        let affine = Tensor::empty([rows, 2, 2, CHANNELS], float);
        let [first, second] = block.norms;
        launch(
            self.backward,
            blocks,
            WARPS as u32 * 32,
            &[
                one,
                two,
                address(y),
                address(x),
                address(&statistics.0),
                address(block.weights[0]),
                address(first.weight),
                address(first.bias),
                address(block.weights[1]),
                address(second.weight),
                address(&dx),
                address(&weights),
                address(&affine),
                int(rows),
            ],
        );
        let affine = over_rows(&affine);
        // The kernel puts the second first.
        let weight = |which: i64| over_rows(&weights.get(which)).permute([0, 3, 1, 2]);
        BlockGradients { input: dx, weights: [weight(1), weight(0)], affine: [affine.get(0), affine.get(1)] }
    }
}
