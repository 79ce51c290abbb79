//! A received sample, as the collector holds it.

use crate::service::Borrowed;
use crate::wire::Observations;
use learner::collector::HalfSample;
use proto::camera::{DepthFrame, FRAME_PIXELS};
use wire::message::Line;

static FRAME: [u16; FRAME_PIXELS] = [0; FRAME_PIXELS];

/// It holds its place in the actor's channel until it is dropped.
#[derive(Debug)]
pub struct Sample(pub Borrowed<Observations>);

impl HalfSample for Sample {
    fn len(&self) -> usize {
        self.0.value.1.len()
    }
    fn record(&self, i: usize) -> &[u8] {
        Line::bytes(&self.0.value.1[i])
    }
    fn has_frame(&self, _i: usize) -> bool {
        true
    }
    fn frame(&self, _i: usize) -> Option<DepthFrame<'_>> {
        Some(DepthFrame::Whole(&FRAME))
    }
    fn images(&self, _i: usize) -> impl Iterator<Item = &[u8]> {
        std::iter::empty()
    }
}
