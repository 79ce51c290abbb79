//! Passes of training as CUDA graphs. Given to a GPU kernel by kernel, a pass over a small minibatch takes the CPU longer
//! than the GPU, and beside actors on the same cores one over a large minibatch does, too; a graph is one launch.
//!
//! What an encoder computes depends on the number of frames alone, so two graphs do for all passes over as many: the
//! forward pass, and the backward pass, between which autograd does the rest of the network. They launch the kernels that
//! the other way launches, in the same order, so no bit depends on whether, or when, a pass was recorded.

use super::super::visual::Gradients;
use super::fused::Fused;
use super::plain::Resnet;
use crate::ffi::graph::{Graph, GraphError, Memory, Recorder};
use crate::ffi::stream::Priority;
use crate::network::parameters::Parameters;
use crate::sizes::{Due, Sizes};
use std::collections::BTreeMap;
use tch::Tensor;

#[derive(Debug, Clone, Copy)]
pub(super) struct Pass<'a> {
    pub fused: &'a Fused,
    pub resnet: &'a Resnet,
    pub parameters: &'a Parameters,
    /// See [`Fused::forward`].
    pub scale_offset: [f32; 2],
    /// Tells updates apart.
    pub update: u64,
}

/// The recorded passes, by number of frames.
#[derive(Debug, Default)]
pub(super) struct Recordings {
    recorder: Option<Recorder>,
    recorded: BTreeMap<i64, Recorded>,
    /// Which are to be. A size is recorded after it has come kernel by kernel: libraries choose algorithms and allocate at
    /// first use, which a recording does not allow.
    sizes: Sizes,
    launched: u64,
    /// Something could not be recorded.
    refused: bool,
}

/// A forward pass that was launched, for its backward pass.
#[derive(Debug, Clone, Copy)]
pub(super) struct Begun {
    frames: i64,
    number: u64,
}

/// Both graphs, with what they read and write.
#[derive(Debug)]
struct Recorded {
    forward: Graph,
    backward: Graph,
    /// Read by the forward pass.
    kept: Tensor,
    /// Written by it.
    visual: Tensor,
    /// Read by the backward pass.
    d_visual: Tensor,
    /// Written by it.
    gradients: Gradients,
}

impl Recordings {
    /// The visual embedding of these frames, and what [`Recordings::backward`] needs to go on; none where the pass is not
    /// recorded.
    pub(super) fn forward(&mut self, pass: &Pass, kept: &Tensor) -> Option<(Tensor, Begun)> {
        let frames = kept.size()[0];
        if !self.refused
            && let Some(due) = self.sizes.count(frames, pass.update)
        {
            match pass.fused.while_recorded(|| self.record(pass, kept, due)) {
                Ok(recorded) => {
                    self.recorded.insert(frames, recorded);
                }
                Err(error) => {
                    tracing::warn!("training launches its kernels one by one, which takes longer: {error}");
                    self.refused = true;
                }
            }
        }
        let Recorded { forward, kept: place, visual, .. } = self.recorded.get_mut(&frames)?;
        place.copy_(kept);
        launch(forward);
        self.launched += 1;
        Some((visual.detach(), Begun { frames, number: self.launched }))
    }

    /// Gradients of all of the encoder's parameters for that of the embedding. They hold until the next pass. Panics if
    /// another forward pass has begun since: its numbers lie where this one's did.
    pub(super) fn backward(&self, begun: Begun, gradient: &Tensor) -> Gradients {
        assert_eq!(begun.number, self.launched, "a pass is over before the next one begins");
        let Recorded { backward, d_visual, gradients, .. } = &self.recorded[&begun.frames];
        tch::no_grad(|| d_visual.shallow_clone().copy_(gradient));
        launch(backward);
        gradients.iter().map(|(id, gradient)| (*id, gradient.shallow_clone())).collect()
    }

    fn record(&mut self, pass: &Pass, kept: &Tensor, due: Due) -> Result<Recorded, GraphError> {
        let Pass { fused, resnet, parameters, scale_offset, update: _ } = *pass;
        // A graph's kernels have the priority of the stream that they were recorded on: acting goes first.
        let recorder = match &mut self.recorder {
            Some(recorder) => recorder,
            none => none.insert(Recorder::open(Priority::Low, Memory::Shared)?),
        };
        if let Some(dropped) = due.in_place_of {
            // Its last launch may still run. What it has of the shared memory is free for the new recording.
            recorder.wait()?;
            self.recorded.remove(&dropped);
        }
        let kept = kept.copy();
        let (forward, (visual, tape)) = recorder.record(0, || {
            fused.renew(resnet, parameters);
            Ok(fused.forward(resnet, parameters, &kept, scale_offset))
        })?;
        let d_visual = visual.zeros_like();
        let mut tape = Some(tape);
        let (backward, gradients) = recorder.record(0, || {
            let tape = tape.take().expect("recorded at the first call, without warm-ups");
            Ok(fused.backward(resnet, parameters, tape, &d_visual, scale_offset))
        })?;
        Ok(Recorded { forward, backward, kept, visual, d_visual, gradients })
    }
}

