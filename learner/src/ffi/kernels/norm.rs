//! The kernels of group normalisation (`norm.cu`).

use super::map::{Affine, Statistics, address, int, launch, map, optional, over_rows, shape};
use crate::ffi::cuda::{CudaError, Kernel, Module};
use tch::{Kind, Tensor};

/// Threads of a block, one block a row: enough to hide memory's latency, few enough that several blocks share a
/// multiprocessor.
const THREADS: u32 = 256;

/// The kernels.
#[derive(Debug)]
pub struct NormKernels {
    forward: Kernel,
    backward: Kernel,
}

/// Gradients of a norm.
#[derive(Debug)]
pub struct NormGradients {
    /// Of its input, a feature map.
    pub input: Tensor,
    /// Of bias and weight, f32 \[2, channels\].
    pub affine: Tensor,
}

impl NormKernels {
    pub(super) fn find(module: &Module) -> Result<Self, CudaError> {
        Ok(Self { forward: module.kernel(c"norm_forward", 0)?, backward: module.kernel(c"norm_backward", 0)? })
    }

    /// `relu?(norm(x) + around?)`.
    pub fn forward(&self, x: &Tensor, around: Option<&Tensor>, norm: Affine, relu: bool) -> (Tensor, Statistics) {
        let [rows, channels, height, width] = shape(x);
        let y = map(x, shape(x));
        let statistics = norm.statistics(x);
        launch(
            self.forward,
            rows,
            THREADS,
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

    /// Gradients of [`NormKernels::forward`] for those of its output's users, one or two. `y` is the output where a
    /// ReLU made it. With `wants_around` also the gradient of `around`.
    pub fn backward(
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
            self.backward,
            rows,
            THREADS,
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
