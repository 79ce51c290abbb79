//! How records lie in a file: their heads, and the lengths inside them.
//!
//! All lengths of a record are checked here before `mcap`'s parser is given it. In version 0.26.0 that parser panics on
//! an attachment of fewer than four bytes after its header (`parse_record` in its module `read`, line 176:
//! `body.len() - 4`), and it makes room for what a text's length claims.

use crate::source::Source;
use mcap::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::io::Result;

/// Larger records, and chunks with more in them, are not read.
const RECORD_MAX: u64 = 256 << 20;
/// Bytes before a record's content: its kind and its length.
const HEAD_BYTES: u64 = 9;
/// The first opcode that is not the format's: those are for applications.
const PRIVATE: u8 = 0x80;

#[derive(Debug, Clone, Copy)]
pub struct Frame {
    pub offset: u64,
    pub opcode: u8,
    pub end: u64,
}

impl Frame {
    pub fn content(self, source: &dyn Source) -> Result<Vec<u8>> {
        source.bytes(self.offset + HEAD_BYTES..self.end)
    }
}

#[derive(Debug, Clone, Copy)]
pub enum Next {
    Record(Frame),
    /// The file ends here, or in this record.
    Cut,
    Damaged,
}

/// The head of the record that begins at `offset`.
pub fn next(source: &dyn Source, offset: u64) -> Result<Next> {
    let content = offset + HEAD_BYTES;
    if content > source.length() {
        return Ok(Next::Cut);
    }
    let head = source.bytes(offset..content)?;
    let length = u64::from_le_bytes(std::array::from_fn(|at| head[at + 1]));
    Ok(match head[0] {
        0 => Next::Damaged,
        _ if length > RECORD_MAX => Next::Damaged,
        _ if content + length > source.length() => Next::Cut,
        opcode => Next::Record(Frame { offset, opcode, end: content + length }),
    })
}

#[derive(Debug, Clone, Copy)]
enum Field {
    Bytes(usize),
    /// Four bytes of length, and so many bytes.
    Text,
    /// The same with texts in it: keys and values.
    Map,
    /// Eight bytes of length, and so many bytes.
    Long,
}

/// The fields of the records that are read, before what may be of any length.
fn fields(opcode: u8) -> &'static [Field] {
    use Field::{Bytes, Long, Map, Text};
    match opcode {
        op::HEADER => &[Text, Text],
        op::SCHEMA => &[Bytes(2), Text, Text, Text],
        op::CHANNEL => &[Bytes(4), Text, Text, Map],
        op::MESSAGE => &[Bytes(22)],
        op::CHUNK => &[Bytes(28), Text, Long],
        op::ATTACHMENT => &[Bytes(16), Text, Text, Long, Bytes(4)],
        op::STATISTICS => &[Bytes(42), Text],
        op::METADATA => &[Text, Map],
        op::DATA_END => &[Bytes(4)],
        _ => &[],
    }
}

/// What follows these fields; none if their lengths do not fit.
fn rest<'a>(fields: &[Field], mut content: &'a [u8]) -> Option<&'a [u8]> {
    for field in fields {
        let (length, after) = match field {
            Field::Bytes(count) => (*count, content),
            Field::Text | Field::Map => {
                let (length, after) = content.split_first_chunk()?;
                (u32::from_le_bytes(*length) as usize, after)
            }
            Field::Long => {
                let (length, after) = content.split_first_chunk()?;
                (usize::try_from(u64::from_le_bytes(*length)).ok()?, after)
            }
        };
        let (mut inside, after) = after.split_at_checked(length)?;
        while matches!(field, Field::Map) && !inside.is_empty() {
            inside = rest(&[Field::Text, Field::Text], inside)?;
        }
        content = after;
    }
    Some(content)
}

/// The record with this content, if all lengths in it fit and its checksum agrees.
pub fn parse(opcode: u8, content: &[u8]) -> Option<Record<'_>> {
    rest(fields(opcode), content)?;
    parse_record(opcode, content).ok()
}

/// Takes every record of a chunk; none if its content is not what its checksum says. No room is made for what a damaged
/// length claims.
pub fn each_record(chunk: &[u8], mut take: impl FnMut(Record<'_>)) -> Option<()> {
    let Some(Record::Chunk { header, .. }) = parse(op::CHUNK, chunk) else { return None };
    if header.uncompressed_size > RECORD_MAX {
        return None;
    }
    let options = LinearReaderOptions::default().with_skip_start_magic(true).with_skip_end_magic(true);
    let options = options.with_prevalidate_chunk_crcs(true).with_record_length_limit(RECORD_MAX as usize);
    let mut reader = LinearReader::new_with_options(options);
    let mut head = vec![op::CHUNK];
    head.extend((chunk.len() as u64).to_le_bytes());
    let mut pieces = [head.as_slice(), chunk].into_iter();
    let mut piece = pieces.next().unwrap_or_default();
    while let Some(event) = reader.next_event() {
        match event.ok()? {
            LinearReadEvent::ReadRequest(wanted) => {
                if piece.is_empty() {
                    piece = pieces.next().unwrap_or_default();
                }
                let (now, later) = piece.split_at(wanted.min(piece.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                piece = later;
            }
            LinearReadEvent::Record { data, opcode } => take(parse(opcode, data)?),
        }
    }
    Some(())
}

pub fn is_private(opcode: u8) -> bool {
    opcode >= PRIVATE
}
