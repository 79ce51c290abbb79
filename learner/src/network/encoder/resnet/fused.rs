//! The encoder on a CUDA device in bfloat16: the stem and the blocks of the first stage in kernels of our own; in later
//! stages libtorch's convolutions on maps with channels last, and one kernel for everything between two of them. The
//! backward pass is written out.
//!
//! Weights stay f32; this pass works on rounded copies, which are made once an optimiser step. Only what the backward
//! pass reads is kept, and autograd never sees the encoder: it ends at the visual embedding, whose gradient
//! [`Fused::backward`] takes from there.

use super::super::visual::Gradients;
use super::plain::{BASE, Block, COMPRESSED, Resnet};
use crate::ffi::convolution::convolution_backward;
use crate::ffi::cuda::CudaError;
use crate::ffi::kernels::{
    self, Affine, BlockGradients, BlockKernels, Kernels, NormGradients, Statistics, Stem, StemGradients, StemTape,
    Then, channels_last,
};
use crate::network::layers::{Convolution, GroupNorm};
use crate::network::parameters::Parameters;
use std::cell::RefCell;
use tch::{Kind, Tensor};

#[derive(Debug)]
pub(super) struct Fused {
    kernels: Kernels,
    copies: Copies,
}

/// The weights as this pass uses them, once they are made.
#[derive(Debug, Default)]
struct Copies(RefCell<Option<Rounded>>);

#[derive(Debug)]
struct Rounded {
    /// Version of the weights that these are copies of; none where nobody knows.
    version: Option<i64>,
    stem: Tensor,
    blocks: Vec<BlockWeights>,
    compression: Tensor,
    /// \[512, pixels · 128\]: the inputs in the order of a map with channels last.
    linear: Tensor,
    linear_bias: Tensor,
}

#[derive(Debug)]
struct BlockWeights {
    first: Tensor,
    second: Tensor,
    projection: Option<Tensor>,
}

/// Results of a convolution and its norm in the forward pass that the backward pass needs.
#[derive(Debug)]
struct Normed {
    /// What came out of the convolution.
    x: Tensor,
    statistics: Statistics,
}

#[derive(Debug)]
struct BlockTape {
    input: Tensor,
    inner: Inner,
    output: Tensor,
}

/// What a block leaves between input and output.
#[derive(Debug)]
enum Inner {
    /// A kernel of our own for the whole block keeps nothing else.
    Whole(Statistics),
    Layers {
        first: Normed,
        /// After the first norm's ReLU.
        between: Tensor,
        second: Normed,
        projection: Option<Normed>,
    },
}

/// What a forward pass leaves for its backward pass.
#[derive(Debug)]
pub(super) struct Tape {
    kept: Tensor,
    stem: StemTape,
    blocks: Vec<BlockTape>,
    /// What the compression saw.
    features: Tensor,
    compression: Normed,
    compressed: Tensor,
    visual: Tensor,
}

impl Fused {
    /// Compiles the kernels for frames of this side. libtorch must have made a tensor on the device before.
    pub(super) fn new(side: i64) -> Result<Self, CudaError> {
        Ok(Self { kernels: Kernels::compile(side)?, copies: Copies::default() })
    }

    pub(super) fn kernels(&self) -> &Kernels {
        &self.kernels
    }

    pub(super) fn refresh(&self, resnet: &Resnet, parameters: &Parameters) {
        self.copies.refresh(resnet, parameters);
    }

    pub(super) fn renew(&self, resnet: &Resnet, parameters: &Parameters) {
        self.copies.renew(resnet, parameters);
    }

    pub(super) fn while_recorded<T, E>(&self, record: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        self.copies.while_recorded(record)
    }

