//! Where a guest writes what an environment shows, channel by channel.

use proto::task::{Channel, Field, Layout, REWARD, Role, Spec};
use wire::message::Line;

/// A channel that an environment fills in.
#[derive(Debug, Clone)]
pub struct Source {
    pub channel: Channel,
    /// In its piece of a [`Record`].
    pub field: Field,
}

/// Where a guest writes: a record in two pieces, as images may lie elsewhere.
pub struct Record<'a> {
    small: &'a mut [u8],
    images: &'a mut [u8],
}

impl<'a> Record<'a> {
    /// Of a whole record, or one whose images are written `ahead`, into a record of the same layout.
    pub fn of(kept: &'a mut [Line], ahead: &'a mut [u8], layout: &Layout) -> Self {
        let (small, images) = Line::bytes_mut(kept).split_at_mut(layout.small_bytes);
        Self { small, images: if ahead.is_empty() { images } else { &mut ahead[layout.small_bytes..] } }
    }

    /// The piece that a channel's field is in.
    pub fn piece(&mut self, channel: &Channel) -> &mut [u8] {
        if channel.is_bulk() { self.images } else { self.small }
    }
}

impl Source {
    pub fn of(spec: &Spec, name: &str) -> Option<Self> {
        let (channel, mut field) = spec.channel(name)?;
        if channel.is_bulk() {
            field.offset -= spec.layout().small_bytes;
        }
        Some(Self { channel: channel.clone(), field })
    }

    /// What a step reports beside observations and the reward.
    pub fn reported(spec: &Spec) -> Vec<Self> {
        let is_reported = |channel: &&Channel| channel.role != Role::Observation && channel.name != REWARD;
        spec.channels.iter().filter(is_reported).filter_map(|channel| Self::of(spec, &channel.name)).collect()
    }

    pub fn reward(spec: &Spec) -> Option<Self> {
        Self::of(spec, REWARD)
    }
}
