//! How records lie in a file: their heads, and the lengths inside them.
//!
//! All lengths of a record are checked here before `mcap`'s parser is given it. In version 0.26.0 that parser panics on
//! an attachment of fewer than four bytes after its header (`parse_record` in its module `read`, line 176: `body.len() - 4`), and it
//! makes room for what a text's length claims.

use crate::source::{Source, peek};
use mcap::records::op;
use std::io::Result;

/// The bytes that a file begins and ends with.
pub const END_MARK: [u8; 8] = *b"\x89MCAP0\r\n";
/// Opcode and length of a record, bytes.
pub const HEAD_BYTES: u64 = 9;
/// The first opcode that is not the format's: those are for applications.
pub const PRIVATE: u8 = 0x80;
/// Channel, sequence and two times of a message, bytes.
const MESSAGE_HEAD_BYTES: u64 = 22;
/// Two times, size and checksum of a chunk, bytes: the name of the compression is next.
const CHUNK_HEAD_BYTES: u64 = 28;

/// A record's place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// Where its opcode is.
    pub offset: u64,
    /// What kind it is.
    pub opcode: u8,
    /// Bytes after its head, as it says itself.
    pub length: u64,
}

impl Frame {
    /// The head at `offset`; none where the source is too short for one.
    pub fn at(source: &impl Source, offset: u64) -> Result<Option<Self>> {
        Ok(peek(source, offset)?.map(|head| Self::new(offset, head)))
    }

    /// The same where what follows is read next.
    pub fn next(source: &impl Source, offset: u64) -> Result<Option<Self>> {
        let mut head = [0; HEAD_BYTES as usize];
        if source.length() - offset < HEAD_BYTES {
            return Ok(None);
        }
        source.read(offset, &mut head)?;
        Ok(Some(Self::new(offset, head)))
    }

    fn new(offset: u64, [opcode, length @ ..]: [u8; HEAD_BYTES as usize]) -> Self {
        Self { offset, opcode, length: u64::from_le_bytes(length) }
    }

    pub fn content(self) -> u64 {
        self.offset + HEAD_BYTES
    }

    /// Where it ends, if that is inside a source of `length` bytes.
    pub fn end(self, length: u64) -> Option<u64> {
        self.content().checked_add(self.length).filter(|end| *end <= length)
    }
}

/// How the lengths inside a record fit its own length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// They fill it.
    Exact,
    /// They leave bytes over: a later version of the format may have added a field.
    Longer,
    /// They do not fit.
    Wrong,
}

/// Looks at the lengths of a record of this kind that lies at `start..end`; of strings inside a map only the sum.
pub fn shape(source: &impl Source, opcode: u8, start: u64, end: u64) -> Result<Shape> {
    let mut walk = Walk { source, at: start, end, fits: true };
    match opcode {
        op::HEADER | op::METADATA => walk.texts(2)?,
        op::FOOTER => walk.skip(20),
        op::SCHEMA => {
            walk.skip(2);
            walk.texts(3)?;
        }
        op::CHANNEL => {
            walk.skip(4);
            walk.texts(3)?;
        }
        op::MESSAGE => {
            walk.skip(MESSAGE_HEAD_BYTES);
            walk.rest();
        }
        op::CHUNK => {
            walk.skip(CHUNK_HEAD_BYTES);
            walk.texts(1)?;
            walk.long()?;
        }
        op::MESSAGE_INDEX => {
            walk.skip(2);
            walk.entries(16)?;
        }
        op::CHUNK_INDEX => {
            walk.skip(32);
            walk.entries(10)?;
            walk.skip(8);
            walk.texts(1)?;
            walk.skip(16);
        }
        op::ATTACHMENT => {
            walk.skip(16);
            walk.texts(2)?;
            walk.long()?;
            walk.skip(4);
        }
        op::ATTACHMENT_INDEX => {
            walk.skip(40);
            walk.texts(2)?;
        }
        op::STATISTICS => {
            walk.skip(42);
            walk.entries(10)?;
        }
        op::METADATA_INDEX => {
            walk.skip(16);
            walk.texts(1)?;
        }
        op::SUMMARY_OFFSET => walk.skip(17),
        op::DATA_END => walk.skip(4),
        PRIVATE.. => walk.rest(),
        _ => walk.fits = false,
    }
    Ok(match (walk.fits, walk.at == end) {
        (false, _) => Shape::Wrong,
        (true, true) => Shape::Exact,
        (true, false) => Shape::Longer,
    })
}

