//! Images among the observations, but for the frame of kitchens, which has an encoder of its own.

use super::channel::{Channel, Dtype};
use super::layout::Field;
use std::ops::{Range, RangeInclusive};

/// Pixels of an image each way; the convolutions leave nothing of a smaller one.
const SIDES: RangeInclusive<usize> = 36..=512;
/// Most channels of an image. Its sides are longer, so its shape shows which dimension holds the channels.
const CHANNELS_MOST: usize = 12;
/// Each image of a row begins on a multiple of this: the largest of their numbers.
const ALIGNMENT_BYTES: usize = 4;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    pub name: String,
    pub field: Field,
    /// Where its bytes begin in a row of all images, which networks are given.
    pub begin: usize,
    pub channels: usize,
    pub height: usize,
    pub width: usize,
    /// Whether a pixel's channels lie side by side: \[height, width, channels\].
    pub channels_last: bool,
}

impl Image {
    /// The image that a channel is, if it is one, at the beginning of a row.
    pub(super) fn of(channel: &Channel, field: Field) -> Option<Self> {
        // A matrix of `f32` may be anything.
        let may_be = channel.is_bulk() || channel.dtype == Dtype::F32 && channel.shape.len() == 3;
        let (channels, sides, channels_last) = match channel.shape[..] {
            [height, width] => (1, [height, width], false),
            [channels, height, width] if channels <= CHANNELS_MOST => (channels, [height, width], false),
            [height, width, channels] if channels <= CHANNELS_MOST => (channels, [height, width], true),
            _ => return None,
        };
        let [height, width] = sides;
        let is_one = may_be && sides.iter().all(|side| SIDES.contains(side));
        is_one.then(|| Self { name: channel.name.clone(), field, begin: 0, channels, height, width, channels_last })
    }

    pub fn bytes(&self) -> Range<usize> {
        self.begin..self.begin + self.field.range().len()
    }

    /// Where the next image of the row begins.
    pub(super) fn end(&self) -> usize {
        self.bytes().end.next_multiple_of(ALIGNMENT_BYTES)
    }

    /// Its dimensions, as it was declared with three.
    pub fn shape(&self) -> [usize; 3] {
        let Self { channels, height, width, channels_last, .. } = *self;
        if channels_last { [height, width, channels] } else { [channels, height, width] }
    }
}