    /// Kept frames \[rows, side, side\] → visual embedding \[rows, 512\], f32 and outside autograd. The network sees
    /// `frame · scale + offset`.
    pub(super) fn forward(
        &self,
        resnet: &Resnet,
        parameters: &Parameters,
        kept: &Tensor,
        scale_offset: [f32; 2],
    ) -> (Tensor, Tape) {
        let _no_grad = tch::no_grad_guard();
        self.refresh(resnet, parameters);
        let copies = self.copies.0.borrow();
        let weights = copies.as_ref().expect("just made");
        let kernels = &self.kernels;
        let affine = |norm: &GroupNorm| affine(parameters, norm);

        let kept = kept.to_kind(Kind::Float).contiguous();
        let stem = Stem { taps: &weights.stem, norm: affine(&resnet.stem.1), scale_offset };
        let (mut features, stem) = kernels.stem.forward(&kept, stem);

        let mut blocks = Vec::with_capacity(resnet.blocks.len());
        for (block, weights) in resnet.blocks.iter().zip(&weights.blocks) {
            let normed = |input: &Tensor, weight: &Tensor, part: &(Convolution, GroupNorm), around, relu| {
                let x = convolve(input, weight, [part.0.stride, part.0.padding]);
                let (y, statistics) = kernels.norm.forward(&x, around, affine(&part.1), relu);
                (y, Normed { x, statistics })
            };
            let input = features;
            if let Some((kernels, whole)) = whole(kernels, parameters, block, weights, &input) {
                let (output, statistics) = kernels.forward(&input, whole);
                features = output.shallow_clone();
                blocks.push(BlockTape { input, inner: Inner::Whole(statistics), output });
                continue;
            }
            let (between, first) = normed(&input, &weights.first, &block.first, None, true);
            let projection = block.projection.as_ref().zip(weights.projection.as_ref());
            let projection = projection.map(|(part, weight)| normed(&input, weight, part, None, false));
            let around = projection.as_ref().map_or(&input, |(around, _)| around);
            let (output, second) = normed(&between, &weights.second, &block.second, Some(around), true);
            features = output.shallow_clone();
            let projection = projection.map(|(_, normed)| normed);
            blocks.push(BlockTape { input, inner: Inner::Layers { first, between, second, projection }, output });
        }

        let part = &resnet.compression;
        let x = convolve(&features, &weights.compression, [part.0.stride, part.0.padding]);
        let (compressed, statistics) = kernels.norm.forward(&x, None, affine(&part.1), true);
        let compression = Normed { x, statistics };
        let visual = flat(&compressed).linear(&weights.linear, Some(&weights.linear_bias)).relu_();
        let embedding = visual.to_kind(Kind::Float);
        (embedding, Tape { kept, stem, blocks, features, compression, compressed, visual })
    }

