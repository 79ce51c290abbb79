use crate::account::{Cost, REPAIR_METADATA};
use crate::chunk::{Need, chunk_header, is_known};
use crate::layout::{Frame, MAGIC, PRIVATE, attachment_agrees, find_frame, parse, sum};
use crate::source::{Source, peek};
use crate::state::{Outcome, Reader, Trust};
use mcap::records::{Record, op};
use std::io;
use std::ops::Range;

/// Of the accounts of earlier repairs so many characters are kept.
const EARLIER_REPAIRS_CHARACTERS: usize = 1024;

impl<E> Reader<'_, E> {
    pub fn records(&mut self, source: &dyn Source, mut range: Range<u64>) -> Outcome<(), E> {
        while range.start < range.end {
            range.start = match self.record(source, range.clone())? {
                Some(end) => end,
                None => self.pass_over(source, range.clone())?,
            };
        }
        Ok(())
    }

    /// Takes the record at the start of the range if its lengths agree and its content can be parsed; returns its end.
    fn record(&mut self, source: &dyn Source, range: Range<u64>) -> Outcome<Option<u64>, E> {
        let Some(frame) = Frame::at(source, range.start)? else { return Ok(None) };
        let rest = frame.rest(source, range.end)?;
        let credible = match (rest, frame.opcode) {
            // What is left over in a chunk would be messages; the file's marks have one length.
            (None, _) | (Some(1..), op::CHUNK | op::DATA_END | op::FOOTER) => false,
            // Where bytes are gone in one of these, it reaches into what follows it.
            (Some(_), op::CHUNK | op::ATTACHMENT | PRIVATE..) | (Some(1..), _) => self.goes_on(source, frame.end())?,
            (Some(0), _) => true,
        };
        // The content of these kinds may be anything: what proves to be something else is that.
        if self.inside.is_none()
            && (!credible || rest != Some(0) || matches!(frame.opcode, op::MESSAGE | PRIVATE..))
            && let Some(end) = self.proven(frame, rest)?
        {
            return Ok(Some(end));
        }
        if !credible && (frame.opcode, rest) != (op::ATTACHMENT, Some(0)) {
            return Ok(None);
        }
        if frame.length > self.limits.record_bytes || !self.afford(frame.length) {
            self.region(range.start..frame.end(), "a record is bigger than is read", cost_of(frame.opcode));
            return Ok(Some(frame.end()));
        }
        if frame.opcode == op::CHUNK && self.inside.is_none() {
            return self.chunk(frame.offset, frame.end(), Need::Lengths);
        }
        let content = source.bytes(frame.content()..frame.end())?;
        let Some(record) = parse(frame.opcode, &content) else { return Ok(None) };
        if !credible && attachment_agrees(&content) != Some(true) {
            return Ok(None);
        }
        let inside = self.inside.as_ref().map(|chunk| (chunk.offset, chunk.trust));
        let (place, trust) = inside.unwrap_or((range.start, Trust::Sound));
        let intact = self.summary.as_ref().is_some_and(|summary| summary.intact);
        match record {
            // The summary's word counts more than that of an altered chunk.
            Record::Schema { .. } | Record::Channel(_) if trust == Trust::Doubtful && intact => {}
            Record::Schema { header, data } => self.schema(place, (header, data.into_owned()))?,
            Record::Channel(channel) => self.channel(place, channel)?,
            Record::Message { header, data } => {
                if let Some(chunk) = &mut self.inside {
                    chunk.places.entry(header.channel_id).or_default().push((header.log_time, frame.offset));
                }
                self.message(place, header, &data, trust)?;
            }
            Record::Unknown { opcode: PRIVATE.., .. } => self.hand_on(record, trust)?,
            record if inside.is_none() => self.file_record(frame, record, &content)?,
            _ => self.misplaced(place..place, frame.opcode),
        }
        Ok(Some(frame.end()))
    }

    /// Takes a record that may not be in a chunk.
    fn file_record(&mut self, frame: Frame, record: Record<'_>, content: &[u8]) -> Outcome<(), E> {
        let range = frame.offset..frame.end();
        match record {
            Record::Header(_) if frame.offset == MAGIC.len() as u64 => self.hand_on(record, Trust::Sound)?,
            Record::Attachment { ref header, .. } => {
                self.others[0] += 1;
                let trust = if attachment_agrees(content) == Some(false) { Trust::Doubtful } else { Trust::Sound };
                if trust == Trust::Doubtful {
                    let name = header.name.escape_debug();
                    let problem = format!("the checksum of attachment `{name}` does not agree with its content");
                    self.finding(range, problem, Cost::Doubt(0), None);
                }
                self.hand_on(record, trust)?;
            }
            Record::Metadata(ref metadata) => {
                self.others[1] += 1;
                if let Some(outcome) = metadata.metadata.get("outcome").filter(|_| metadata.name == REPAIR_METADATA) {
                    let before = self.account.repaired_with_loss.take().map(|before| before + "; then ");
                    let all = before.unwrap_or_default() + outcome;
                    self.account.repaired_with_loss = Some(all.chars().take(EARLIER_REPAIRS_CHARACTERS).collect());
                }
                self.hand_on(record, Trust::Sound)?;
            }
            Record::MessageIndex(_) if self.is_index(frame)? || self.indexed.0 == Trust::Doubtful => {}
            Record::MessageIndex(_) => {
                self.finding(range, "an index does not describe what is there", Cost::Nothing, None);
            }
            Record::DataEnd(end) if self.data_end.is_none() => {
                self.data_end = Some(frame.end());
                // 0 stands for a checksum that was not calculated. Where something was altered already, that is why.
                let saved = end.data_section_crc;
                if saved != 0 && self.account.is_whole() && saved != sum(self.source, 0..frame.offset)? {
                    let problem = "the checksum over all data does not agree: something was altered";
                    self.finding(0..frame.offset, problem, Cost::Doubt(0), None);
                }
            }
            Record::Header(_) | Record::DataEnd(_) => self.misplaced(range, frame.opcode),
            // The rest is the summary's.
            _ => {}
        }
        Ok(())
    }

    /// The end of a chunk or of an index of messages whose content proves what it is, whatever its head says.
    fn proven(&mut self, frame: Frame, rest: Option<u64>) -> Outcome<Option<u64>, E> {
        let head = frame.offset..frame.content();
        if let Some(end) = self.chunk(frame.offset, self.source.length(), Need::Checksum)? {
            if (frame.opcode, rest) != (op::CHUNK, Some(0)) {
                self.finding(head, "the head of a chunk was altered", Cost::Nothing, None);
            }
            return Ok(Some(end));
        }
        if frame.opcode != op::MESSAGE_INDEX && frame.length > 6 && self.is_index(frame)? {
            self.finding(head, "the head of a message index was altered", Cost::Nothing, None);
            return Ok(Some(frame.end()));
        }
        Ok(None)
    }

    fn pass_over(&mut self, source: &dyn Source, range: Range<u64>) -> Outcome<u64, E> {
        let frame = Frame::at(source, range.start)?;
        let opcode = frame.map_or(0, |frame| frame.opcode);
        let (next, cost) = match frame.map(Frame::end) {
            Some(end) if self.inside.is_none() && end <= range.end && self.goes_on(source, end)? => {
                (Some(end), cost_of(opcode))
            }
            // The file ends in this chunk, as both its lengths say.
            Some(end)
                if opcode == op::CHUNK
                    && end > range.end
                    && chunk_header(source, range.start)?.is_some_and(|header| header.2 == end) =>
            {
                (None, Cost::Unknown)
            }
            _ => {
                let good = |found| self.is_plausible(source, found, range.end);
                let found = find_frame(source, range.start + 1..range.end, good)?;
                (found.map(|found| found.offset), Cost::Unknown)
            }
        };
        let end = next.unwrap_or(range.end);
        if let Some(chunk) = &mut self.inside {
            chunk.unreadable = true;
        } else if opcode == op::CHUNK && self.chunk(range.start, end, Need::Nothing)?.is_some() {
            // What is wrong with it is noted there.
        } else if next.is_none() && self.account.cut {
            self.cut_at = range.start;
        } else {
            self.region(range.start..end, "no record can be recognised", cost);
        }
        Ok(end)
    }

    /// Whether a record may begin here, where something before it cannot be read.
    fn is_plausible(&self, source: &dyn Source, frame: Frame, until: u64) -> io::Result<bool> {
        if frame.rest(source, until)? != Some(0) || self.inside.is_some() && frame.opcode > op::MESSAGE {
            return Ok(false);
        }
        match frame.opcode {
            op::CHUNK => {
                Ok(chunk_header(source, frame.offset)?.is_some_and(|(header, ..)| is_known(&header.compression)))
            }
            op::MESSAGE if !self.has_channel(peek(source, frame.content())?.map_or(0, u16::from_le_bytes)) => Ok(false),
            _ => self.goes_on(source, frame.end()),
        }
    }

    /// Whether reading can go on here: a record begins, or the source ends; a file may be cut off.
    fn goes_on(&self, source: &dyn Source, offset: u64) -> io::Result<bool> {
        // The end mark is shorter than a head.
        let Some(frame) = Frame::at(source, offset)? else { return Ok(true) };
        if frame.end() > source.length() {
            let may_be = (1..=op::DATA_END).contains(&frame.opcode) && frame.length < 1 << 40;
            return Ok(may_be && self.inside.is_none());
        }
        Ok(frame.rest(source, source.length())?.is_some())
    }

    fn misplaced(&mut self, range: Range<u64>, opcode: u8) {
        self.finding(range, format!("a record of type 0x{opcode:02x} may not stand here"), Cost::Nothing, None);
    }
}

fn cost_of(opcode: u8) -> Cost {
    match opcode {
        op::MESSAGE => Cost::Lost(1),
        op::ATTACHMENT | op::METADATA | op::HEADER => Cost::Record,
        op::FOOTER | op::MESSAGE_INDEX..=op::DATA_END => Cost::Nothing,
        _ => Cost::Unknown,
    }
}
