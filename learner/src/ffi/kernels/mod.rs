//! The encoder's kernels (`*.cu` beside this file), each as a safe function over tensors.
//!
//! A feature map is a bfloat16 tensor \[rows, channels, height, width\] whose channels come last in memory.

mod acting;
mod block;
mod stem;

pub use acting::{CHOSEN_WORDS, Chosen};
pub use block::{Block, BlockGradients};
pub use stem::{Stem, StemGradients, StemTape};

use super::cuda::{Argument, CudaError, Kernel, Module};
use acting::ActingKernels;
use block::BlockKernels;
use proto::camera::FRAME_SIDE;
use stem::StemKernels;
use tch::{Kind, Tensor};

/// Threads of a block, one block a row: enough to hide memory's latency, few enough that several blocks share a
/// multiprocessor.
const NORM_THREADS: u32 = 256;

/// Weight and bias of a group normalisation, f32 \[channels\].
#[derive(Debug, Clone, Copy)]
pub struct Affine<'a> {
    pub weight: &'a Tensor,
    pub bias: &'a Tensor,
    pub groups: i64,
}

/// What a norm's backward needs of its forward: means and reciprocal standard deviations, f32 \[rows, groups, 2\].
#[derive(Debug)]
pub struct Statistics(Tensor);

/// Gradients of a norm.
#[derive(Debug)]
pub struct NormGradients {
    /// Of its input, a feature map.
    pub input: Tensor,
    /// Of bias and weight, f32 \[2, channels\].
    pub affine: Tensor,
}

/// The compiled kernels.
#[derive(Debug)]
pub struct Kernels {
    norm_forward: Kernel,
    norm_backward: Kernel,
    stem: StemKernels,
    acting: ActingKernels,
    /// None where a block of threads has too little shared memory.
    block: Option<BlockKernels>,
    /// Side of a kept frame, pixels.
    side: i64,
}

impl Kernels {
    /// Compiles them for the first CUDA device, where libtorch must have made a tensor before, and for frames of this
    /// side. Takes a second.
    pub fn compile(side: i64) -> Result<Self, CudaError> {
        let source = format!(
            "#define SIDE {side}\n#define POOL {}\n{}{}{}{}{}{}",
            FRAME_SIDE as i64 / side,
            include_str!("common.cu"),
            include_str!("matrix.cu"),
            include_str!("norm.cu"),
            include_str!("stem.cu"),
            include_str!("act.cu"),
            include_str!("block.cu")
        );
        let module = Module::compile(&source, "kernels.cu")?;
        Ok(Self {
            norm_forward: module.kernel(c"norm_forward", 0)?,
            norm_backward: module.kernel(c"norm_backward", 0)?,
            stem: StemKernels::find(&module, side)?,
            acting: ActingKernels::find(&module)?,
            block: BlockKernels::find(&module).ok(),
            side,
        })
    }

    /// `relu?(norm(x) + around?)`.
    pub fn norm_forward(&self, x: &Tensor, around: Option<&Tensor>, norm: Affine, relu: bool) -> (Tensor, Statistics) {
        let [rows, channels, height, width] = shape(x);
        let y = map(x, shape(x));
        let statistics = norm.statistics(x);
        launch(
            self.norm_forward,
            rows,
            NORM_THREADS,
            &[
                address(x),
                optional(around, shape(x)),
                address(norm.weight),
                address(norm.bias),
                address(&y),
                address(&statistics),
                int(height * width),
                int(channels),
                int(norm.groups),
                int(relu.into()),
            ],
        );
        (y, Statistics(statistics))
    }

