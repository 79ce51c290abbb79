//! How records lie in a file: their heads, and the lengths inside them.
//!
//! All lengths of a record are checked here before `mcap`'s parser is given it. In version 0.26.0 that parser panics on
//! an attachment of fewer than four bytes after its header (`parse_record` in its module `read`, line 176:
//! `body.len() - 4`), and it makes room for what a text's length claims.

use crate::source::{Source, peek};
use mcap::parse_record;
use mcap::records::{Record, op};
use std::io::Result;
use std::ops::Range;

pub const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
const HEAD_BYTES: u64 = 9;
/// The first opcode that is not the format's: those are for applications.
pub const PRIVATE: u8 = 0x80;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    pub offset: u64,
    pub opcode: u8,
    pub length: u64,
}

#[derive(Debug, Clone, Copy)]
enum Field {
    Bytes(u64),
    /// Four bytes of length, and so many bytes.
    Text,
    /// The same with texts in it: keys and values.
    Map,
    /// The same with entries of this size in it.
    Entries(u64),
    /// Eight bytes of length, and so many bytes.
    Long,
    Rest,
}

/// The fields of a record; none for a kind that the format does not have.
fn fields(opcode: u8) -> Option<&'static [Field]> {
    use Field::{Bytes, Entries, Long, Map, Rest, Text};
    Some(match opcode {
        op::HEADER => &[Text, Text],
        op::FOOTER => &[Bytes(20)],
        op::SCHEMA => &[Bytes(2), Text, Text, Text],
        op::CHANNEL => &[Bytes(4), Text, Text, Map],
        op::MESSAGE => &[Bytes(22), Rest],
        op::CHUNK => &[Bytes(28), Text, Long],
        op::MESSAGE_INDEX => &[Bytes(2), Entries(16)],
        op::CHUNK_INDEX => &[Bytes(32), Entries(10), Bytes(8), Text, Bytes(16)],
        op::ATTACHMENT => &[Bytes(16), Text, Text, Long, Bytes(4)],
        op::ATTACHMENT_INDEX => &[Bytes(40), Text, Text],
        op::STATISTICS => &[Bytes(42), Entries(10)],
        op::METADATA => &[Text, Map],
        op::METADATA_INDEX => &[Bytes(16), Text],
        op::SUMMARY_OFFSET => &[Bytes(17)],
        op::DATA_END => &[Bytes(4)],
        PRIVATE.. => &[Rest],
        _ => return None,
    })
}

impl Frame {
    pub fn at(source: &dyn Source, offset: u64) -> Result<Option<Self>> {
        Ok(peek(source, offset)?.map(|head| Self::new(offset, head)))
    }

    fn new(offset: u64, [opcode, length @ ..]: [u8; HEAD_BYTES as usize]) -> Self {
        Self { offset, opcode, length: u64::from_le_bytes(length) }
    }

    pub fn content(self) -> u64 {
        self.offset + HEAD_BYTES
    }

    pub fn end(self) -> u64 {
        self.content().saturating_add(self.length)
    }

    /// How many bytes its fields leave over, if their lengths fit into it and it ends before `until`. A later version of
    /// the format may have added a field.
    pub fn rest(self, source: &dyn Source, until: u64) -> Result<Option<u64>> {
        if self.end() > until { Ok(None) } else { rest(source, self.opcode, self.content()..self.end(), false) }
    }
}

/// `inside_maps`: the texts in a map are looked at, too.
fn rest(source: &dyn Source, opcode: u8, content: Range<u64>, inside_maps: bool) -> Result<Option<u64>> {
    let Some(fields) = fields(opcode) else { return Ok(None) };
    let text = |at| -> Result<u64> {
        Ok(4 + peek(source, at)?.map_or(u64::from(u32::MAX), |length| u32::from_le_bytes(length).into()))
    };
    let mut at = content.start;
    for field in fields {
        let start = at;
        at = at.saturating_add(match field {
            Field::Bytes(count) => *count,
            Field::Text | Field::Map | Field::Entries(_) => text(at)?,
            Field::Long => peek(source, at)?.map_or(u64::MAX, u64::from_le_bytes).saturating_add(8),
            Field::Rest => content.end - at,
        });
        let fits = match field {
            _ if at > content.end => false,
            Field::Entries(size) => (at - start - 4).is_multiple_of(*size),
            Field::Map if inside_maps => {
                let mut pair = start + 4;
                while pair < at {
                    let value = pair + text(pair)?;
                    pair = value + text(value)?;
                }
                pair == at
            }
            _ => true,
        };
        if !fits {
            return Ok(None);
        }
    }
    Ok(Some(content.end - at))
}

/// Whether an attachment's checksum is that of its content; none where it was not calculated.
pub fn attachment_agrees(content: &[u8]) -> Option<bool> {
    let (body, sum) = content.split_last_chunk()?;
    let sum = Some(u32::from_le_bytes(*sum)).filter(|sum| *sum != 0)?;
    Some(sum == crc32fast::hash(body))
}

/// The record with this content, if all lengths in it fit. An attachment whose checksum does not agree is parsed, too:
/// its content may still be of use.
pub fn parse(opcode: u8, content: &[u8]) -> Option<Record<'_>> {
    rest(&content, opcode, 0..content.len() as u64, true).ok()??;
    if opcode == op::ATTACHMENT && attachment_agrees(content) == Some(false) {
        let unsummed = [content.split_last_chunk::<4>()?.0, &[0; 4]].concat();
        return Some(parse_record(opcode, &unsummed).ok()?.into_owned());
    }
    parse_record(opcode, content).ok()
}

/// The next head from `range.start` on, before `range.end`, that is one of the format's kinds and `good`. Every byte is
/// looked at once.
pub fn find_frame(
    source: &dyn Source,
    range: Range<u64>,
    mut good: impl FnMut(Frame) -> Result<bool>,
) -> Result<Option<Frame>> {
    const BLOCK_BYTES: u64 = 64 << 10;
    let mut start = range.start;
    while start < range.end {
        // Heads that begin in the block may reach beyond it.
        let block = source.bytes(start..(start + BLOCK_BYTES + HEAD_BYTES - 1).min(source.length()))?;
        // A sparse file may have terabytes of zeros.
        let block = if block.iter().fold(0, |all, byte| all | byte) == 0 { &[] } else { &*block };
        for (offset, head) in (start..range.end).zip(block.windows(HEAD_BYTES as usize)) {
            // Most bytes are ruled out by this: the opcode is known, and no record has 2⁴⁰ bytes.
            if !(1..=op::DATA_END).contains(&head[0]) || head[6..] != [0, 0, 0] {
                continue;
            }
            let Ok(head) = head.try_into() else { continue };
            let frame = Frame::new(offset, head);
            if good(frame)? {
                return Ok(Some(frame));
            }
        }
        start += BLOCK_BYTES;
    }
    Ok(None)
}

pub fn sum(source: &dyn Source, range: Range<u64>) -> Result<u32> {
    const BLOCK_BYTES: u64 = 256 << 10;
    let mut hasher = crc32fast::Hasher::new();
    for start in range.clone().step_by(BLOCK_BYTES as usize) {
        hasher.update(&source.bytes(start..range.end.min(start + BLOCK_BYTES))?);
    }
    Ok(hasher.finalize())
}
