//! The stem's kernels (`stem.cu`): convolution, norm, ReLU and pooling, forward and backward.

use super::map::{Affine, Statistics, address, has_channels_last, int, launch, map, optional, over_rows};
use crate::ffi::cuda::{Argument, CudaError, Kernel, Module};
use tch::{Kind, Tensor};

/// As in `stem.cu`.
const CHANNELS: i64 = 32;
const GROUPS: i64 = 16;
const TAPS: i64 = 128;
const CHUNK: i64 = 4;
const STRIDE: i64 = 40;
const FORWARD_THREADS: u32 = 7 * 32;
const BACKWARD_THREADS: u32 = 256;

/// Blocks of the backward pass, each of which adds up the weight's gradient over its frames: two for each of the 132
/// multiprocessors of an H100. The same number on every device, because it is part of the order of sums.
const BACKWARD_BLOCKS: i64 = 264;

/// The stem's kernels for frames of one side.
#[derive(Debug)]
pub struct StemKernels {
    forward: Kernel,
    backward: Kernel,
    side: i64,
}

#[derive(Debug, Clone, Copy)]
pub struct Stem<'a> {
    /// Weight of the convolution, bfloat16 \[32, 8, 4, 4\], channels last in memory.
    pub taps: &'a Tensor,
    /// The norm: 32 channels in 16 groups.
    pub norm: Affine<'a>,
    /// What the convolution sees of a kept number: number · scale + offset.
    pub scale_offset: [f32; 2],
}

#[derive(Debug)]
pub struct StemTape {
    /// The numbers that the pooling chose, before the norm: a feature map.
    raw: Tensor,
    /// Which pixel of its window each came from, u8 \[rows, side, side, 32\].
    winners: Tensor,
    statistics: Statistics,
}

#[derive(Debug)]
pub struct StemGradients {
    /// Of the convolution's weight, f32 \[32, 8, 4, 4\].
    pub taps: Tensor,
    /// Of bias and weight of the norm, f32 \[2, 32\].
    pub affine: Tensor,
}

impl StemKernels {
    pub(super) fn find(module: &Module, side: i64) -> Result<Self, CudaError> {
        let half = side / 2;
        let (padded, pooled, pixels) = (half + 3, half / 2, CHUNK * half);
        let rows_bytes = (CHUNK + 1) * half * STRIDE * 2;
        let windows = (CHUNK / 2 + 1) * pooled;
        // `StemGradients` of stem.cu.
        let gradients_bytes = (CHUNK + 3) * padded * 16
            + pixels * STRIDE * 2
            + pixels * STRIDE * 4
            + windows * STRIDE * 4
            + windows * CHANNELS
            + CHANNELS * (TAPS / 2 + 4) * 4
            + GROUPS * 4 * 4;
        let bytes =
            |count: i64| u32::try_from((count + 15) / 16 * 16).expect("frames have a few hundred pixels a side");
        Ok(Self {
            forward: module.kernel(c"stem_forward", bytes(rows_bytes))?,
            backward: module.kernel(c"stem_backward", bytes(gradients_bytes))?,
            side,
        })
    }
}

impl Stem<'_> {
    fn check(&self, kept: &Tensor, side: i64) {
        assert!(kept.kind() == Kind::Float && kept.is_contiguous() && kept.size()[1..] == [side, side], "float frames");
        assert!(self.taps.kind() == Kind::BFloat16 && self.taps.size() == [CHANNELS, 8, 4, 4], "a bfloat16 weight");
        assert!(has_channels_last(self.taps), "channels come last");
        self.norm.check(CHANNELS);
        assert_eq!(self.norm.groups, GROUPS);
    }
}

impl StemKernels {
    /// Kept frames f32 \[rows, side, side\] → `max_pool(relu(norm(convolution)))`, windows of 3 × 3, stride 2, padding
    /// 1: a feature map of 32 channels and a quarter of the side.
    pub fn forward(&self, kept: &Tensor, stem: Stem) -> (Tensor, StemTape) {
        stem.check(kept, self.side);
        let (rows, side) = (kept.size()[0], self.side / 4);
        let y = map(kept, [rows, CHANNELS, side, side]);
        let raw = map(kept, [rows, CHANNELS, side, side]);
        let winners = Tensor::empty([rows, side, side, CHANNELS], (Kind::Uint8, kept.device()));
        let statistics = Tensor::empty([rows, GROUPS, 2], (Kind::Float, kept.device()));
        let [scale, offset] = stem.scale_offset;
        launch(
            self.forward,
            rows,
            FORWARD_THREADS,
            &[
                address(kept),
                address(stem.taps),
                address(stem.norm.weight),
                address(stem.norm.bias),
                address(&y),
                address(&raw),
                address(&winners),
                address(&statistics),
                Argument::Float(scale),
                Argument::Float(offset),
            ],
        );
        (y, StemTape { raw, winners, statistics: Statistics(statistics) })
    }

    /// Gradients of [`StemKernels::forward`] for those of its output's users, one or two.
    pub fn backward(&self, dy: [Option<&Tensor>; 2], tape: &StemTape, kept: &Tensor, stem: Stem) -> StemGradients {
        stem.check(kept, self.side);
        let (rows, side) = (kept.size()[0], self.side / 4);
        let [first, second] = dy.map(|dy| optional(dy, [rows, CHANNELS, side, side]));
        assert!(dy[0].is_some(), "somebody uses the output");
        let blocks = rows.min(BACKWARD_BLOCKS);
        let float = (Kind::Float, kept.device());
        let taps = Tensor::empty([blocks, CHANNELS, 4, 4, 8], float);
        let affine = Tensor::empty([rows, 2, CHANNELS], float);
        let [scale, offset] = stem.scale_offset;
        launch(
            self.backward,
            blocks,
            BACKWARD_THREADS,
            &[
                first,
                second,
                address(&tape.winners),
                address(&tape.raw),
                address(&tape.statistics.0),
                address(kept),
                address(stem.taps),
                address(stem.norm.weight),
                address(&taps),
                address(&affine),
                Argument::Float(scale),
                Argument::Float(offset),
                int(rows),
            ],
        );
        StemGradients { taps: over_rows(&taps).permute([0, 3, 1, 2]), affine: over_rows(&affine) }
    }
}