    /// Gradients of [`Kernels::norm_forward`] for those of its output's users, one or two. `y` is the output where a
    /// ReLU made it. With `wants_around` also the gradient of `around`.
    pub fn norm_backward(
        &self,
        dy: [Option<&Tensor>; 2],
        y: Option<&Tensor>,
        x: &Tensor,
        statistics: &Statistics,
        norm: Affine,
        wants_around: bool,
    ) -> (NormGradients, Option<Tensor>) {
        let shape = shape(x);
        let [rows, channels, height, width] = shape;
        let dx = map(x, shape);
        let around = wants_around.then(|| map(x, shape));
        let affine = Tensor::empty([rows, 2, channels], (Kind::Float, x.device()));
        let [first, second] = dy.map(|dy| optional(dy, shape));
        assert!(dy[0].is_some(), "somebody uses the output");
        launch(
            self.norm_backward,
            rows,
            NORM_THREADS,
            &[
                first,
                second,
                optional(y, shape),
                address(x),
                address(&statistics.0),
                address(norm.weight),
                address(&dx),
                optional(around.as_ref(), shape),
                address(&affine),
                int(height * width),
                int(channels),
                int(norm.groups),
            ],
        );
        (NormGradients { input: dx, affine: over_rows(&affine) }, around)
    }
}

impl Affine<'_> {
    /// Room for a map's statistics.
    fn statistics(&self, x: &Tensor) -> Tensor {
        let [rows, channels, ..] = shape(x);
        self.check(channels);
        Tensor::empty([rows, self.groups, 2], (Kind::Float, x.device()))
    }

    fn check(&self, channels: i64) {
        for tensor in [self.weight, self.bias] {
            assert!(tensor.kind() == Kind::Float && tensor.size() == [channels] && tensor.is_contiguous());
        }
        assert!([32, 64, 128, 256].contains(&channels) && channels % self.groups == 0, "{channels} channels");
    }
}

/// An empty feature map on the same device.
fn map(like: &Tensor, [rows, channels, height, width]: [i64; 4]) -> Tensor {
    Tensor::empty([rows, height, width, channels], (Kind::BFloat16, like.device())).permute([0, 3, 1, 2])
}

/// The tensor, or a copy of it, with channels last in memory.
pub fn channels_last(x: Tensor) -> Tensor {
    if has_channels_last(&x) { x } else { x.permute([0, 2, 3, 1]).contiguous().permute([0, 3, 1, 2]) }
}

/// Told from the strides: asking libtorch would be an operation or two for every look.
fn has_channels_last(x: &Tensor) -> bool {
    let (Ok((rows, channels, height, width)), Ok(strides)) = (x.size4(), x.stride4()) else { return false };
    let expected = (height * width * channels, 1, width * channels, channels);
    // The stride of a dimension of one is never used.
    let fits = |size: i64, stride: i64, expected: i64| size == 1 || stride == expected;
    fits(rows, strides.0, expected.0)
        && fits(channels, strides.1, expected.1)
        && fits(height, strides.2, expected.2)
        && fits(width, strides.3, expected.3)
}

/// Shape of a feature map.
///
/// # Panics
/// If it is none: its layout is what the kernels rely on.
fn shape(x: &Tensor) -> [i64; 4] {
    let (rows, channels, height, width) = x.size4().expect("feature maps have four dimensions");
    assert!(x.kind() == Kind::BFloat16 && has_channels_last(x), "a feature map");
    [rows, channels, height, width]
}

/// Rows' shares of affine gradients → their sum.
fn over_rows(shares: &Tensor) -> Tensor {
    shares.sum_dim_intlist([0i64].as_slice(), false, Kind::Float)
}

fn address(tensor: &Tensor) -> Argument {
    Argument::Address(tensor.data_ptr() as u64)
}

fn optional(map: Option<&Tensor>, expected: [i64; 4]) -> Argument {
    map.map_or(Argument::Address(0), |map| {
        assert_eq!(shape(map), expected, "a feature map of the same shape");
        address(map)
    })
}

fn int(number: i64) -> Argument {
    Argument::Int(i32::try_from(number).expect("sides and channels are small"))
}

