//! What is known in the middle of a file, and how records are handed on.

use crate::account::{Account, Cost, Finding, Problem};
use crate::definitions::{Defined, Definitions, Schema};
use crate::landmarks::Ending;
use crate::last_chunk::LastChunk;
use crate::source::Source;
use mcap::records::{Channel, MessageHeader, Record, op};
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::ops::ControlFlow;

/// What is read at most. A file that wants more is read as far as they go, and a finding says so.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
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

/// Why reading ends early, where nobody asks what the visitor's error is.
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
    pub(crate) fn new(
        source: &'a S,
        limits: Limits,
        visit: &'a mut dyn FnMut(Record<'_>, Trust) -> ControlFlow<()>,
    ) -> Self {
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

    pub(crate) fn into_account(mut self) -> Account {
        self.account.findings.sort_by_key(|finding| finding.offset);
        self.account
    }
}

/// What it costs that a record of this kind cannot be read.
// The table names every kind, also those that cost the same.
#[allow(clippy::match_same_arms)]
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
