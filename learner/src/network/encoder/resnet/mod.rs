//! The paper's encoder in its two ways: through autograd in float32 (`plain.rs`), which every device can run, and in
//! bfloat16 with kernels of our own (`fused.rs`) on a CUDA device, there recorded as CUDA graphs where it is trained
//! (`recorded.rs`).

mod fused;
mod plain;
mod recorded;

use super::visual::{Backward, EncoderEntry, PATH, VisualEncoder};
use crate::ffi::cuda::CudaError;
use crate::ffi::kernels::Kernels;
use crate::network::parameters::Parameters;
use fused::Fused;
use plain::Resnet;
use proto::config::Encoder;
use recorded::Recordings;
use std::cell::RefCell;
use tch::Tensor;

pub(crate) const ENTRY: EncoderEntry = EncoderEntry {
    encoder: Encoder::Resnet,
    linear: plain::LINEAR,
    features: plain::features,
    declare: |layout, side| {
        let (resnet, recordings) = (Resnet::new(layout, PATH, side), RefCell::default());
        Box::new(ResnetEncoder { resnet, side, fused: None, recordings })
    },
    allenact: &[
        ("visual_encoder.backbone.", "visual_encoder.backbone."),
        ("visual_encoder.compression.", "visual_encoder.compression."),
        ("visual_encoder.fc.1.", "visual_encoder.head.1."),
    ],
};

#[derive(Debug)]
struct ResnetEncoder {
    resnet: Resnet,
    /// Side of a frame, pixels.
    side: i64,
    /// The kernels, once they are compiled.
    fused: Option<Fused>,
    /// Passes of training, once they have come in two updates.
    recordings: RefCell<Recordings>,
}

impl VisualEncoder for ResnetEncoder {
    fn forward(&self, parameters: &Parameters, frames: &Tensor) -> Tensor {
        self.resnet.forward(parameters, frames)
    }

    fn has_kernels(&self) -> bool {
        true
    }

    fn fuse(&mut self) -> Result<(), CudaError> {
        self.fused = Some(Fused::new(self.side)?);
        Ok(())
    }

    fn kernels(&self) -> Option<&Kernels> {
        self.fused.as_ref().map(Fused::kernels)
    }

    fn refresh(&self, parameters: &Parameters) {
        if let Some(fused) = &self.fused {
            fused.refresh(&self.resnet, parameters);
        }
    }

    fn forward_fused<'a>(
        &'a self,
        parameters: &'a Parameters,
        kept: &Tensor,
        scale_offset: [f32; 2],
    ) -> Option<(Tensor, Backward<'a>)> {
        let fused = self.fused.as_ref()?;
        let (visual, tape) = fused.forward(&self.resnet, parameters, kept, scale_offset);
        let backward = move |gradient: &Tensor| fused.backward(&self.resnet, parameters, tape, gradient, scale_offset);
        Some((visual, Box::new(backward)))
    }

    fn forward_to_train<'a>(
        &'a self,
        parameters: &'a Parameters,
        kept: &Tensor,
        scale_offset: [f32; 2],
        update: u64,
    ) -> Option<(Tensor, Backward<'a>)> {
        let fused = self.fused.as_ref()?;
        let pass = recorded::Pass { fused, resnet: &self.resnet, parameters, scale_offset, update };
        match self.recordings.borrow_mut().forward(&pass, kept) {
            Some((visual, begun)) => {
                Some((visual, Box::new(move |gradient: &Tensor| self.recordings.borrow().backward(begun, gradient))))
            }
            None => self.forward_fused(parameters, kept, scale_offset),
        }
    }
}
