//! The encoder's kernels (`kernels.cu`), each as a safe function over tensors.
//!
//! A feature map is a bfloat16 tensor \[rows, channels, height, width\] whose channels come last in memory.

use super::cuda::{Argument, CudaError, Kernel, Module};
use tch::{Kind, Tensor};

/// Threads of a block, one block a row: enough to hide memory's latency, few enough that several blocks share a
/// multiprocessor. The stem's maps are the largest.
const NORM_THREADS: u32 = 256;
const STEM_THREADS: u32 = 512;

/// Pixels that the stem's input has more than half the frame's side: the border of a 4 × 4 window, two before and one
/// behind.
const STEM_BORDER: i64 = 3;

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

/// Which pixel of its window each number of the stem's output came from, u8 \[rows, side, side, channels\].
#[derive(Debug)]
pub struct Winners(Tensor);

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
    stem_input: Kernel,
    stem_forward: Kernel,
    stem_backward: Kernel,
}

impl Kernels {
    /// Compiles them for the first CUDA device, where libtorch must have made a tensor before. Takes a second.
    pub fn compile() -> Result<Self, CudaError> {
        let module = Module::compile(include_str!("kernels.cu"), "kernels.cu")?;
        Ok(Self {
            norm_forward: module.kernel(c"norm_forward")?,
            norm_backward: module.kernel(c"norm_backward")?,
            stem_input: module.kernel(c"stem_input")?,
            stem_forward: module.kernel(c"stem_forward")?,
            stem_backward: module.kernel(c"stem_backward")?,
        })
    }

    /// Kept frames f32 \[rows, side, side\] → what the stem's convolution sees: \[rows, 8, side / 2 + 3, side / 2 +
    /// 3\], numbers multiplied by `scale` and moved by `offset` on the way.
    pub fn stem_input(&self, kept: &Tensor, scale: f32, offset: f32) -> Tensor {
        let (rows, side, _) = kept.size3().expect("frames have three dimensions");
        assert!(kept.kind() == Kind::Float && kept.is_contiguous() && side % 2 == 0, "float frames of an even side");
        let y = map(kept, [rows, 8, side / 2 + STEM_BORDER, side / 2 + STEM_BORDER]);
        launch(
            self.stem_input,
            rows,
            STEM_THREADS,
            &[address(kept), address(&y), int(side), Argument::Float(scale), Argument::Float(offset)],
        );
        y
    }

    /// `max_pool(relu(norm(x)))`, windows of 3 × 3, stride 2, padding 1.
    pub fn stem_forward(&self, x: &Tensor, norm: Affine) -> (Tensor, Winners, Statistics) {
        let [rows, channels, side, _] = shape(x);
        let half = (side + 1) / 2;
        let y = map(x, [rows, channels, half, half]);
        let winners = Tensor::empty([rows, half, half, channels], (Kind::Uint8, x.device()));
        let statistics = norm.statistics(x);
        launch(
            self.stem_forward,
            rows,
            STEM_THREADS,
            &[
                address(x),
                address(norm.weight),
                address(norm.bias),
                address(&y),
                address(&winners),
                address(&statistics),
                int(side),
                int(channels),
                int(norm.groups),
            ],
        );
        (y, Winners(winners), Statistics(statistics))
    }