fn launch(graph: &Graph) {
    // As in tch: a device that fails in the middle of a pass ends the process.
    graph.replay().unwrap_or_else(|error| panic!("{error}"));
}

#[cfg(test)]
mod tests {
    use super::super::{Backward, PATH, ResnetEncoder, VisualEncoder};
    use super::*;
    use crate::network::{Layout, to_vec};
    use std::cell::RefCell;
    use tch::{Device, Kind};

    const SIDE: i64 = 112;

    /// An encoder with kernels, and weights for it.
    fn encoder() -> (ResnetEncoder, Parameters) {
        let mut layout = Layout::default();
        let mut encoder = ResnetEncoder {
            resnet: Resnet::new(&mut layout, PATH, SIDE),
            side: SIDE,
            fused: None,
            recordings: RefCell::default(),
        };
        let parameters = Parameters::new(layout, 3, Device::Cuda(0));
        encoder.fuse().unwrap();
        (encoder, parameters)
    }

    /// Makes each pass as it is made in training and kernel by kernel, under weights that change between two passes, and
    /// compares them bit for bit. `updates`: the sizes of each update's passes. Returns how many passes were recorded
    /// ones, and which sizes are recorded at the end.
    fn compare(updates: &[&[i64]]) -> (usize, Vec<i64>) {
        let (encoder, parameters) = encoder();
        tch::manual_seed(7);
        let float = (Kind::Float, Device::Cuda(0));
        let mut launched = 0;
        let passes = (0..).zip(updates).flat_map(|(update, sizes)| sizes.iter().map(move |&frames| (update, frames)));
        for (update, frames) in passes {
            let kept = Tensor::rand([frames, SIDE, SIDE], float) * 4000.0;
            let gradient = Tensor::randn([frames, 512], float);
            let pass = |(visual, backward): (Tensor, Backward)| (visual.copy(), backward(&gradient));
            let scale_offset = [0.001, -1.0];
            let (visual, gradients) = pass(encoder.forward_to_train(&parameters, &kept, scale_offset, update).unwrap());
            let (expected, all_expected) = pass(encoder.forward_fused(&parameters, &kept, scale_offset).unwrap());
            assert!(visual.equal(&expected), "the embedding of {frames} frames in update {update}");
            assert_eq!(gradients.len(), all_expected.len());
            for ((id, gradient), (expected_id, expected)) in gradients.iter().zip(&all_expected) {
                assert!(id == expected_id && gradient.equal(expected), "{id:?} of {frames} frames in update {update}");
                assert!(to_vec(gradient).iter().any(|&number| number != 0.0), "{id:?} has a gradient");
            }
            launched += usize::from(encoder.recordings.borrow().recorded.contains_key(&frames));
            tch::no_grad(|| {
                let _ = parameters.flat().g_mul_scalar_(1.01);
            });
        }
        let recordings = encoder.recordings.borrow();
        assert_eq!(recordings.launched, launched as u64, "what is recorded is launched");
        (launched, recordings.recorded.keys().copied().collect())
    }

    /// Also while others share the memory that a dropped one had.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn a_pass_recorded_in_place_of_another_is_the_pass() {
        let _alone = crate::device::cuda_alone();
        let (all, new) = ([38, 19, 20, 21], [38, 24, 19]);
        // 24 comes in place of 20, as 38 and 19 are in use; then 20 in place of 21.
        let (launched, recorded) = compare(&[&all, &all, &new, &new, &new, &[20, 38, 24, 19], &new]);
        assert_eq!((launched, recorded), (19, vec![19, 20, 24, 38]));
    }

    /// What renews the rounded weights was recorded, and is never launched.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn after_a_recording_that_failed_a_pass_has_the_weights_of_now() {
        let _alone = crate::device::cuda_alone();
        let (encoder, parameters) = encoder();
        let kept = Tensor::rand([19, SIDE, SIDE], (Kind::Float, Device::Cuda(0))) * 4000.0;
        let pass = |encoder: &ResnetEncoder| encoder.forward_fused(&parameters, &kept, [0.001, -1.0]).unwrap().0.copy();
        let before = pass(&encoder);
        tch::no_grad(|| {
            let _ = parameters.flat().g_mul_scalar_(1.01);
        });
        let fused = encoder.fused.as_ref().unwrap();
        let recorder = Recorder::open(Priority::Low, Memory::Apart).unwrap();
        let failed = fused.while_recorded(|| {
            recorder.record(0, || {
                fused.renew(&encoder.resnet, &parameters);
                Err::<(), GraphError>(GraphError::Operation("it was asked to".to_owned()))
            })
        });
        assert!(failed.is_err());
        let (fresh, _) = self::encoder();
        let expected = pass(&fresh);
        assert!(!expected.equal(&before), "the weights make a difference");
        assert!(pass(&encoder).equal(&expected));
    }
}