/// Goes over the fields of a record.
struct Walk<'a, S> {
    source: &'a S,
    at: u64,
    end: u64,
    fits: bool,
}

impl<S: Source> Walk<'_, S> {
    fn skip(&mut self, bytes: u64) {
        match self.at.checked_add(bytes).filter(|at| *at <= self.end) {
            Some(at) if self.fits => self.at = at,
            _ => self.fits = false,
        }
    }

    fn rest(&mut self) {
        if self.fits {
            self.at = self.end;
        }
    }

    fn number(&mut self) -> Result<u64> {
        let at = self.at;
        self.skip(4);
        if !self.fits {
            return Ok(0);
        }
        Ok(peek(self.source, at)?.map_or(0, |bytes| u32::from_le_bytes(bytes).into()))
    }

    /// Texts, byte strings or maps, with four bytes of length each.
    fn texts(&mut self, count: u32) -> Result<()> {
        for _ in 0..count {
            let length = self.number()?;
            self.skip(length);
        }
        Ok(())
    }

    /// Bytes with eight bytes of length.
    fn long(&mut self) -> Result<()> {
        let at = self.at;
        self.skip(8);
        if self.fits {
            let length = peek(self.source, at)?.map_or(0, u64::from_le_bytes);
            self.skip(length);
        }
        Ok(())
    }

    /// A list of entries of this size, with its length in bytes.
    fn entries(&mut self, size: u64) -> Result<()> {
        let length = self.number()?;
        self.fits &= length % size == 0;
        self.skip(length);
        Ok(())
    }
}

/// Whether all strings of the map in this record's content lie in it. Records without such a map have none outside.
pub fn map_fits(opcode: u8, content: &[u8]) -> bool {
    let (fixed, before) = match opcode {
        op::CHANNEL => (4, 2),
        op::METADATA => (0, 1),
        _ => return true,
    };
    let Some(mut rest) = content.get(fixed..) else { return false };
    for _ in 0..before {
        let Some((_, after)) = text(rest) else { return false };
        rest = after;
    }
    let Some((mut map, _)) = text(rest) else { return false };
    while !map.is_empty() {
        let Some((_, after)) = text(map) else { return false };
        map = after;
    }
    true
}

/// The bytes of a text and what comes after it.
fn text(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

/// The next place from `from` on, before `before`, where a record of one of the format's kinds begins that `good`
/// takes. Every byte is looked at once.
pub fn next_frame(
    source: &impl Source,
    from: u64,
    before: u64,
    mut good: impl FnMut(Frame) -> Result<bool>,
) -> Result<Option<Frame>> {
    const BLOCK: u64 = 64 << 10;
    let mut block = Vec::new();
    let mut start = from;
    while start + HEAD_BYTES <= before {
        // Heads may begin up to the block's end: eight bytes more are read.
        let length = (BLOCK + HEAD_BYTES - 1).min(before - start);
        block.resize(length as usize, 0);
        source.peek(start, &mut block)?;
        for (index, head) in block.windows(HEAD_BYTES as usize).enumerate() {
            // Most bytes are ruled out by this: the opcode is known, and no record has 2⁴⁰ bytes.
            if !(1..=op::DATA_END).contains(&head[0]) || head[6..] != [0, 0, 0] {
                continue;
            }
            let Ok(head) = head.try_into() else { continue };
            let frame = Frame::new(start + index as u64, head);
            if frame.end(source.length()).is_some() && good(frame)? {
                return Ok(Some(frame));
            }
        }
        start += length + 1 - HEAD_BYTES;
    }
    Ok(None)
}
