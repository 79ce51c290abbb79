//! Our kernels (`*.cu` beside this file): the encoder's, and those around the network when it acts. Each is a function
//! over tensors; those that follow addresses or row numbers in device memory are unsafe.
//!
//! A feature map is a bfloat16 tensor \[rows, channels, height, width\] whose channels come last in memory.

mod acting;
mod block;
mod map;
mod norm;
mod rows;
mod stem;
#[cfg(test)]
mod tests;

pub use acting::{ActingKernels, CHOSEN_WORDS, Chosen, Heads, Source, Undecided};
pub use block::{Block, BlockGradients, BlockKernels};
pub use map::{Affine, Statistics, channels_last};
pub use norm::{NormGradients, NormKernels, Then};
pub use rows::RowKernels;
pub use stem::{Stem, StemGradients, StemKernels, StemTape};

use super::cuda::{CudaError, Module};
use proto::camera::FRAME_SIDE;

#[derive(Debug)]
pub struct Kernels {
    pub stem: StemKernels,
    /// Of whole basic blocks; none where a block of threads has too little shared memory.
    pub block: Option<BlockKernels>,
    pub norm: NormKernels,
    pub acting: ActingKernels,
}

impl Kernels {
    /// Compiles them for the first CUDA device, where libtorch must have made a tensor before, and for frames of this
    /// side. Takes two seconds.
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
            stem: StemKernels::find(&module, side)?,
            block: BlockKernels::find(&module)
                .inspect_err(|error| tracing::info!("blocks of the first stage run layer by layer: {error}"))
                .ok(),
            norm: NormKernels::find(&module)?,
            acting: ActingKernels::find(&module, side)?,
        })
    }
}