    /// Gradients of [`Kernels::stem_forward`] for those of its output's users, one or two.
    pub fn stem_backward(
        &self,
        dy: [Option<&Tensor>; 2],
        winners: &Winners,
        x: &Tensor,
        statistics: &Statistics,
        norm: Affine,
    ) -> NormGradients {
        let [rows, channels, side, _] = shape(x);
        let dx = map(x, shape(x));
        let affine = Tensor::empty([rows, 2, channels], (Kind::Float, x.device()));
        let half = (side + 1) / 2;
        let [first, second] = dy.map(|dy| optional(dy, [rows, channels, half, half]));
        assert!(dy[0].is_some(), "somebody uses the output");
        launch(
            self.stem_backward,
            rows,
            STEM_THREADS,
            &[
                first,
                second,
                address(&winners.0),
                address(x),
                address(&statistics.0),
                address(norm.weight),
                address(&dx),
                address(&affine),
                int(side),
                int(channels),
                int(norm.groups),
            ],
        );
        NormGradients { input: dx, affine: over_rows(&affine) }
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
        for tensor in [self.weight, self.bias] {
            assert!(tensor.kind() == Kind::Float && tensor.size() == [channels] && tensor.is_contiguous());
        }
        assert!([32, 64, 128, 256].contains(&channels) && channels % self.groups == 0, "{channels} channels");
        Tensor::empty([rows, self.groups, 2], (Kind::Float, x.device()))
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
mod tests {
    use super::*;
    use tch::Device;

    const DEVICE: Device = Device::Cuda(0);
    /// A number rounded to bfloat16 is off by at most 2⁻⁹; the root mean square of that over many is less.
    const ROUNDING: f64 = 0.003;

    fn kernels() -> Kernels {
        crate::device::load_cuda();
        tch::manual_seed(1);
        let _context = Tensor::zeros([1], (Kind::Float, DEVICE));
        Kernels::compile().unwrap()
    }

    fn random_map(size: [i64; 4]) -> Tensor {
        channels_last(Tensor::randn(size, (Kind::Float, DEVICE)).to_kind(Kind::BFloat16))
    }

    fn leaf(tensor: &Tensor) -> Tensor {
        tensor.to_kind(Kind::Float).detach().copy().set_requires_grad(true)
    }

    #[track_caller]
    fn assert_close(ours: &Tensor, theirs: &Tensor, tolerance: f64) {
        let (ours, theirs) = (ours.to_kind(Kind::Float), theirs.to_kind(Kind::Float));
        let error = (&ours - &theirs).norm().double_value(&[]) / theirs.norm().double_value(&[]);
        assert!(error < tolerance, "relative error {error}");
    }

    #[test]
    #[ignore = "needs a CUDA device"]
    fn kernels_of_the_norms() {
        let kernels = kernels();
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

    #[test]
    #[ignore = "needs a CUDA device"]
    fn kernels_of_the_stem() {
        let kernels = kernels();
        let kept = (Tensor::rand([3, 112, 112], (Kind::Float, DEVICE)) * 6000.0).round();
        let input = kernels.stem_input(&kept, 0.004, -2.0);
        let quarters = (&kept * 0.004 - 2.0).view([3, 56, 2, 56, 2]).permute([0, 2, 4, 1, 3]).reshape([3, 4, 56, 56]);
        let inner = input.narrow(2, 2, 56).narrow(3, 2, 56).to_kind(Kind::Float);
        assert_close(&(inner.narrow(1, 0, 4) + inner.narrow(1, 4, 4)), &quarters, 1e-4);
        assert_eq!(inner.abs().sum(Kind::Double).double_value(&[]), input.abs().sum(Kind::Double).double_value(&[]));

        let x = random_map([3, 32, 56, 56]);
        let weight = Tensor::randn([32], (Kind::Float, DEVICE));
        let bias = weight.randn_like();
        let norm = Affine { weight: &weight, bias: &bias, groups: 16 };
        let leaves = [&x, &weight, &bias].map(leaf);
        let expected = leaves[0].group_norm(16, Some(&leaves[1]), Some(&leaves[2]), 1e-5, true).relu();
        let expected = expected.max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false);
        let (y, winners, statistics) = kernels.stem_forward(&x, norm);
        assert_close(&y, &expected, ROUNDING);

        let dy = random_map([3, 32, 28, 28]);
        let loss = (&expected * dy.to_kind(Kind::Float)).sum(Kind::Float);
        let gradients = Tensor::run_backward(&[loss], &leaves, false, false);
        let ours = kernels.stem_backward([Some(&dy), None], &winners, &x, &statistics, norm);
        assert_close(&ours.input, &gradients[0], ROUNDING);
        assert_close(&ours.affine.get(1), &gradients[1], ROUNDING);
        assert_close(&ours.affine.get(0), &gradients[2], ROUNDING);
    }
}
