//! What cannot be read: passed over, and the next record found.

use crate::account::{Cost, Problem};
use crate::chunk::header_at;
use crate::layout::{END_MARK, Frame, PRIVATE, Shape, next_frame, shape};
use crate::source::{Source, peek};
use crate::state::{Reader, Stop, cost_of};
use crate::unpack::is_known;
use mcap::records::op;
use std::io::Result;

impl<S: Source> Reader<'_, S> {
    /// Passes over a record that cannot be read. Returns where the next one begins.
    pub(crate) fn broken(&mut self, frame: Frame) -> std::result::Result<u64, Stop> {
        if let Some(end) = self.proves_to_be(frame)? {
            return Ok(end);
        }
        match &mut self.chunk {
            Some(chunk) if frame.opcode == op::MESSAGE_INDEX => chunk.lose_index(),
            _ => self.settle(),
        }
        let length = self.source.length();
        let own_end = match frame.end(length) {
            Some(end) if self.record_begins_at(end)? => Some(end),
            _ => None,
        };
        let next = match own_end {
            Some(end) => Some(end),
            // The file ends in a chunk.
            None if self.is_cut_chunk(frame)? => None,
            None => next_frame(self.source, frame.offset + 1, length, |candidate| self.is_plausible(candidate))?
                .map(|found| found.offset),
        };
        let end = next.unwrap_or(length);
        if self.ending.has_data_end() {
            match next {
                Some(_) => {
                    let problem = Problem::Summary("a record of the summary cannot be read");
                    self.finding(frame.offset, end - frame.offset, problem, Cost::Nothing);
                }
                None => self.cut(frame.offset),
            }
        } else if frame.opcode == op::CHUNK && self.part_of_chunk(frame.offset, end)? {
            // What is wrong with it is noted there.
        } else if next.is_some() {
            let cost = if own_end.is_some() { cost_of(frame.opcode) } else { Cost::Lost(None) };
            let problem = if cost == Cost::Nothing { Problem::Index } else { Problem::Unreadable };
            self.region(frame.offset, end, problem, cost);
        } else {
            self.cut(frame.offset);
        }
        Ok(end)
    }

    /// Whether this is a chunk that reaches beyond the file's end, by both its lengths.
    fn is_cut_chunk(&self, frame: Frame) -> Result<bool> {
        let (end, length) = (frame.content().checked_add(frame.length), self.source.length());
        if frame.opcode != op::CHUNK || end.is_none_or(|end| end <= length) {
            return Ok(false);
        }
        let header = header_at(self.source, frame.offset)?;
        Ok(header.is_some_and(|(header, data)| data.checked_add(header.compressed_size) == end))
    }

    /// The end of a record whose content proves to be something else than its head says, or something where the head is
    /// damaged; none where nothing is proven.
    pub(crate) fn proves_to_be(&mut self, frame: Frame) -> std::result::Result<Option<u64>, Stop> {
        if self.ending.has_data_end() {
            return Ok(None);
        }
        if let Some(end) = self.proven_chunk(frame.offset, true)? {
            return Ok(Some(end));
        }
        let Some(end) = frame.end(self.source.length()) else { return Ok(None) };
        if frame.opcode != op::MESSAGE_INDEX && self.is_index(frame.content(), end)? {
            self.finding(frame.offset, end - frame.offset, Problem::Head("message index"), Cost::Nothing);
            return Ok(Some(end));
        }
        Ok(None)
    }

    /// Whether reading can go on here: a record begins, or the file ends, cut off or not.
    pub(crate) fn goes_on_at(&self, offset: u64) -> Result<bool> {
        let length = self.source.length();
        let Some(frame) = Frame::at(self.source, offset)? else { return Ok(true) };
        match frame.end(length) {
            Some(_) => self.record_begins_at(offset),
            // Cut off in its middle.
            None => Ok((1..=op::DATA_END).contains(&frame.opcode) && frame.length < 1 << 40),
        }
    }

    /// Whether a whole record begins here, or the file's end mark.
    fn record_begins_at(&self, offset: u64) -> Result<bool> {
        let length = self.source.length();
        if offset == length || self.is_end_mark(offset)? {
            return Ok(true);
        }
        let Some(frame) = Frame::at(self.source, offset)? else { return Ok(false) };
        let Some(end) = frame.end(length) else { return Ok(false) };
        let known = matches!(frame.opcode, 1..=op::DATA_END | PRIVATE..);
        Ok(known && shape(self.source, frame.opcode, frame.content(), end)? != Shape::Wrong)
    }

    /// Whether a record may begin here, where something before it cannot be read.
    fn is_plausible(&self, frame: Frame) -> Result<bool> {
        let Some(end) = frame.end(self.source.length()) else { return Ok(false) };
        if frame.opcode == op::HEADER || shape(self.source, frame.opcode, frame.content(), end)? != Shape::Exact {
            return Ok(false);
        }
        match frame.opcode {
            op::FOOTER => self.is_end_mark(end),
            op::CHUNK => {
                Ok(header_at(self.source, frame.offset)?.is_some_and(|(header, _)| is_known(&header.compression)))
            }
            op::MESSAGE => {
                let channel = peek(self.source, frame.content())?.map_or(0, u16::from_le_bytes);
                Ok(self.definitions.has_channel(channel) && self.record_begins_at(end)?)
            }
            _ => self.record_begins_at(end),
        }
    }

    /// Whether the magic bytes that end a file are here, and it ends with them.
    pub(crate) fn is_end_mark(&self, offset: u64) -> Result<bool> {
        let end = offset + END_MARK.len() as u64;
        Ok(end == self.source.length() && peek(self.source, offset)? == Some(END_MARK))
    }
}
