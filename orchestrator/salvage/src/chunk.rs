//! Chunks: unpacked, checked, gone through, and compared with their indexes.

use crate::account::{Cost, Finding, Problem};
use crate::definitions::Schema;
use crate::last_chunk::LastChunk;
use crate::layout::{Frame, HEAD_BYTES, PRIVATE, Shape, map_fits, next_frame, shape};
use crate::source::{Source, peek};
use crate::state::{Reader, Stop, Trust};
use crate::unpack::{Unpacked, is_known, unpack};
use mcap::parse_record;
use mcap::records::{ChunkHeader, MessageIndex, Record, op};
use std::collections::HashMap;

/// Longest name of a compression that is looked at, bytes.
const COMPRESSION_NAME_MAX: u32 = 64;

/// What goes through a chunk has found.
#[derive(Debug, Default)]
struct Seen {
    count: u64,
    times_ns: Option<(u64, u64)>,
    messages: HashMap<u16, Vec<(u64, u64)>>,
    /// Bytes in which no record can be recognised.
    unreadable: bool,
    /// Kind and number of records that may not be in a chunk.
    misplaced: Option<(u8, u64)>,
}

/// Header and packed bytes of what begins as a chunk at `offset`; of its own sizes only the compressed one is used, and
/// it may reach beyond the source's end.
pub fn header_at(source: &impl Source, offset: u64) -> std::io::Result<Option<(ChunkHeader, u64)>> {
    let content = offset + HEAD_BYTES;
    let Some(head) = peek::<32>(source, content)? else { return Ok(None) };
    let long = |at: usize| head[at..at + 8].try_into().map_or(0, u64::from_le_bytes);
    let short = |at: usize| head[at..at + 4].try_into().map_or(0, u32::from_le_bytes);
    let name_length = short(28);
    if name_length > COMPRESSION_NAME_MAX || content + 32 + u64::from(name_length) > source.length() {
        return Ok(None);
    }
    let mut name = vec![0; name_length as usize];
    source.peek(content + 32, &mut name)?;
    let data = content + 32 + u64::from(name_length);
    let (Ok(compression), Some(size)) = (String::from_utf8(name), peek(source, data)?) else { return Ok(None) };
    let header = ChunkHeader {
        message_start_time: long(0),
        message_end_time: long(8),
        uncompressed_size: long(16),
        uncompressed_crc: short(24),
        compression,
        compressed_size: u64::from_le_bytes(size),
    };
    Ok(Some((header, data + 8)))
}

