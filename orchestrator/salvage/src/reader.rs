//! A file from its start to its end.

use crate::account::{Account, Cost, Problem};
use crate::definitions::Schema;
use crate::layout::{Frame, PRIVATE, Shape, map_fits, shape};
use crate::source::Source;
use crate::state::{Limits, Reader, Stop, Trust, cost_of};
use mcap::records::{Record, op};
use mcap::{MAGIC, parse_record};
use std::ops::ControlFlow;

/// Why reading ended early.
#[derive(Debug, thiserror::Error)]
pub enum ReadError<E> {
    /// An empty file.
    #[error("it is empty")]
    Empty,
    /// Something else.
    #[error("it does not begin with MCAP's magic bytes")]
    NotMcap,
    /// The file system returned an error.
    #[error(transparent)]
    Io(std::io::Error),
    /// What took the records wants no more.
    #[error(transparent)]
    Visit(E),
}

/// Hands every record of the data to `visit`, those inside chunks in their place: header, schemas, channels, messages,
/// attachments, metadata and private records. Channels come before their messages, schemas before their channels.
///
/// Damage is no error: it is in the account. An error of `visit` ends the reading.
pub fn read<S: Source, E>(
    source: &S,
    limits: &Limits,
    mut visit: impl FnMut(Record<'_>, Trust) -> Result<(), E>,
) -> Result<Account, ReadError<E>> {
    let mut failure = None;
    let mut forward = |record: Record<'_>, trust| match visit(record, trust) {
        Ok(()) => ControlFlow::Continue(()),
        Err(error) => {
            failure = Some(error);
            ControlFlow::Break(())
        }
    };
    let mut start = [0; MAGIC.len()];
    let length = source.length();
    if length == 0 {
        return Err(ReadError::Empty);
    }
    if length < start.len() as u64 {
        return Err(ReadError::NotMcap);
    }
    source.read(0, &mut start).map_err(ReadError::Io)?;
    let first = Frame::at(source, start.len() as u64).map_err(ReadError::Io)?;
    let headed = first.filter(|frame| frame.opcode == op::HEADER).is_some_and(|frame| {
        let end = frame.end(length);
        end.is_some_and(|end| shape(source, op::HEADER, frame.content(), end).is_ok_and(|shape| shape == Shape::Exact))
    });
    if start != *MAGIC && !headed {
        return Err(ReadError::NotMcap);
    }
    let mut reader = Reader::new(source, *limits, &mut forward);
    if start != *MAGIC {
        reader.finding(0, start.len() as u64, Problem::Magic, Cost::Nothing);
    }
    match reader.run() {
        Ok(()) => Ok(reader.into_account()),
        Err(Stop::Io(error)) => Err(ReadError::Io(error)),
        Err(Stop::Visitor) => Err(ReadError::Visit(failure.expect("the visitor stopped the reading"))),
    }
}

