//! What the kernels' Rust sides share: feature maps, norms, and launching.

use crate::ffi::cuda::{Argument, Kernel};
use tch::{Kind, Tensor};

/// Weight and bias of a group normalisation, f32 \[channels\].
#[derive(Debug, Clone, Copy)]
pub struct Affine<'a> {
    pub weight: &'a Tensor,
    pub bias: &'a Tensor,
    pub groups: i64,
}

/// What a norm's backward needs of its forward: means and reciprocal standard deviations, f32 \[rows, groups, 2\].
#[derive(Debug)]
pub struct Statistics(pub(super) Tensor);

impl Affine<'_> {
    pub(super) fn statistics(&self, x: &Tensor) -> Tensor {
        let [rows, channels, ..] = shape(x);
        self.check(channels);
        Tensor::empty([rows, self.groups, 2], (Kind::Float, x.device()))
    }

    pub(super) fn check(&self, channels: i64) {
        for tensor in [self.weight, self.bias] {
            assert!(tensor.kind() == Kind::Float && tensor.size() == [channels] && tensor.is_contiguous());
        }
        assert!([32, 64, 128, 256].contains(&channels) && channels % self.groups == 0, "{channels} channels");
    }
}

pub(super) fn map(like: &Tensor, [rows, channels, height, width]: [i64; 4]) -> Tensor {
    Tensor::empty([rows, height, width, channels], (Kind::BFloat16, like.device())).permute([0, 3, 1, 2])
}

/// The tensor, or a copy of it, with channels last in memory.
pub fn channels_last(x: Tensor) -> Tensor {
    if has_channels_last(&x) { x } else { x.permute([0, 2, 3, 1]).contiguous().permute([0, 3, 1, 2]) }
}

/// Told from the strides: asking libtorch would be an operation or two for every look.
pub(super) fn has_channels_last(x: &Tensor) -> bool {
    let (Ok((rows, channels, height, width)), Ok(strides)) = (x.size4(), x.stride4()) else { return false };
    let expected = (height * width * channels, 1, width * channels, channels);
    // The stride of a dimension of one is never used.
    let fits = |size: i64, stride: i64, expected: i64| size == 1 || stride == expected;
    fits(rows, strides.0, expected.0)
        && fits(channels, strides.1, expected.1)
        && fits(height, strides.2, expected.2)
        && fits(width, strides.3, expected.3)
}

/// Shape of a feature map. Panics if it is none: its layout is what the kernels rely on.
pub(super) fn shape(x: &Tensor) -> [i64; 4] {
    let (rows, channels, height, width) = x.size4().expect("feature maps have four dimensions");
    assert!(x.kind() == Kind::BFloat16 && has_channels_last(x), "a feature map");
    [rows, channels, height, width]
}

/// Shares of gradients, one a row or a block of threads → their sum.
pub(super) fn over_rows(shares: &Tensor) -> Tensor {
    shares.sum_dim_intlist([0i64].as_slice(), false, Kind::Float)
}

pub(super) fn address(tensor: &Tensor) -> Argument {
    Argument::Address(tensor.data_ptr() as u64)
}

pub(super) fn optional(map: Option<&Tensor>, expected: [i64; 4]) -> Argument {
    map.map_or(Argument::Address(0), |map| {
        assert_eq!(shape(map), expected, "a feature map of the same shape");
        address(map)
    })
}

pub(super) fn int(number: i64) -> Argument {
    Argument::Int(i32::try_from(number).expect("sides, channels and rows fit 32 bits"))
}

pub(super) fn launch(kernel: Kernel, blocks: i64, threads: u32, arguments: &[Argument]) {
    // SAFETY: each caller above gives its kernel's parameters in order; tensors have the kinds, sizes and layouts that
    // were asserted or allocated there, and they outlive the launch on libtorch's stream.
    let launched = unsafe { kernel.launch(blocks as usize, threads, arguments) };
    // As in tch: a device that fails in the middle of a pass ends the process.
    if let Err(error) = launched {
        panic!("{error}");
    }
}