impl<S: Source> Reader<'_, S> {
    /// A chunk, or what there is of it: `complete` if its lengths agree.
    pub(crate) fn chunk_record(
        &mut self,
        offset: u64,
        end: u64,
        header: &ChunkHeader,
        (packed, complete): (&[u8], bool),
    ) -> Result<(), Stop> {
        let mut out = Vec::new();
        let limit = self.limits.chunk_bytes.min(self.budget);
        let unpacked = unpack(&header.compression, packed, limit, &mut out);
        self.budget = self.budget.saturating_sub((packed.len() + out.len()) as u64);
        self.ending.chunk_at(offset, end - offset);
        let sum_agrees = match header.uncompressed_crc {
            // It was not calculated.
            0 => complete,
            sum => sum == crc32fast::hash(&out),
        };
        let trust = if unpacked == Unpacked::Whole && sum_agrees { Trust::Sound } else { Trust::Doubtful };
        let seen = self.inside(offset, &out, header, trust)?;
        if header.uncompressed_crc == 0 {
            self.unchecked += seen.count;
        }
        let times_ns = (header.message_start_time, header.message_end_time);
        // Some writers leave both times 0.
        let times_agree = times_ns == (0, 0) || seen.times_ns.is_none_or(|seen| seen == times_ns);
        let header_agrees = times_agree && header.uncompressed_size == out.len() as u64;
        let problem = match unpacked {
            Unpacked::Unknown => Some((Problem::Compression(header.compression.clone()), Cost::Lost(None))),
            Unpacked::Limit => {
                let what = "what is in a chunk is bigger than is read, or all chunks together are";
                Some((Problem::Limit(what), Cost::Lost(None)))
            }
            Unpacked::Part => Some((Problem::ChunkPart, Cost::Lost(None))),
            Unpacked::Whole if !complete && !sum_agrees => Some((Problem::ChunkPart, Cost::Lost(None))),
            Unpacked::Whole if !complete => Some((Problem::Head("chunk"), Cost::Nothing)),
            Unpacked::Whole if !sum_agrees && seen.unreadable => Some((Problem::ChunkSum, Cost::Lost(None))),
            Unpacked::Whole if !sum_agrees => Some((Problem::ChunkSum, Cost::Doubt(seen.count))),
            Unpacked::Whole if seen.unreadable => Some((Problem::Unreadable, Cost::Lost(None))),
            Unpacked::Whole if !header_agrees => Some((Problem::ChunkHeader, Cost::Nothing)),
            Unpacked::Whole => None,
        };
        if let Some((opcode, _)) = seen.misplaced {
            self.finding(offset, end - offset, Problem::Misplaced(opcode), Cost::Nothing);
        }
        let times_ns = Some(times_ns).filter(|(from, to)| from <= to && *to != 0).or(seen.times_ns);
        let finding = problem.map(|(problem, cost)| Finding { offset, bytes: end - offset, problem, cost, times_ns });
        self.chunk = Some(LastChunk {
            offset,
            finding,
            seen: seen.count,
            messages: seen.messages,
            indexed: None,
            index_broken: false,
            complete,
        });
        Ok(())
    }

    /// What begins as a chunk at `offset` and reaches to `end` at most: as much as can be unpacked. False where it
    /// cannot be a chunk.
    pub(crate) fn part_of_chunk(&mut self, offset: u64, end: u64) -> Result<bool, Stop> {
        let Some((header, data)) = header_at(self.source, offset)? else { return Ok(false) };
        if !is_known(&header.compression) || data > end {
            return Ok(false);
        }
        let packed_end = data.saturating_add(header.compressed_size).min(end);
        let length = (packed_end - data).min(self.limits.record_bytes).min(self.budget);
        let mut packed = vec![0; length as usize];
        self.source.read(data, &mut packed)?;
        self.chunk_record(offset, end, &header, (&packed, false))?;
        Ok(true)
    }

    /// Whether what lies at `offset` is a chunk, whatever its head says: its checksum proves it. It is read then, and its
    /// end returned. `altered`: its head says something else.
    pub(crate) fn proven_chunk(&mut self, offset: u64, altered: bool) -> Result<Option<u64>, Stop> {
        let Some((header, data)) = header_at(self.source, offset)? else { return Ok(None) };
        let end = data.checked_add(header.compressed_size).filter(|end| *end <= self.source.length());
        let Some(end) = end.filter(|_| is_known(&header.compression) && header.uncompressed_crc != 0) else {
            return Ok(None);
        };
        if header.compressed_size.max(header.uncompressed_size) > self.limits.chunk_bytes.min(self.budget) {
            return Ok(None);
        }
        let mut packed = vec![0; header.compressed_size as usize];
        self.source.read(data, &mut packed)?;
        let mut out = Vec::new();
        let unpacked = unpack(&header.compression, &packed, header.uncompressed_size, &mut out);
        self.budget = self.budget.saturating_sub((packed.len() + out.len()) as u64);
        if unpacked != Unpacked::Whole || crc32fast::hash(&out) != header.uncompressed_crc {
            return Ok(None);
        }
        self.settle();
        if altered {
            self.finding(offset, HEAD_BYTES, Problem::Head("chunk"), Cost::Nothing);
        }
        self.chunk_record(offset, end, &header, (&packed, true))?;
        Ok(Some(end))
    }

    /// Whether the content at `start..end` is an index of the chunk before, whatever its head says.
    pub(crate) fn is_index(&mut self, start: u64, end: u64) -> Result<bool, Stop> {
        if self.chunk.is_none()
            || end - start > self.limits.record_bytes
            || shape(self.source, op::MESSAGE_INDEX, start, end)? != Shape::Exact
        {
            return Ok(false);
        }
        let mut content = vec![0; (end - start) as usize];
        self.source.read(start, &mut content)?;
        let Ok(Record::MessageIndex(index)) = parse_record(op::MESSAGE_INDEX, &content) else { return Ok(false) };
        let Some(chunk) = &mut self.chunk else { return Ok(false) };
        let is_index = !index.records.is_empty() && chunk.describes(&index);
        if is_index {
            *chunk.indexed.get_or_insert(0) += index.records.len() as u64;
        }
        Ok(is_index)
    }

    pub(crate) fn message_index(&mut self, offset: u64, end: u64, index: &MessageIndex) {
        self.ending.index_at(offset);
        let wrong = match &mut self.chunk {
            Some(chunk) => {
                *chunk.indexed.get_or_insert(0) += index.records.len() as u64;
                chunk.finding.is_none() && !chunk.describes(index)
            }
            None => true,
        };
        if wrong {
            if let Some(chunk) = &mut self.chunk {
                chunk.lose_index();
            }
            self.finding(offset, end - offset, Problem::Index, Cost::Nothing);
        }
    }

    /// The chunk before has no more indexes: what they tell of it is known.
    pub(crate) fn settle(&mut self) {
        let Some(chunk) = self.chunk.take() else { return };
        let missing = chunk.indexed.map(|indexed| indexed.saturating_sub(chunk.seen));
        match (chunk.finding, missing) {
            (Some(mut finding), missing) => {
                finding.cost = match (finding.cost, missing) {
                    (Cost::Lost(None), Some(_)) if chunk.index_broken || !chunk.complete => Cost::Lost(None),
                    (Cost::Lost(None), Some(0)) => Cost::Doubt(chunk.seen),
                    (_, Some(missing @ 1..)) => Cost::Lost(Some(missing)),
                    (cost, _) => cost,
                };
                self.account.add(finding);
            }
            (None, Some(_)) if chunk.indexed != Some(chunk.seen) && !chunk.index_broken => {
                self.finding(chunk.offset, 0, Problem::Index, Cost::Nothing);
            }
            _ => {}
        }
    }

    /// Goes through the unpacked bytes of a chunk.
    fn inside(&mut self, offset: u64, bytes: &[u8], header: &ChunkHeader, trust: Trust) -> Result<Seen, Stop> {
        let mut seen = Seen::default();
        let mut at = 0;
        while at < bytes.len() as u64 {
            let end = match Frame::at(&bytes, at)? {
                Some(frame) => self.inside_record(offset, bytes, frame, trust, &mut seen)?,
                None => None,
            };
            at = match end {
                Some(end) => end,
                None => {
                    seen.unreadable = true;
                    let found = next_frame(&bytes, at + 1, bytes.len() as u64, |frame| {
                        Ok(self.is_plausible_inside(bytes, frame, header))
                    })?;
                    found.map_or(bytes.len() as u64, |frame| frame.offset)
                }
            };
        }
        Ok(seen)
    }

    /// One record of a chunk; its end, or none if it cannot be read.
    fn inside_record(
        &mut self,
        offset: u64,
        bytes: &[u8],
        frame: Frame,
        trust: Trust,
        seen: &mut Seen,
    ) -> Result<Option<u64>, Stop> {
        let Some(end) = frame.end(bytes.len() as u64) else { return Ok(None) };
        if shape(&bytes, frame.opcode, frame.content(), end)? == Shape::Wrong {
            return Ok(None);
        }
        let content = &bytes[frame.content() as usize..end as usize];
        if !matches!(frame.opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE | PRIVATE..) {
            let misplaced = seen.misplaced.get_or_insert((frame.opcode, 0));
            misplaced.1 += 1;
            return Ok(Some(end));
        }
        if !map_fits(frame.opcode, content) {
            return Ok(None);
        }
        match parse_record(frame.opcode, content) {
            Ok(Record::Schema { header, data }) => {
                self.schema(offset, Schema { header, data: data.into_owned() }, trust)?;
            }
            Ok(Record::Channel(channel)) => self.channel(offset, channel, trust)?,
            Ok(Record::Message { header, data }) => {
                let time_ns = header.log_time;
                let (from, to) = seen.times_ns.unwrap_or((time_ns, time_ns));
                seen.times_ns = Some((from.min(time_ns), to.max(time_ns)));
                seen.messages.entry(header.channel_id).or_default().push((time_ns, frame.offset));
                seen.count += 1;
                self.message(offset, header, &data, trust)?;
            }
            Ok(record) => self.hand_on(record, trust)?,
            Err(_) => return Ok(None),
        }
        Ok(Some(end))
    }

    /// Whether a record may begin here, in a chunk in which something cannot be read.
    fn is_plausible_inside(&self, bytes: &[u8], frame: Frame, header: &ChunkHeader) -> bool {
        let length = bytes.len() as u64;
        let exact = |frame: Frame| {
            let end = frame.end(length)?;
            (shape(&bytes, frame.opcode, frame.content(), end).ok()? == Shape::Exact).then_some(end)
        };
        let Some(end) = exact(frame) else { return false };
        let goes_on = end == length
            || matches!(Frame::at(&bytes, end), Ok(Some(next))
                if matches!(next.opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) && exact(next).is_some());
        match frame.opcode {
            op::SCHEMA | op::CHANNEL => goes_on,
            op::MESSAGE => {
                let content = &bytes[frame.content() as usize..];
                let channel = u16::from_le_bytes([content[0], content[1]]);
                let time_ns = content[6..14].try_into().map_or(0, u64::from_le_bytes);
                let in_time = (header.message_start_time..=header.message_end_time).contains(&time_ns);
                goes_on && in_time && self.definitions.has_channel(channel)
            }
            _ => false,
        }
    }
}