impl<S: Source> Reader<'_, S> {
    fn run(&mut self) -> Result<(), Stop> {
        self.read_spare_definitions()?;
        let length = self.source.length();
        let mut at = MAGIC.len() as u64;
        while !self.ending.has_footer() {
            let Some(frame) = Frame::next(self.source, at)? else {
                self.settle();
                self.cut(at);
                break;
            };
            at = match self.whole_record(frame)? {
                Some(end) => end,
                None => self.broken(frame)?,
            };
            if at >= length && !self.ending.has_footer() {
                self.settle();
                if !self.account.cut {
                    self.cut(length);
                }
                break;
            }
        }
        self.settle();
        self.finish(at)
    }

    /// Takes the record if its lengths agree and its content can be parsed; returns its end.
    fn whole_record(&mut self, frame: Frame) -> Result<Option<u64>, Stop> {
        let Some(end) = frame.end(self.source.length()) else { return Ok(None) };
        let shape = shape(self.source, frame.opcode, frame.content(), end)?;
        let trusted = match shape {
            Shape::Wrong => false,
            Shape::Exact => frame.opcode < PRIVATE || self.goes_on_at(end)?,
            // What is left over in a chunk would be messages; the file's marks have one length.
            Shape::Longer => !matches!(frame.opcode, op::CHUNK | op::DATA_END | op::FOOTER) && self.goes_on_at(end)?,
        };
        if !trusted {
            return Ok(None);
        }
        // Kinds whose content may be anything: what proves to be something else is that.
        if (shape == Shape::Longer || matches!(frame.opcode, op::MESSAGE | PRIVATE..))
            && let Some(end) = self.proves_to_be(frame)?
        {
            return Ok(Some(end));
        }
        // Where bytes are gone in one of these, it reaches into what follows it.
        if matches!(frame.opcode, op::CHUNK | op::ATTACHMENT) && !self.goes_on_at(end)? {
            return self.proven_by_sum(frame, end);
        }
        if frame.opcode != op::MESSAGE_INDEX {
            self.settle();
        }
        if frame.length > self.limits.record_bytes {
            let problem = Problem::Limit("a record is bigger than is read");
            self.region(frame.offset, end, problem, cost_of(frame.opcode));
            return Ok(Some(end));
        }
        let mut content = vec![0; frame.length as usize];
        self.source.read(frame.content(), &mut content)?;
        if !map_fits(frame.opcode, &content) {
            return Ok(None);
        }
        Ok(self.record(frame, end, &content)?.then_some(end))
    }

    /// Takes a chunk or an attachment after which no record begins, if its checksum proves that it ends there.
    fn proven_by_sum(&mut self, frame: Frame, end: u64) -> Result<Option<u64>, Stop> {
        if frame.opcode == op::CHUNK {
            return self.proven_chunk(frame.offset, false);
        }
        if frame.length > self.limits.record_bytes {
            return Ok(None);
        }
        let mut content = vec![0; frame.length as usize];
        self.source.read(frame.content(), &mut content)?;
        let sum = content.split_last_chunk::<4>().map(|(body, sum)| (u32::from_le_bytes(*sum), crc32fast::hash(body)));
        if sum.is_none_or(|(saved, sum)| saved != sum) {
            return Ok(None);
        }
        self.settle();
        Ok(self.attachment(frame, end, &content)?.then_some(end))
    }

    /// Takes a record at the top level. False where its content cannot be parsed.
    fn record(&mut self, frame: Frame, end: u64, content: &[u8]) -> Result<bool, Stop> {
        if frame.opcode == op::ATTACHMENT {
            return self.attachment(frame, end, content);
        }
        let Ok(record) = parse_record(frame.opcode, content) else { return Ok(false) };
        if self.ending.has_data_end() {
            return self.after_data(frame, end, record);
        }
        match record {
            Record::Header(_) if frame.offset == MAGIC.len() as u64 => self.hand_on(record, Trust::Sound)?,
            Record::Schema { header, data } => {
                self.schema(frame.offset, Schema { header, data: data.into_owned() }, Trust::Sound)?
            }
            Record::Channel(channel) => self.channel(frame.offset, channel, Trust::Sound)?,
            Record::Message { header, data } => {
                self.unchecked += u64::from(self.message(frame.offset, header, &data, Trust::Sound)?);
            }
            Record::Chunk { header, data } => self.chunk_record(frame.offset, end, &header, (&data, true))?,
            Record::MessageIndex(index) => self.message_index(frame.offset, end, &index),
            Record::Metadata(metadata) => {
                self.ending.metadata_at(frame.offset);
                self.note_earlier_repair(&metadata);
                self.hand_on(Record::Metadata(metadata), Trust::Sound)?;
            }
            Record::DataEnd(data_end) => self.data_end(frame.offset, end, data_end.data_section_crc)?,
            Record::Unknown { opcode: PRIVATE.., .. } => self.hand_on(record, Trust::Sound)?,
            Record::Header(_) | Record::Unknown { .. } => {
                self.finding(frame.offset, end - frame.offset, Problem::Misplaced(frame.opcode), Cost::Nothing);
            }
            record => {
                let problem = Problem::Summary("the end of the data is not marked");
                self.finding(frame.offset, 0, problem, Cost::Nothing);
                self.ending.data_ends_unmarked(frame.offset);
                return self.after_data(frame, end, record);
            }
        }
        Ok(true)
    }

    /// `mcap`'s parser refuses an attachment whose checksum does not agree; its content may still be of use.
    fn attachment(&mut self, frame: Frame, end: u64, content: &[u8]) -> Result<bool, Stop> {
        let mut unsummed = content.to_vec();
        let Some((body, sum)) = content.split_last_chunk::<4>() else { return Ok(false) };
        let (sum, summed) = (u32::from_le_bytes(*sum), crc32fast::hash(body));
        let at = body.len();
        // 0 stands for a checksum that was not calculated.
        unsummed[at..].fill(0);
        let Ok(record) = parse_record(op::ATTACHMENT, &unsummed) else { return Ok(false) };
        let Record::Attachment { header, .. } = &record else { return Ok(false) };
        self.ending.attachment_at(frame.offset);
        let trust = if sum == 0 || sum == summed { Trust::Sound } else { Trust::Doubtful };
        if trust == Trust::Doubtful {
            let problem = Problem::Attachment(header.name.clone());
            self.finding(frame.offset, end - frame.offset, problem, Cost::Doubt(0));
        }
        self.hand_on(record, trust)?;
        Ok(true)
    }
}
