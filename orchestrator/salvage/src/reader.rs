//! A reading: what begins and ends it, and what is known in its middle.

use crate::account::{Account, Cost, Finding};
use crate::chunk::{Chunk, Places};
use crate::definitions::Definitions;
use crate::layout::{Frame, MAGIC, parse};
use crate::source::{Source, peek};
use crate::summary::Summary;
use mcap::records::{Header, Record, op};
use std::ops::Range;

/// What is read at most. A file that wants more is read as far as they go, and a finding says so.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    pub record_bytes: u64,
    /// Bytes of one chunk, unpacked.
    pub chunk_bytes: u64,
    /// Bytes that are read and unpacked, all together: this many ...
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
    /// It is no MCAP file.
    #[error("it does not begin with MCAP's magic bytes")]
    NotMcap,
    /// The file system returned an error.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// What took the records wants no more.
    #[error(transparent)]
    Visit(E),
}

pub(crate) type Outcome<T, E> = Result<T, ReadError<E>>;

/// Hands every record of the data to `visit`, those inside chunks in their place: header, schemas, channels, messages,
/// attachments, metadata and private records. Channels come before their messages, schemas before their channels.
///
/// Damage is no error: it is in the account. An error of `visit` ends the reading.
pub fn read<E>(
    source: &impl Source,
    limits: &Limits,
    mut visit: impl FnMut(Record<'_>, Trust) -> Result<(), E>,
) -> Result<Account, ReadError<E>> {
    let length = source.length();
    let is_marked = peek(source, 0)? == Some(MAGIC);
    if length == 0 {
        return Err(ReadError::Empty);
    }
    if !is_marked && header(source)?.is_none() {
        return Err(ReadError::NotMcap);
    }
    let summary = Summary::read(source)?;
    let (start, end) = (MAGIC.len() as u64, summary.as_ref().map_or(length, |summary| summary.start));
    let mut reader = Reader {
        source,
        limits: *limits,
        visit: &mut visit,
        account: Account { cut: summary.is_none(), ..Account::default() },
        definitions: Definitions::default(),
        summary,
        budget: limits.total_bytes.saturating_add(length.saturating_mul(limits.total_factor)),
        inside: None,
        indexed: (Trust::Doubtful, Places::new()),
        data_end: None,
        cut_at: length,
        time_ns: None,
        region: None,
        others: [0; 2],
        odd_chunk: None,
    };
    if !is_marked {
        reader.finding(0..start, "the magic bytes at the beginning were altered", Cost::Nothing, None);
    }
    reader.records(source, start..end)?;
    reader.finish();
    if let Some(chunk) = reader.odd_chunk {
        reader.finding(chunk..chunk, "the header of a chunk does not agree with its content", Cost::Nothing, None);
    }
    reader.account.findings.sort_by_key(|finding| finding.offset);
    Ok(reader.account)
}

/// The record that a file begins with.
pub(crate) fn header(source: &dyn Source) -> std::io::Result<Option<Header>> {
    let Some(frame) = Frame::at(source, MAGIC.len() as u64)? else { return Ok(None) };
    if frame.opcode != op::HEADER || frame.rest(source, source.length())? != Some(0) {
        return Ok(None);
    }
    match parse(frame.opcode, &source.bytes(frame.content()..frame.end())?) {
        Some(Record::Header(header)) => Ok(Some(header)),
        _ => Ok(None),
    }
}

/// What is known in the middle of a file.
pub(crate) struct Reader<'a, E> {
    pub source: &'a dyn Source,
    pub limits: Limits,
    visit: &'a mut dyn FnMut(Record<'_>, Trust) -> Result<(), E>,
    pub account: Account,
    pub definitions: Definitions,
    pub summary: Option<Summary>,
    /// Bytes that may still be read and unpacked.
    pub budget: u64,
    /// The chunk whose content is read.
    pub inside: Option<Chunk>,
    /// The messages of the chunk before, and whether it was sound.
    pub indexed: (Trust, Places),
    /// Where the mark of the data's end ends.
    pub data_end: Option<u64>,
    /// From here on nothing could be read, if the file was cut.
    pub cut_at: u64,
    /// Log time of the message before.
    pub time_ns: Option<u64>,
    /// Number of the finding about a region that the next message ends.
    pub region: Option<usize>,
    /// Attachments and metadata that were read.
    pub others: [u32; 2],
    /// Where a chunk is whose header does not agree with its content.
    pub odd_chunk: Option<u64>,
}

impl<E> Reader<'_, E> {
    pub fn hand_on(&mut self, record: Record<'_>, trust: Trust) -> Outcome<(), E> {
        (self.visit)(record, trust).map_err(ReadError::Visit)
    }

    /// Takes so many bytes from the budget, if it has them.
    pub fn afford(&mut self, bytes: u64) -> bool {
        let rest = self.budget.checked_sub(bytes);
        self.budget = rest.unwrap_or(self.budget);
        rest.is_some()
    }

    pub fn finding(&mut self, range: Range<u64>, problem: impl Into<String>, cost: Cost, times_ns: Option<(u64, u64)>) {
        let (offset, bytes) = (range.start, range.end - range.start);
        self.account.add(Finding { offset, bytes, problem: problem.into(), cost, times_ns });
    }

    /// A finding about bytes that are lost: between the messages before and after them.
    pub fn region(&mut self, range: Range<u64>, problem: &str, cost: Cost) {
        self.finding(range, problem, cost, self.time_ns.map(|time_ns| (time_ns, time_ns)));
        self.region = (self.account.further == 0).then(|| self.account.findings.len() - 1);
    }

    /// What the file's end says, beside what was read.
    fn finish(&mut self) {
        self.settle_channels();
        let length = self.source.length();
        let Some(summary) = &self.summary else {
            // All that is missing may be the summary.
            let cost = if self.data_end.is_some() { Cost::Nothing } else { Cost::Rest };
            let times_ns = self.time_ns.map(|time_ns| (time_ns, time_ns));
            return self.finding(self.cut_at..length, "the file ends here, before its end mark", cost, times_ns);
        };
        let (start, counted) = (summary.start, summary.statistics.clone());
        if let Some(problem) = summary.problem(self.data_end, length) {
            self.finding(start..length, problem, Cost::Nothing, None);
        }
        let Some(counted) = counted else { return };
        let others = self.others[0] < counted.attachment_count || self.others[1] < counted.metadata_count;
        let read = self.account.messages + self.account.lost;
        let missing = counted.message_count.saturating_sub(read);
        let cost = match missing {
            _ if self.account.lost_unknown => return self.account.price(missing, others),
            1.. => Cost::Lost(missing),
            0 if !self.account.is_whole() => return,
            0 if read > counted.message_count => Cost::Doubt(read - counted.message_count),
            0 if others => Cost::Record,
            0 => return,
        };
        self.finding(0..length, "the statistics count other records than there are", cost, None);
    }
}
