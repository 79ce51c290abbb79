//! Where everything lies in a record: a header that is the engine's, then the task's bytes.
//!
//! ```text
//! header                 64 bytes, the same for all tasks
//! action, last action    as the action space wants
//! parts, outcomes        of the last action, in the declaration's order, each aligned to its type
//! observations, …        what is seen now, likewise, from a multiple of 8 on
//! observations, …        what was seen last of an episode that the limit of steps has ended; not in a task with images
//! snapshot               of a task that is restored by such, from a multiple of 8 on
//! images                 each from a cache line on; the sums of their windows behind them
//! ```

use super::actions::Actions;
use super::channel::{Channel, Dtype};
use super::restore::Restore;
use crate::record::RecordHeader;
use bytemuck::{AnyBitPattern, Pod};
use std::ops::Range;

/// Bytes of a cache line. Records and images begin on one.
pub const LINE_BYTES: usize = 64;
pub const HEADER_BYTES: usize = size_of::<RecordHeader>();

/// The count before a snapshot's bytes.
const SNAPSHOT_HEAD_BYTES: usize = size_of::<u32>();

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// From the record's beginning, bytes.
    pub offset: usize,
    pub dtype: Dtype,
    pub count: usize,
}

impl Field {
    pub fn range(self) -> Range<usize> {
        self.offset..self.offset + self.count * self.dtype.bytes()
    }

    /// Its first number. Panics if the record is shorter than its layout.
    pub fn number(self, record: &[u8]) -> f64 {
        self.dtype.read(&record[self.offset..])
    }

    pub fn numbers(self, record: &[u8]) -> impl Iterator<Item = f64> {
        record[self.range()].chunks_exact(self.dtype.bytes()).map(move |bytes| self.dtype.read(bytes))
    }

    /// The bits of its numbers: [`Dtype::bits`].
    pub fn bits(self, record: &[u8]) -> impl ExactSizeIterator<Item = u64> {
        record[self.range()].chunks_exact(self.dtype.bytes()).map(move |bytes| self.dtype.bits(bytes))
    }

    /// Its numbers as they lie, of a record that begins on a cache line. Panics if they are of another type, or the
    /// record is shorter than its layout.
    pub fn of<T: AnyBitPattern>(self, record: &[u8]) -> &[T] {
        bytemuck::cast_slice(&record[self.range()])
    }

    /// The same, to be written. Panics as [`Self::of`] does.
    pub fn of_mut<T: Pod>(self, record: &mut [u8]) -> &mut [T] {
        bytemuck::cast_slice_mut(&mut record[self.range()])
    }

    /// Its first number, of a channel of `f32`.
    pub fn f32(self, record: &[u8]) -> f32 {
        debug_assert_eq!(self.dtype, Dtype::F32);
        f32::from_ne_bytes(record[self.offset..self.offset + 4].try_into().expect("four bytes"))
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// The last action, and the action before what is seen now. Both typed as the action space says.
    pub action: Field,
    pub previous_action: Field,
    /// What the last action did: parts and outcomes. Meaningless where none was taken.
    pub of_action: Range<usize>,
    /// What is seen now, but for images.
    pub seen: Range<usize>,
    /// The same as it was seen last of an episode that was truncated with the last action, all 0 otherwise: the next
    /// one begins in the same record, and a truncated episode has a value to come. Empty in a task with images, which
    /// would double.
    pub last_seen: Range<usize>,
    /// What brings the environment back to what is seen now: how many bytes, a `u32`, then those, then zeros. Empty of a
    /// task that needs none.
    pub snapshot: Range<usize>,
    /// Place of each channel, in the declaration's order.
    pub fields: Vec<Field>,
    /// Images, and the sums of their windows: each can be there or not.
    pub images: Vec<Field>,
    /// What is copied and checked on arrival: all but images. A multiple of [`LINE_BYTES`].
    pub small_bytes: usize,
    /// A whole record. A multiple of [`LINE_BYTES`].
    pub bytes: usize,
}

impl Layout {
    /// Where a field of what is seen now lies among what was seen last; none in a task with images.
    pub(super) fn last(&self, field: Field) -> Option<Field> {
        let moved = Field { offset: field.offset + self.last_seen.start - self.seen.start, ..field };
        (!self.last_seen.is_empty()).then_some(moved)
    }

    /// The part of rewards that is this channel's, by its index. Panics if there is no such channel.
    pub fn part(&self, record: &[u8], index: usize) -> f32 {
        self.fields[index].f32(record)
    }

    /// The snapshot in a record; empty where the task has none, or the record none that could be.
    pub fn snapshot_in<'a>(&self, record: &'a [u8]) -> &'a [u8] {
        let Some((count, bytes)) = record[self.snapshot.clone()].split_first_chunk() else { return &[] };
        bytes.get(..u32::from_le_bytes(*count) as usize).unwrap_or_default()
    }

    /// Writes a snapshot into a record; false if it is longer than declared.
    pub fn write_snapshot(&self, snapshot: &[u8], record: &mut [u8]) -> bool {
        let room = &mut record[self.snapshot.clone()];
        let end = SNAPSHOT_HEAD_BYTES + snapshot.len();
        if room.len() < end {
            return false;
        }
        room[..SNAPSHOT_HEAD_BYTES].copy_from_slice(&(snapshot.len() as u32).to_le_bytes());
        room[SNAPSHOT_HEAD_BYTES..end].copy_from_slice(snapshot);
        room[end..].fill(0);
        true
    }

    pub(super) fn of(actions: &Actions, channels: &[Channel], restore: Restore) -> Self {
        let mut end = HEADER_BYTES;
        let mut place = |dtype: Dtype, count: usize, alignment: usize| {
            let field = Field { offset: end.next_multiple_of(alignment), dtype, count };
            end = field.range().end;
            field
        };
        let (dtype, count) = actions.numbers();
        let action = place(dtype, count, dtype.bytes());
        let previous_action = place(dtype, count, dtype.bytes());
        let mut fields = vec![action; channels.len()];
        let mut block = |of_action: bool, place: &mut dyn FnMut(Dtype, usize, usize) -> Field| {
            let wanted = |channel: &Channel| !channel.is_bulk() && channel.is_of_action() == of_action;
            let start = place(Dtype::U8, 0, 8).offset;
            for (channel, field) in channels.iter().zip(&mut fields).filter(|(channel, _)| wanted(channel)) {
                *field = place(channel.dtype, channel.count(), channel.dtype.bytes());
            }
            start..place(Dtype::U8, 0, 8).offset
        };
        let of_action = block(true, &mut place);
        let seen = block(false, &mut place);
        let again = if channels.iter().any(Channel::is_bulk) { 0 } else { seen.len() };
        let last_seen = place(Dtype::U8, again, 8).range();
        let snapshot = match restore {
            Restore::Snapshot { bytes } => place(Dtype::U8, SNAPSHOT_HEAD_BYTES + bytes as usize, 8).range(),
            Restore::Replay | Restore::None => 0..0,
        };
        let small_bytes = place(Dtype::U8, 0, LINE_BYTES).offset;
        let mut images = vec![];
        for (channel, field) in channels.iter().zip(&mut fields).filter(|(channel, _)| channel.is_bulk()) {
            *field = place(channel.dtype, channel.count(), LINE_BYTES);
            images.push(*field);
            if let Some(side) = channel.sums {
                images.push(place(channel.dtype, channel.count() / (side * side), LINE_BYTES));
            }
        }
        let bytes = place(Dtype::U8, 0, LINE_BYTES).offset;
        Self { action, previous_action, of_action, seen, last_seen, snapshot, fields, images, small_bytes, bytes }
    }
}
