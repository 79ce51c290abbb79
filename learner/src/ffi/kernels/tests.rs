//! Each kernel beside libtorch's float32 autograd on the same bfloat16 numbers. They need a CUDA device:
//! `cargo nextest run --release --workspace --run-ignored only kernels`.

use super::*;
use tch::{Device, Kind, Tensor};

const DEVICE: Device = Device::Cuda(0);
/// A number rounded to bfloat16 is off by at most 2⁻⁹; the root mean square of that over many is less.
const ROUNDING: f64 = 0.003;
/// Of stem and first stage.
const CHANNELS: i64 = 32;
const GROUPS: i64 = 16;

fn kernels(side: i64) -> Kernels {
    crate::device::load_cuda();
    tch::manual_seed(1);
    let _context = Tensor::zeros([1], (Kind::Float, DEVICE));
    Kernels::compile(side).unwrap()
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
            let (y, statistics) = kernels.norm.forward(&x, around, norm, relu);
            assert_close(&y, &expected, ROUNDING);

            let dy = [random_map(size), random_map(size)];
            let loss = (&expected * (&dy[0] + &dy[1]).to_kind(Kind::Float)).sum(Kind::Float);
            let gradients = Tensor::run_backward(&[loss], &leaves, false, false);
            let users = [Some(&dy[0]), Some(&dy[1])];
            let output = relu.then_some(&y);
            let (ours, d_around) = kernels.norm.backward(users, output, &x, &statistics, norm, around.is_some());
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

/// What the convolution sees, with libtorch's operations.
fn parts(kept: &Tensor, [scale, offset]: [f32; 2]) -> Tensor {
    let (rows, side, _) = kept.size3().unwrap();
    let half = side / 2;
    let x = kept * f64::from(scale) + f64::from(offset);
    let quarters = x.view([rows, half, 2, half, 2]).permute([0, 2, 4, 1, 3]).reshape([rows, 4, half, half]);
    let first = quarters.to_kind(Kind::BFloat16).to_kind(Kind::Float);
    let second = (&quarters - &first).to_kind(Kind::BFloat16).to_kind(Kind::Float);
    Tensor::cat(&[&first, &second], 1).constant_pad_nd([2, 1, 2, 1])
}

#[test]
#[ignore = "needs a CUDA device"]
fn kernels_of_the_stem() {
    for side in [56, 112, 224] {
        let kernels = kernels(side);
        let float = (Kind::Float, DEVICE);
        // Walls and edges, not noise alone.
        let coarse = Tensor::rand([300, 1, 7, 7], float) * 4000.0 + 300.0;
        let kept = (coarse.upsample_nearest2d([side, side], None, None).squeeze_dim(1)
            + Tensor::rand([300, side, side], float) * 40.0)
            .round();
        let scale_offset = [0.004, -2.0];
        let taps = channels_last(random_map([CHANNELS, 8, 4, 4]) * 0.1);
        // Negative weights turn the order of a channel's numbers round.
        let weight = Tensor::randn([CHANNELS], float);
        let bias = weight.randn_like();
        let norm = Affine { weight: &weight, bias: &bias, groups: GROUPS };
        let stem = Stem { taps: &taps, norm, scale_offset };

        let leaves = [&taps, &weight, &bias].map(leaf);
        let x = parts(&kept, scale_offset).conv2d(&leaves[0], None::<Tensor>, [1; 2], [0; 2], [1; 2], 1);
        let rounded = &x + (x.to_kind(Kind::BFloat16).to_kind(Kind::Float) - &x).detach();
        let expected = rounded.group_norm(GROUPS, Some(&leaves[1]), Some(&leaves[2]), 1e-5, true).relu();
        let expected = expected.max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false);
        let (y, tape) = kernels.stem.forward(&kept, stem);
        assert_close(&y, &expected, 2.0 * ROUNDING);

        let size = y.size4().unwrap();
        let dy = [0, 1].map(|_| random_map([size.0, size.1, size.2, size.3]));
        let loss = (&expected * (&dy[0] + &dy[1]).to_kind(Kind::Float)).sum(Kind::Float);
        let gradients = Tensor::run_backward(&[loss], &leaves, false, false);
        let ours = kernels.stem.backward([Some(&dy[0]), Some(&dy[1])], &tape, &kept, stem);
        assert_close(&ours.affine.get(1), &gradients[1], 2.0 * ROUNDING);
        assert_close(&ours.affine.get(0), &gradients[2], 2.0 * ROUNDING);
        assert_close(&ours.taps, &gradients[0], 4.0 * ROUNDING);
        let again = kernels.stem.backward([Some(&dy[0]), Some(&dy[1])], &tape, &kept, stem);
        assert_eq!(again.taps, ours.taps, "the same bits");
    }
}

#[test]
#[ignore = "needs a CUDA device of compute capability 9.0"]
fn kernels_of_whole_blocks() {
    let blocks = kernels(112).block.expect("a GPU with the shared memory of an H100");
    // More maps than blocks of threads, and fewer.
    for rows in [300, 5] {
        let size = [rows, CHANNELS, 28, 28];
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
        let (y, statistics) = blocks.forward(&x, block);
        assert_close(&y, &expected, ROUNDING);

        let dy = [random_map(size), random_map(size)];
        let loss = (&expected * (&dy[0] + &dy[1]).to_kind(Kind::Float)).sum(Kind::Float);
        let leaves = [&input, &w1, &w2, &g1, &b1, &g2, &b2];
        let gradients = Tensor::run_backward(&[loss], &leaves, false, false);
        let backward = || blocks.backward([Some(&dy[0]), Some(&dy[1])], &y, &x, &statistics, block);
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
