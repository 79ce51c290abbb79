//! What a visual encoder is to the network, and what the registry holds of each.

use crate::ffi::cuda::CudaError;
use crate::ffi::kernels::Kernels;
use crate::network::initialize::Initial;
use crate::network::layers::Linear;
use crate::network::parameters::{Layout, ParameterId, Parameters};
use proto::config;
use std::fmt;
use tch::Tensor;

/// Width of the visual embedding.
pub(crate) const VISUAL: i64 = 512;

/// Where the names of an encoder's weights begin.
pub(crate) const PATH: &str = "visual_encoder";

/// Gradients by parameter, each of its parameter's shape.
pub(crate) type Gradients = Vec<(ParameterId, Tensor)>;

/// The backward pass of an encoder that autograd does not see: gradient of the embedding \[rows, 512\] → gradients of
/// all of the encoder's parameters.
pub(crate) type Backward<'a> = Box<dyn FnOnce(&Tensor) -> Gradients + 'a>;

pub(crate) trait VisualEncoder: fmt::Debug + Send {
    /// The network's input \[rows, 1, side, side\] → \[rows, 512\], through autograd, in float32.
    fn forward(&self, parameters: &Parameters, frames: &Tensor) -> Tensor;

    /// Whether it can compute in bfloat16 with kernels of its own, given a CUDA device.
    fn has_kernels(&self) -> bool {
        false
    }

    /// Compiles these kernels; [`VisualEncoder::forward_fused`] runs them from now on. Panics if it has none.
    fn fuse(&mut self) -> Result<(), CudaError> {
        panic!("this encoder has no kernels")
    }

    /// Its kernels, once they are compiled.
    fn kernels(&self) -> Option<&Kernels> {
        None
    }

    /// Renews, in place, what [`VisualEncoder::forward_fused`] derives from the weights, if they have changed.
    fn refresh(&self, _parameters: &Parameters) {}

    /// Kept frames \[rows, side, side\] → \[rows, 512\], f32 and outside autograd, and the backward pass to it. The
    /// network's input is `frame · scale + offset`. `None` before [`VisualEncoder::fuse`].
    fn forward_fused<'a>(
        &'a self,
        _parameters: &'a Parameters,
        _kept: &Tensor,
        _scale_offset: [f32; 2],
    ) -> Option<(Tensor, Backward<'a>)> {
        None
    }

    /// The same, to the same bits, where it is trained: a pass may be recorded and launched again, and then it holds until
    /// the next one begins. `update` tells updates apart: what comes in several is worth a recording.
    fn forward_to_train<'a>(
        &'a self,
        parameters: &'a Parameters,
        kept: &Tensor,
        scale_offset: [f32; 2],
        _update: u64,
    ) -> Option<(Tensor, Backward<'a>)> {
        self.forward_fused(parameters, kept, scale_offset)
    }
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct EncoderEntry {
    pub encoder: config::Encoder,
    /// Its last layer, which no other encoder has.
    pub linear: &'static str,
    /// Inputs of that layer for square frames of this side, pixels.
    pub features: fn(i64) -> i64,
    /// Declares its weights for square frames of this side, pixels.
    pub declare: fn(&mut Layout, i64) -> Box<dyn VisualEncoder>,
    /// Where names of weights begin here, and in AllenAct; both up to and including the dot.
    pub allenact: &'static [(&'static str, &'static str)],
}

/// A linear layer from a flattened feature map to the visual embedding, initialised as the encoders' convolutions.
pub(crate) fn visual_linear(layout: &mut Layout, path: &str, inputs: i64) -> Linear {
    Linear::new(layout, path, [inputs, VISUAL], Initial::kaiming_normal(inputs), Initial::Constant(0.0))
}
