//! A file from its start to its end.

use crate::account::{Account, Cost, Finding, Problem};
use crate::chunk::LastChunk;
use crate::definitions::{Defined, Definitions, Schema};
use crate::ending::Ending;
use crate::layout::{Frame, PRIVATE, Shape, map_fits, shape};
use crate::source::Source;
use mcap::records::{Channel, MessageHeader, Record, op};
use mcap::{MAGIC, parse_record};
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::ops::ControlFlow;

/// What is read at most. A file that wants more is read as far as they go, and a finding says so.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Bytes of one record.
    pub record_bytes: u64,
    /// Bytes of one chunk, unpacked.
    pub chunk_bytes: u64,
    /// Bytes of all chunks, unpacked: this many ...
    pub total_bytes: u64,
    /// ... and this many for each byte of the file.
    pub total_factor: u64,
}

impl Default for Limits {
    /// Depth frames shrink 3 to 40 times; a black frame shrinks a thousandfold, but the file holds others, too.
    fn default() -> Self {
        Self { record_bytes: 256 << 20, chunk_bytes: 128 << 20, total_bytes: 256 << 20, total_factor: 128 }
    }
}

/// Whether what was read is as it was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trust {
    /// Nothing speaks against it.
    Sound,
    /// It comes from a place that was altered.
    Doubtful,
}

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

/// The same inside, where nobody asks what the visitor's error is.
#[derive(Debug)]
pub(crate) enum Stop {
    Io(std::io::Error),
    Visitor,
}

impl From<std::io::Error> for Stop {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
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

/// Messages of a channel that cannot be read.
#[derive(Debug, Default)]
struct Unreadable {
    /// Number of its finding, if that was kept.
    finding: Option<usize>,
    count: u64,
}

/// What is known in the middle of a file.
pub(crate) struct Reader<'a, S> {
    pub(crate) source: &'a S,
    pub(crate) limits: Limits,
    visit: &'a mut dyn FnMut(Record<'_>, Trust) -> ControlFlow<()>,
    pub(crate) account: Account,
    pub(crate) definitions: Definitions,
    /// Bytes that may still be unpacked.
    pub(crate) budget: u64,
    /// The chunk before, while its indexes may come.
    pub(crate) chunk: Option<LastChunk>,
    pub(crate) ending: Ending,
    /// Schemas that were handed on.
    announced: HashSet<u16>,
    unreadable: HashMap<u16, Unreadable>,
    /// Log time of the message before.
    pub(crate) time_ns: Option<u64>,
    /// Finding that wants the log time of the next message.
    open_finding: Option<usize>,
    /// Messages that no chunk's checksum covers.
    pub(crate) unchecked: u64,
}

