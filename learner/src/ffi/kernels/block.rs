//! The kernels of a basic block of the first stage (`block.cu`).

use super::{Affine, Kernels, Statistics, address, has_channels_last, int, launch, map, optional, over_rows, shape};
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
const ROOM_BYTES: i64 =
    2 * CHANNELS * (9 * CHANNELS + 8) * 2 + 64 + (WARPS * CHANNELS * 2 + CHANNELS * 2 + GROUPS * 2) * 4;

/// The kernels.
#[derive(Debug)]
pub(super) struct BlockKernels {
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

/// Gradients of a basic block.
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

impl Kernels {
    /// Whether there are kernels for whole blocks on maps like this one: they need the shared memory of an H100 or a
    /// later GPU.
    pub fn has_blocks_for(&self, x: &Tensor) -> bool {
        self.block.is_some() && x.size()[1..] == [CHANNELS, WIDE, WIDE]
    }

    /// `relu(norm(convolution(relu(norm(convolution(x))))) + x)`, 3 × 3, of a map \[rows, 32, 28, 28\].
    ///
    /// # Panics
    /// Without [`Kernels::has_blocks_for`].
    pub fn block_forward(&self, x: &Tensor, block: Block) -> (Tensor, Statistics) {
        block.check();
        let rows = shape(x)[0];
        let y = map(x, shape(x));
        let statistics = Tensor::empty([rows, 2, GROUPS, 2], (Kind::Float, x.device()));
        let [first, second] = block.norms;
        launch(
            self.block.as_ref().expect("there are kernels for blocks").forward,
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

    /// Gradients of [`Kernels::block_forward`], `y` its output, for those of its output's users, one or two.
    ///
    /// # Panics
    /// Without [`Kernels::has_blocks_for`].
    pub fn block_backward(
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
            self.block.as_ref().expect("there are kernels for blocks").backward,
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

/// Beside libtorch's float32 autograd on the same bfloat16 numbers; see the tests of the norms.
#[cfg(test)]
mod tests {
    use super::super::channels_last;
    use super::super::tests::{DEVICE, ROUNDING, assert_close, kernels, leaf, random_map};
    use super::*;

    #[test]
    #[ignore = "needs a CUDA device of compute capability 9.0"]
    fn kernels_of_whole_blocks() {
        let kernels = kernels(112);
        // More maps than blocks of threads, and fewer.
        for rows in [300, 5] {
            let size = [rows, CHANNELS, WIDE, WIDE];
            let x = channels_last(random_map(size).relu());
            let weights = [0, 1].map(|_| channels_last(random_map([CHANNELS, CHANNELS, 3, 3]) * 0.08));
            let float = (Kind::Float, DEVICE);
            let affine = [0, 1].map(|_| [Tensor::randn([CHANNELS], float) * 0.3 + 1.0, Tensor::randn([CHANNELS], float)]);
            let norms = [0, 1].map(|i: usize| Affine { weight: &affine[i][0], bias: &affine[i][1], groups: GROUPS });
            let block = Block { weights: [&weights[0], &weights[1]], norms };
            let [w1, w2] = [0, 1].map(|i: usize| leaf(&weights[i]));
            let [[g1, b1], [g2, b2]] = [0, 1].map(|i: usize| [leaf(&affine[i][0]), leaf(&affine[i][1])]);
            let input = leaf(&x);
            let convolve = |x: &Tensor, weight: &Tensor| x.conv2d(weight, None::<Tensor>, [1; 2], [1; 2], [1; 2], 1);
            let norm = |x: &Tensor, g: &Tensor, b: &Tensor| x.group_norm(GROUPS, Some(g), Some(b), 1e-5, true);
            let between = norm(&convolve(&input, &w1), &g1, &b1).relu();
            let between = &between + (between.to_kind(Kind::BFloat16).to_kind(Kind::Float) - &between).detach();
            let expected = (norm(&convolve(&between, &w2), &g2, &b2) + &input).relu();
            let (y, statistics) = kernels.block_forward(&x, block);
            assert_close(&y, &expected, ROUNDING);

            let dy = [random_map(size), random_map(size)];
            let loss = (&expected * (&dy[0] + &dy[1]).to_kind(Kind::Float)).sum(Kind::Float);
            let leaves = [&input, &w1, &w2, &g1, &b1, &g2, &b2];
            let gradients = Tensor::run_backward(&[loss], &leaves, false, false);
            let backward =
                || kernels.block_backward([Some(&dy[0]), Some(&dy[1])], &y, &x, &statistics, block);
            let ours = backward();
            assert_close(&ours.input, &gradients[0], 3.0 * ROUNDING);
            assert_close(&ours.weights[0], &gradients[1], 3.0 * ROUNDING);
            assert_close(&ours.weights[1], &gradients[2], 3.0 * ROUNDING);
            for (i, (weight, bias)) in [(3, 4), (5, 6)].into_iter().enumerate() {
                assert_close(&ours.affine[i].get(1), &gradients[weight], 3.0 * ROUNDING);
                assert_close(&ours.affine[i].get(0), &gradients[bias], 3.0 * ROUNDING);
            }
            let again = backward();
            assert_eq!((&again.input, &again.weights), (&ours.input, &ours.weights), "the same bits");
        }
    }
}