    /// Gradients of all of the encoder's parameters for that of the embedding \[rows, 512\]. Panics if the weights have
    /// changed since the forward pass.
    #[expect(clippy::too_many_lines, reason = "it undoes the forward pass step by step, and reads beside it")]
    pub(super) fn backward(
        &self,
        resnet: &Resnet,
        parameters: &Parameters,
        tape: Tape,
        gradient: &Tensor,
        scale_offset: [f32; 2],
    ) -> Gradients {
        let _no_grad = tch::no_grad_guard();
        let copies = self.copies.0.borrow();
        let weights = copies.as_ref().expect("a forward pass rounds the weights");
        assert_eq!(weights.version, Some(parameters.version()), "the weights are those of the forward pass");
        let kernels = &self.kernels;
        let affine = |norm: &GroupNorm| affine(parameters, norm);
        let mut gradients: Gradients = Vec::new();
        let mut of_norm = |norm: &GroupNorm, NormGradients { input, affine }: NormGradients| {
            gradients.push((norm.bias, affine.get(0)));
            gradients.push((norm.weight, affine.get(1)));
            input
        };
        let (mut convolutions, mut whole_blocks): (Gradients, Gradients) = (Vec::new(), Vec::new());
        let mut of_convolution = |part: &Convolution, dy: &Tensor, x: &Tensor, weight: &Tensor| {
            let (dw, dx) = convolution_gradients(dy, x, weight, [part.stride, part.padding]);
            convolutions.push((part.weight, dw.to_kind(Kind::Float)));
            dx.map(channels_last)
        };

        let Tape { kept, stem, blocks, features, compression, compressed, visual } = tape;
        let d_visual = gradient.to_kind(Kind::BFloat16) * visual.gt(0);
        let d_linear = d_visual.tr().matmul(&flat(&compressed));
        let d_linear_bias = d_visual.sum_dim_intlist([0i64].as_slice(), false, Kind::Float);
        let d_compressed = d_visual.matmul(&weights.linear);

        let (_, channels, height, width) = compressed.size4().expect("a feature map");
        let d_compressed = d_compressed.view([-1, height, width, channels]).permute([0, 3, 1, 2]);
        let (part, norm) = &resnet.compression;
        let (d, _) = kernels.norm.backward(
            [Some(&d_compressed), None],
            Then::Relu,
            &compression.x,
            &compression.statistics,
            affine(norm),
        );
        let d = of_norm(norm, d);
        // The gradient of a block's output, in up to two parts: through the next block, and around it.
        let mut through = of_convolution(part, &d, &features, &weights.compression);
        let mut around: Option<Tensor> = None;

        for ((block, weights), tape) in resnet.blocks.iter().zip(&weights.blocks).zip(blocks).rev() {
            let BlockTape { input, inner, output } = tape;
            let (first, between, second, projection) = match inner {
                Inner::Layers { first, between, second, projection } => (first, between, second, projection),
                Inner::Whole(statistics) => {
                    let whole = whole(kernels, parameters, block, weights, &input);
                    let (kernels, words) = whole.expect("as in the forward pass");
                    let users = [through.as_ref(), around.as_ref()];
                    let d = kernels.backward(users, &output, &input, &statistics, words);
                    let BlockGradients { input, weights, affine } = d;
                    let parts = [&block.first, &block.second].into_iter().zip(weights.into_iter().zip(affine));
                    for ((part, norm), (weight, affine)) in parts {
                        whole_blocks.push((part.weight, weight));
                        whole_blocks.push((norm.bias, affine.get(0)));
                        whole_blocks.push((norm.weight, affine.get(1)));
                    }
                    (through, around) = (Some(input), None);
                    continue;
                }
            };
            let (d, d_around) = kernels.norm.backward(
                [through.as_ref(), around.as_ref()],
                Then::AddAndRelu(&output),
                &second.x,
                &second.statistics,
                affine(&block.second.1),
            );
            let d = of_norm(&block.second.1, d);
            let d_between = of_convolution(&block.second.0, &d, &between, &weights.second);
            let (d, _) = kernels.norm.backward(
                [d_between.as_ref(), None],
                Then::Relu,
                &first.x,
                &first.statistics,
                affine(&block.first.1),
            );
            let d = of_norm(&block.first.1, d);
            through = of_convolution(&block.first.0, &d, &input, &weights.first);
            around = match (&block.projection, projection, &weights.projection) {
                (Some((part, norm)), Some(normed), Some(weight)) => {
                    let dy = [d_around.as_ref(), None];
                    let (d, _) = kernels.norm.backward(dy, Then::Nothing, &normed.x, &normed.statistics, affine(norm));
                    of_convolution(part, &of_norm(norm, d), &input, weight)
                }
                _ => d_around,
            };
        }

        let (part, norm) = &resnet.stem;
        let users = [through.as_ref(), around.as_ref()];
        let words = Stem { taps: &weights.stem, norm: affine(norm), scale_offset };
        let StemGradients { taps, affine } = kernels.stem.backward(users, &stem, &kept, words);
        gradients.push((norm.bias, affine.get(0)));
        gradients.push((norm.weight, affine.get(1)));
        gradients.push((part.weight, from_stem_weight(&taps)));

        gradients.append(&mut convolutions);
        gradients.append(&mut whole_blocks);
        gradients.push((resnet.linear.weight, from_pixel_order(&d_linear.to_kind(Kind::Float))));
        gradients.push((resnet.linear.bias, d_linear_bias));
        gradients
    }
}

impl Copies {
    /// Rounds the weights anew if they have changed. The copies stay in their places, which recorded graphs know.
    fn refresh(&self, resnet: &Resnet, parameters: &Parameters) {
        let is_new = self.0.borrow().as_ref().is_some_and(|weights| weights.version == Some(parameters.version()));
        if !is_new {
            self.renew(resnet, parameters);
        }
    }

    /// The same in any case: a recorded pass does it each time.
    fn renew(&self, resnet: &Resnet, parameters: &Parameters) {
        match &mut *self.0.borrow_mut() {
            Some(weights) => weights.take(Rounded::new(resnet, parameters)),
            none => *none = Some(Rounded::new(resnet, parameters)),
        }
    }

    /// Records something that renews the copies. A recording notes the version and copies nothing: a launch does. If it
    /// fails there is none, so the next [`Copies::refresh`] is to copy whatever was noted.
    fn while_recorded<T, E>(&self, record: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let recorded = record();
        if recorded.is_err()
            && let Some(weights) = &mut *self.0.borrow_mut()
        {
            weights.version = None;
        }
        recorded
    }
}