/// One block a row.
fn launch(kernel: Kernel, rows: i64, threads: u32, arguments: &[Argument]) {
    // SAFETY: each caller above gives its kernel's parameters in order; tensors have the kinds, sizes and layouts that
    // were asserted or allocated there, and they outlive the launch on libtorch's stream.
    let launched = unsafe { kernel.launch(rows as usize, threads, arguments) };
    // As in tch: a device that fails in the middle of a pass ends the process.
    if let Err(error) = launched {
        panic!("{error}");
    }
}

/// Each kernel beside libtorch's float32 autograd on the same bfloat16 numbers. They need a CUDA device:
/// `cargo nextest run --release --workspace --run-ignored only kernels`.
#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use tch::Device;

    pub const DEVICE: Device = Device::Cuda(0);
    /// A number rounded to bfloat16 is off by at most 2⁻⁹; the root mean square of that over many is less.
    pub const ROUNDING: f64 = 0.003;

    pub fn kernels(side: i64) -> Kernels {
        crate::device::load_cuda();
        tch::manual_seed(1);
        let _context = Tensor::zeros([1], (Kind::Float, DEVICE));
        Kernels::compile(side).unwrap()
    }

    pub fn random_map(size: [i64; 4]) -> Tensor {
        channels_last(Tensor::randn(size, (Kind::Float, DEVICE)).to_kind(Kind::BFloat16))
    }

    pub fn leaf(tensor: &Tensor) -> Tensor {
        tensor.to_kind(Kind::Float).detach().copy().set_requires_grad(true)
    }

    #[track_caller]
    pub fn assert_close(ours: &Tensor, theirs: &Tensor, tolerance: f64) {
        let (ours, theirs) = (ours.to_kind(Kind::Float), theirs.to_kind(Kind::Float));
        let error = (&ours - &theirs).norm().double_value(&[]) / theirs.norm().double_value(&[]);
        assert!(error < tolerance, "relative error {error}");
    }

    #[test]
    #[ignore = "needs a CUDA device"]
    fn kernels_of_the_norms() {
        let kernels = kernels(112);
        for (channels, side, groups) in [(32, 28, 16), (64, 14, 16), (128, 7, 16), (256, 4, 16), (128, 4, 1)] {
            let size = [5, channels, side, side];
            let (x, around) = (random_map(size) * 2.0 + 1.5, random_map(size));
            let x = channels_last(x);
            let weight = Tensor::randn([channels], (Kind::Float, DEVICE));
            let bias = weight.randn_like();
            let norm = Affine { weight: &weight, bias: &bias, groups };
            for (relu, around) in [(true, Some(&around)), (true, None), (false, None)] {
                let leaves = [&x, around.unwrap_or(&x), &weight, &bias].map(leaf);
                let mut expected = leaves[0].group_norm(groups, Some(&leaves[2]), Some(&leaves[3]), 1e-5, true);
                if around.is_some() {
                    expected += &leaves[1];
                }
                let expected = if relu { expected.relu() } else { expected };
                let (y, statistics) = kernels.norm_forward(&x, around, norm, relu);
                assert_close(&y, &expected, ROUNDING);

                let dy = [random_map(size), random_map(size)];
                let loss = (&expected * (&dy[0] + &dy[1]).to_kind(Kind::Float)).sum(Kind::Float);
                let gradients = Tensor::run_backward(&[loss], &leaves, false, false);
                let users = [Some(&dy[0]), Some(&dy[1])];
                let output = relu.then_some(&y);
                let (ours, d_around) = kernels.norm_backward(users, output, &x, &statistics, norm, around.is_some());
                // The sum of two users' gradients is rounded for libtorch and not for us.
                assert_close(&ours.input, &gradients[0], 2.0 * ROUNDING);
                assert_close(&ours.affine.get(1), &gradients[2], ROUNDING);
                assert_close(&ours.affine.get(0), &gradients[3], ROUNDING);
                if let Some(d_around) = d_around {
                    assert_close(&d_around, &gradients[1], 2.0 * ROUNDING);
                }
            }
        }
    }
}