impl<'a, S: Source> Reader<'a, S> {
    fn new(source: &'a S, limits: Limits, visit: &'a mut dyn FnMut(Record<'_>, Trust) -> ControlFlow<()>) -> Self {
        Self {
            source,
            limits,
            visit,
            account: Account::default(),
            definitions: Definitions::default(),
            budget: limits.total_bytes.saturating_add(source.length().saturating_mul(limits.total_factor)),
            chunk: None,
            ending: Ending::default(),
            announced: HashSet::new(),
            unreadable: HashMap::new(),
            time_ns: None,
            open_finding: None,
            unchecked: 0,
        }
    }

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

    pub(crate) fn schema(&mut self, offset: u64, schema: Schema, trust: Trust) -> Result<(), Stop> {
        let id = schema.header.id;
        match self.definitions.schema(schema, trust == Trust::Doubtful) {
            Defined::Known => {}
            Defined::Refused => self.finding(offset, 0, Problem::Schema(id), Cost::Nothing),
            Defined::New => self.announce_schema(id)?,
        }
        Ok(())
    }

    pub(crate) fn channel(&mut self, offset: u64, channel: Channel, trust: Trust) -> Result<(), Stop> {
        let id = channel.id;
        match self.definitions.channel(channel, trust == Trust::Doubtful) {
            Defined::Known => Ok(()),
            Defined::New => self.announce(id),
            Defined::Refused => {
                self.unreadable_channel(offset, id);
                Ok(())
            }
        }
    }

    /// Hands a message on if its channel is known; returns whether it is.
    pub(crate) fn message(
        &mut self,
        offset: u64,
        header: MessageHeader,
        data: &[u8],
        trust: Trust,
    ) -> Result<bool, Stop> {
        let (id, time_ns) = (header.channel_id, header.log_time);
        let (defined, channel) = self.definitions.find(id);
        if channel.is_err() {
            self.unreadable_channel(offset, id);
            let Some(unreadable) = self.unreadable.get_mut(&id) else { return Ok(false) };
            unreadable.count += 1;
            let count = unreadable.count;
            self.account.charge(Cost::Lost(Some(1)));
            if let Some(finding) = unreadable.finding.and_then(|finding| self.account.findings.get_mut(finding)) {
                finding.cost = Cost::Lost(Some(count));
                let (from, to) = finding.times_ns.unwrap_or((time_ns, time_ns));
                finding.times_ns = Some((from.min(time_ns), to.max(time_ns)));
            }
            return Ok(false);
        }
        if defined == Defined::New {
            self.announce(id)?;
        }
        if let Some(finding) = self.open_finding.take().and_then(|finding| self.account.findings.get_mut(finding)) {
            finding.times_ns = Some((self.time_ns.unwrap_or(time_ns), time_ns));
        }
        self.time_ns = Some(time_ns);
        self.account.messages += 1;
        self.account.doubtful += u64::from(trust == Trust::Doubtful);
        self.hand_on(Record::Message { header, data: Cow::Borrowed(data) }, trust)?;
        Ok(true)
    }

    /// Hands a channel on, and its schema before it.
    fn announce(&mut self, id: u16) -> Result<(), Stop> {
        let (_, Ok(channel)) = self.definitions.find(id) else { return Ok(()) };
        let channel = channel.clone();
        // It was not yet if only the summary has it.
        self.announce_schema(channel.schema_id)?;
        self.hand_on(Record::Channel(channel), Trust::Sound)
    }

    fn announce_schema(&mut self, id: u16) -> Result<(), Stop> {
        match self.definitions.schema_record(id) {
            Some(schema) if self.announced.insert(id) => match (self.visit)(schema, Trust::Sound) {
                ControlFlow::Continue(()) => Ok(()),
                ControlFlow::Break(()) => Err(Stop::Visitor),
            },
            _ => Ok(()),
        }
    }

    pub(crate) fn hand_on(&mut self, record: Record<'_>, trust: Trust) -> Result<(), Stop> {
        match (self.visit)(record, trust) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Stop::Visitor),
        }
    }

    /// A channel whose messages are lost gets one finding.
    fn unreadable_channel(&mut self, offset: u64, id: u16) {
        let (_, Err(why)) = self.definitions.find(id) else { return };
        if !self.unreadable.contains_key(&id) {
            let finding =
                Finding { offset, bytes: 0, problem: Problem::Channel(id, why), cost: Cost::Nothing, times_ns: None };
            let finding = self.account.add(finding);
            self.unreadable.insert(id, Unreadable { finding, count: 0 });
        }
    }

    pub(crate) fn finding(&mut self, offset: u64, bytes: u64, problem: Problem, cost: Cost) {
        self.account.add(Finding { offset, bytes, problem, cost, times_ns: None });
    }

    /// A finding about bytes that are lost: between the messages before and after them.
    pub(crate) fn region(&mut self, offset: u64, end: u64, problem: Problem, cost: Cost) {
        let times_ns = self.time_ns.map(|time_ns| (time_ns, time_ns));
        self.open_finding = self.account.add(Finding { offset, bytes: end - offset, problem, cost, times_ns });
    }

    /// The file stops at `offset`.
    pub(crate) fn cut(&mut self, offset: u64) {
        let (bytes, times_ns) = (self.source.length() - offset, self.time_ns.map(|time_ns| (time_ns, time_ns)));
        let (problem, cost) = if self.ending.has_data_end() {
            (Problem::Summary("the file ends inside its summary"), Cost::Nothing)
        } else {
            (Problem::Cut, Cost::Lost(None))
        };
        self.account.cut = true;
        self.account.add(Finding { offset, bytes, problem, cost, times_ns });
    }

    fn into_account(mut self) -> Account {
        self.account.findings.sort_by_key(|finding| finding.offset);
        self.account
    }
}

/// What it costs that a record of this kind cannot be read.
pub(crate) fn cost_of(opcode: u8) -> Cost {
    match opcode {
        op::CHUNK => Cost::Lost(None),
        op::MESSAGE => Cost::Lost(Some(1)),
        op::MESSAGE_INDEX | op::CHUNK_INDEX | op::ATTACHMENT_INDEX | op::METADATA_INDEX => Cost::Nothing,
        op::STATISTICS | op::SUMMARY_OFFSET | op::DATA_END | op::FOOTER => Cost::Nothing,
        op::ATTACHMENT | op::METADATA | op::HEADER => Cost::Record,
        _ => Cost::Lost(None),
    }
}