impl Rounded {
    fn new(resnet: &Resnet, parameters: &Parameters) -> Self {
        let round = |part: &Convolution| channels_last(parameters[part.weight].detach().to_kind(Kind::BFloat16));
        let block = |block: &Block| BlockWeights {
            first: round(&block.first.0),
            second: round(&block.second.0),
            projection: block.projection.as_ref().map(|(part, _)| round(part)),
        };
        let linear = |id| parameters[id].detach().to_kind(Kind::BFloat16);
        let _no_grad = tch::no_grad_guard();
        Self {
            version: Some(parameters.version()),
            stem: channels_last(to_stem_weight(&parameters[resnet.stem.0.weight].detach()).to_kind(Kind::BFloat16)),
            blocks: resnet.blocks.iter().map(block).collect(),
            compression: round(&resnet.compression.0),
            linear: to_pixel_order(&linear(resnet.linear.weight)),
            linear_bias: linear(resnet.linear.bias),
        }
    }
}

impl Rounded {
    fn tensors(&mut self) -> impl Iterator<Item = &mut Tensor> {
        let blocks = self
            .blocks
            .iter_mut()
            .flat_map(|block| [&mut block.first, &mut block.second].into_iter().chain(block.projection.as_mut()));
        [&mut self.stem, &mut self.compression, &mut self.linear, &mut self.linear_bias].into_iter().chain(blocks)
    }

    /// Copies other numbers into these places.
    fn take(&mut self, mut newer: Self) {
        self.version = newer.version;
        tch::no_grad(|| {
            for (place, newer) in self.tensors().zip(newer.tensors()) {
                place.copy_(newer);
            }
        });
    }
}

/// The kernels for whole blocks and the block as they take it, if there are any for such maps.
fn whole<'a>(
    kernels: &'a Kernels,
    parameters: &'a Parameters,
    block: &Block,
    weights: &'a BlockWeights,
    input: &Tensor,
) -> Option<(&'a BlockKernels, kernels::Block<'a>)> {
    let kernels = kernels.block.as_ref().filter(|_| weights.projection.is_none() && BlockKernels::fit(input))?;
    let words = kernels::Block {
        weights: [&weights.first, &weights.second],
        norms: [affine(parameters, &block.first.1), affine(parameters, &block.second.1)],
    };
    Some((kernels, words))
}

fn affine<'a>(parameters: &'a Parameters, norm: &GroupNorm) -> Affine<'a> {
    Affine { weight: &parameters[norm.weight], bias: &parameters[norm.bias], groups: norm.groups }
}

fn convolve(x: &Tensor, weight: &Tensor, [stride, padding]: [i64; 2]) -> Tensor {
    channels_last(x.conv2d(weight, None::<Tensor>, [stride; 2], [padding; 2], [1; 2], 1))
}

fn convolution_gradients(
    dy: &Tensor,
    x: &Tensor,
    weight: &Tensor,
    stride_padding: [i64; 2],
) -> (Tensor, Option<Tensor>) {
    match convolution_backward(dy, x, weight, stride_padding, true) {
        Ok(gradients) => gradients,
        // As in tch: a device that fails in the middle of a pass ends the process.
        Err(error) => panic!("{error}"),
    }
}

/// A map with channels last as rows of numbers, pixel by pixel.
fn flat(map: &Tensor) -> Tensor {
    map.permute([0, 2, 3, 1]).flatten(1, -1)
}

/// A weight over inputs in the order (channel, pixel) → one over (pixel, channel).
fn to_pixel_order(weight: &Tensor) -> Tensor {
    let outputs = weight.size()[0];
    weight.view([outputs, COMPRESSED, -1]).permute([0, 2, 1]).reshape([outputs, -1])
}

/// The way back.
fn from_pixel_order(weight: &Tensor) -> Tensor {
    let outputs = weight.size()[0];
    weight.view([outputs, -1, COMPRESSED]).permute([0, 2, 1]).reshape([outputs, -1])
}

/// The stem's weight \[32, 1, 7, 7\] → \[32, 8, 4, 4\], for an input as `fill_band` in `stem.cu` makes it: taps
/// −1..6 in twos, the first of which is zero, and the same for both parts of a number.
fn to_stem_weight(weight: &Tensor) -> Tensor {
    let taps = weight.constant_pad_nd([1, 0, 1, 0]).view([BASE, 4, 2, 4, 2]);
    let one_part = taps.permute([0, 2, 4, 1, 3]).reshape([BASE, 4, 4, 4]);
    Tensor::cat(&[&one_part, &one_part], 1)
}

