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
    let _alone = crate::device::cuda_alone();
    let kernels = kernels(112);
    // Groups of 2, 4, 8 and 16 channels and of all; then maps too large for shared memory, in part and always.
    let sizes = [(32, 28, 16), (64, 14, 16), (128, 7, 16), (256, 4, 16), (128, 4, 1)];
    let large = [(64, 28, 16), (32, 64, 16), (64, 48, 16), (128, 32, 16)];
    for (channels, side, groups) in sizes.into_iter().chain(large) {
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

            let then = match (relu, around) {
                (true, Some(_)) => Then::AddAndRelu(&y),
                (true, None) => Then::Relu,
                (false, _) => Then::Nothing,
            };
            let dy = [random_map(size), random_map(size)];
            let one = ([Some(&dy[0]), None], dy[0].copy());
            let two = ([Some(&dy[0]), Some(&dy[1])], &dy[0] + &dy[1]);
            for (users, sum) in [one, two] {
                let loss = (&expected * sum.to_kind(Kind::Float)).sum(Kind::Float);
                let gradients = Tensor::run_backward(&[loss], &leaves, true, false);
                let (ours, d_around) = kernels.norm.backward(users, then, &x, &statistics, norm);
                assert_eq!(d_around.is_some(), around.is_some());
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
    let _alone = crate::device::cuda_alone();
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
    let _alone = crate::device::cuda_alone();
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

/// The belief, policy and value of libtorch's own operations, and the action with the most noise on it.
#[test]
#[ignore = "needs a CUDA device"]
fn kernel_of_decisions() {
    let _alone = crate::device::cuda_alone();
    let kernels = kernels(112);
    let float = (Kind::Float, DEVICE);
    let sizes = [(1, 8, 13), (152, 512, 21), (5, 4096, 32)];
    for ((rows, hidden, actions), is_lstm) in sizes.into_iter().flat_map(|sizes| [(sizes, false), (sizes, true)]) {
        let (gates, state) = if is_lstm { (4 * hidden, 2 * hidden) } else { (3 * hidden, hidden) };
        let random = |size: &[i64]| Tensor::randn(size, float);
        let (x, before) = (random(&[rows, 40]), random(&[rows, state]));
        let (own, biases) = (before.narrow(1, 0, hidden), [random(&[gates]), random(&[gates])]);
        let gates = [random(&[gates, 40]), random(&[gates, hidden]) / (hidden as f64).sqrt()];
        let heads = [actions, 1].map(|width| [random(&[width, hidden]) / (hidden as f64).sqrt(), random(&[width])]);
        let noise = random(&[rows, actions]);
        let [input_bias, before_bias] = biases.each_ref().map(Some);
        let (expected, states) = if is_lstm {
            let cell = before.narrow(1, hidden, hidden);
            let (after, cell) = x.lstm_cell(&[&own, &cell], &gates[0], &gates[1], input_bias, before_bias);
            (after.shallow_clone(), Tensor::cat(&[after, cell], 1))
        } else {
            let after = x.gru_cell(&before, &gates[0], &gates[1], input_bias, before_bias);
            (after.shallow_clone(), after)
        };
        let log_probs = expected.linear(&heads[0][0], Some(&heads[0][1])).log_softmax(-1, None);
        let values = expected.linear(&heads[1][0], Some(&heads[1][1])).squeeze_dim(1);

        let (from_input, from_before) = (x.matmul(&gates[0].tr()), own.matmul(&gates[1].tr()));
        let row = Undecided { from_input: &from_input, from_before: &from_before, before: &before, noise: &noise };
        let [actor, critic] = heads.each_ref().map(|[weight, bias]| [weight, bias]);
        let heads = Heads { gate_biases: [&biases[0], &biases[1]], actor, critic, log_std: None };
        // Each to another row than its own.
        let to = Tensor::arange_start_step(rows - 1, -1, -1, (Kind::Int64, DEVICE));
        let (table, choices) =
            (Tensor::zeros([rows + 1, state], float), Tensor::zeros([rows, CHOSEN_WORDS as i64], float));
        // SAFETY: rows of the table.
        unsafe { kernels.acting.decide(&heads, &row, &to, &table, &choices) };
        assert_close(&table.narrow(0, 0, rows).flip([0]), &states, 1e-5);
        assert!(table.get(rows).abs().max().double_value(&[]) == 0.0, "the row that nobody chose");
        let (words, perturbed) = (crate::network::to_vec(&choices), &log_probs + &noise);
        for (index, words) in words.chunks_exact(CHOSEN_WORDS).enumerate() {
            let (chosen, index) = (Chosen::from_words(words), index as i64);
            assert!(chosen.finite);
            let at = [index, chosen.action as i64];
            let best = perturbed.get(index).max().double_value(&[]);
            assert!((perturbed.double_value(&at) - best).abs() < 1e-4, "row {index}");
            assert!((f64::from(chosen.log_prob) - log_probs.double_value(&at)).abs() < 1e-4);
            assert!((f64::from(chosen.value) - values.double_value(&[index])).abs() < 1e-4);
        }
        // Without a choice: the same logits and values, and deviations if there are some.
        let deviations = random(&[actions]);
        for log_std in [None, Some(&deviations)] {
            let (open, logits) = (Heads { log_std, ..heads }, expected.linear(actor[0], Some(actor[1])));
            let given = log_std.map(|tensor| tensor.expand_as(&logits));
            let parts: Vec<Tensor> = [logits].into_iter().chain(given).chain([values.unsqueeze(1)]).collect();
            let wanted = Tensor::cat(&parts, 1);
            let outputs = wanted.zeros_like();
            // SAFETY: as above.
            unsafe { kernels.acting.answer(&open, &row, &to, &table, &outputs) };
            assert_close(&outputs, &wanted, 1e-5);
        }
        // Of equal actions the first: here of all, and of those from the fourth on.
        let zeros = heads.actor.map(Tensor::zeros_like);
        let even = Heads { actor: zeros.each_ref(), ..heads };
        for first in [0, 3] {
            let noise = Tensor::zeros([rows, actions], float);
            let _ = noise.narrow(1, 0, first).fill_(-1.0);
            let row = Undecided { noise: &noise, ..row };
            // SAFETY: as above.
            unsafe { kernels.acting.decide(&even, &row, &to, &table, &choices) };
            let words = crate::network::to_vec(&choices);
            assert!(words.chunks_exact(CHOSEN_WORDS).all(|words| Chosen::from_words(words).action == first as usize));
        }
        // A number that is not finite is noticed, in whichever output.
        let bad = [(heads.actor[1], f64::NAN), (heads.actor[1], f64::INFINITY), (heads.critic[1], f64::INFINITY)];
        for (head, bad) in bad {
            let (kept, choices) = (head.copy(), Tensor::zeros([rows, CHOSEN_WORDS as i64], float));
            let _ = head.get(head.size()[0] - 1).fill_(bad);
            // SAFETY: as above.
            unsafe { kernels.acting.decide(&heads, &row, &to, &table, &choices) };
            let words = crate::network::to_vec(&choices);
            assert!(words.chunks_exact(CHOSEN_WORDS).all(|words| !Chosen::from_words(words).finite));
            head.shallow_clone().copy_(&kept);
        }
    }
}

/// Sums that an actor has made give what the whole frame gives.
#[test]
#[ignore = "needs a CUDA device"]
fn kernel_of_observing_frames_and_sums() {
    use proto::camera::{DepthFrame, FRAME_PIXELS, SUMS_PIXELS, sum_windows};
    let _alone = crate::device::cuda_alone();
    let kernels = kernels(112);
    let pinned = |numbers: &[i16]| Tensor::from_slice(numbers).pin_memory(DEVICE);
    let depth_mm: Vec<i16> = (0..FRAME_PIXELS).map(|pixel| (pixel * 7919 % 16_000) as i16).collect();
    let frame: Box<[u16; FRAME_PIXELS]> =
        depth_mm.iter().map(|&depth_mm| depth_mm as u16).collect::<Vec<_>>().try_into().unwrap();
    let mut sums: Box<[u16; SUMS_PIXELS]> = vec![0; SUMS_PIXELS].try_into().unwrap();
    assert!(sum_windows(&frame, &mut sums));
    let sums_mm: Vec<i16> = sums.iter().map(|&sum| sum.cast_signed()).collect();
    let (whole, part) = (pinned(&depth_mm), pinned(&sums_mm));
    // SAFETY: pinned memory of these sizes, which outlives the frames.
    let frames = unsafe {
        let depth_mm = &*whole.data_ptr().cast::<[u16; FRAME_PIXELS]>();
        [DepthFrame::Whole(depth_mm), DepthFrame::Sums(&*part.data_ptr().cast())]
    };
    let words = frames.each_ref().map(|frame| kernels.acting.source(frame).word());
    assert_ne!(words[0], words[1], "one is read whole");
    // More than the blocks that read beside others; each goes to another row, and row 1 of the store stays empty.
    let rows: i64 = 40;
    let words: Vec<i64> = words.into_iter().cycle().take(rows as usize).collect();
    let places: Vec<i64> = (0..rows).map(|row| (rows - row) % rows + i64::from(row > 0)).collect();
    let float = (Kind::Float, DEVICE);
    let (kept, store) = (Tensor::zeros([rows, 112, 112], float), Tensor::zeros([rows + 1, 112, 112], float));
    let (words, places) = (Tensor::from_slice(&words).to_device(DEVICE), Tensor::from_slice(&places).to_device(DEVICE));
    let raw = whole.to_device(DEVICE).to_kind(Kind::Float).view([1, 1, 224, 224]);
    let expected = raw.avg_pool2d([2, 2], [2, 2], [0, 0], false, true, None).view([112, 112]);
    for alone in [true, false] {
        let _ = (kept.shallow_clone().zero_(), store.shallow_clone().zero_());
        // SAFETY: addresses of pinned memory, and rows of the store.
        unsafe { kernels.acting.observe(&words, &places, &kept, &store, alone) };
        for row in 0..rows {
            let kept_place = (rows - row) % rows + i64::from(row > 0);
            assert!(kept.get(row).equal(&expected) && store.get(kept_place).equal(&expected), "row {row}");
        }
        assert!(store.get(1).abs().max().double_value(&[]) == 0.0);
    }
}