/// Backward pass of a gradient: the gradients of both parts are added.
fn from_stem_weight(gradient: &Tensor) -> Tensor {
    let one_part = gradient.view([BASE, 2, 4, 4, 4]).sum_dim_intlist([1i64].as_slice(), false, Kind::Float);
    let taps = one_part.view([BASE, 2, 2, 4, 4]).permute([0, 3, 1, 4, 2]).reshape([BASE, 1, 8, 8]);
    taps.narrow(2, 1, 7).narrow(3, 1, 7)
}

#[cfg(test)]
mod tests {
    use super::super::PATH;
    use super::*;
    use crate::network::parameters::Layout;
    use tch::Device;

    /// The computation of `fill_band` with libtorch's operations and without rounding.
    fn stem_input(x: &Tensor) -> Tensor {
        let (rows, _, side, _) = x.size4().unwrap();
        let half = side / 2;
        let quarters = x.view([rows, half, 2, half, 2]).permute([0, 2, 4, 1, 3]).reshape([rows, 4, half, half]);
        let first = (&quarters * 8.0).round() / 8.0;
        Tensor::cat(&[&first, &(&quarters - &first)], 1).constant_pad_nd([2, 1, 2, 1])
    }

    #[test]
    fn the_stem_is_the_same_convolution_in_other_words() {
        tch::manual_seed(5);
        let float = (Kind::Float, Device::Cpu);
        let x = Tensor::randn([2, 1, 16, 16], float);
        let weight = Tensor::randn([BASE, 1, 7, 7], float).set_requires_grad(true);
        let expected = x.conv2d(&weight, None::<Tensor>, [2; 2], [3; 2], [1; 2], 1);
        let words = to_stem_weight(&weight.detach());
        let y = stem_input(&x).conv2d(&words, None::<Tensor>, [1; 2], [0; 2], [1; 2], 1);
        assert!(y.allclose(&expected, 1e-4, 1e-4, false));

        let dy = expected.randn_like();
        let expected = Tensor::run_backward(&[(&expected * &dy).sum(Kind::Float)], &[&weight], false, false);
        let (dw, _) = convolution_backward(&dy, &stem_input(&x), &words, [1, 0], false).unwrap();
        assert!(from_stem_weight(&dw).allclose(&expected[0], 1e-4, 1e-4, false));
    }

    #[test]
    fn pixel_order_and_back_is_nothing() {
        let weight = Tensor::arange(3 * COMPRESSED * 4, (Kind::Float, Device::Cpu)).view([3, COMPRESSED * 4]);
        let there = to_pixel_order(&weight);
        assert_eq!(there.double_value(&[0, 1]), 4.0);
        assert_eq!(from_pixel_order(&there), weight);
    }
    /// Their numbers, and where they lie.
    fn numbers(copies: &Copies) -> Vec<(Tensor, usize)> {
        let mut weights = copies.0.borrow_mut();
        let tensors = weights.as_mut().unwrap().tensors();
        tensors.map(|tensor| (tensor.copy(), tensor.data_ptr() as usize)).collect()
    }

    #[test]
    fn a_recording_that_fails_leaves_no_copies_of_older_weights() {
        let mut layout = Layout::default();
        let resnet = Resnet::new(&mut layout, PATH, 32);
        let parameters = Parameters::new(layout, 3, Device::Cpu);
        let copies = Copies::default();
        copies.refresh(&resnet, &parameters);
        let before = numbers(&copies);
        tch::no_grad(|| {
            let _ = parameters.flat().g_add_scalar_(1.0);
        });
        let failed = copies.while_recorded(|| {
            copies.renew(&resnet, &parameters);
            // The copying is in the recording, and was not done.
            for (place, (old, _)) in copies.0.borrow_mut().as_mut().unwrap().tensors().zip(&before) {
                place.copy_(old);
            }
            Err::<(), &str>("out of memory")
        });
        assert_eq!(failed, Err("out of memory"));
        copies.refresh(&resnet, &parameters);
        let mut expected = Rounded::new(&resnet, &parameters);
        for ((found, at), (expected, (old, place))) in numbers(&copies).iter().zip(expected.tensors().zip(&before)) {
            assert!(found.equal(expected) && !found.equal(old), "the weights of now");
            assert_eq!(at, place, "in the places that graphs know");
        }
    }
}
