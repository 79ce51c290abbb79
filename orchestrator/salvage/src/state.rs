use crate::account::{Account, Cost, Finding};
use crate::source::Source;
use crate::summary::{Schema, Summary};
use mcap::records::{Channel, Record};
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

/// What is kept of schemas and channels at most, bytes.
const KEPT_BYTES_MAX: usize = 64 << 20;

/// What is read at most. A file that wants more is read as far as they go, and a finding says so.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    pub record_bytes: u64,
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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trust {
    Sound,
    Doubtful,
}

#[derive(Debug, thiserror::Error)]
pub enum ReadError<E> {
    #[error("it is empty")]
    Empty,
    #[error("it does not begin with MCAP's magic bytes")]
    NotMcap,
    #[error(transparent)]
    Io(#[from] std::io::Error),
    #[error(transparent)]
    Visit(E),
}

pub(crate) type Outcome<T, E> = Result<T, ReadError<E>>;

#[derive(Debug, Default)]
pub(crate) struct Definitions {
    pub schemas: BTreeMap<u16, Schema>,
    /// Or what is lost with a channel.
    pub channels: BTreeMap<u16, Result<Channel, Finding>>,
    kept_bytes: usize,
}

impl Definitions {
    pub fn keep(&mut self, bytes: usize) -> bool {
        self.kept_bytes += bytes + 64;
        self.kept_bytes <= KEPT_BYTES_MAX
    }
}

/// Log time and place of a chunk's messages, by channel, as its indexes have them.
pub(crate) type Places = HashMap<u16, Vec<(u64, u64)>>;

pub(crate) struct Chunk {
    pub offset: u64,
    pub trust: Trust,
    pub places: Places,
    /// It has bytes in which no record can be recognised.
    pub unreadable: bool,
}

pub(crate) struct Reader<'a, E> {
    pub source: &'a dyn Source,
    pub limits: Limits,
    pub visit: &'a mut dyn FnMut(Record<'_>, Trust) -> Result<(), E>,
    pub account: Account,
    pub definitions: Definitions,
    pub summary: Option<Summary>,
    pub budget: u64,
    pub inside: Option<Chunk>,
    /// The messages of the chunk before, and whether it was sound.
    pub indexed: (Trust, Places),
    pub data_end: Option<u64>,
    /// From here on nothing could be read, if the file was cut.
    pub cut_at: u64,
    pub time_ns: Option<u64>,
    /// Number of the finding about a region that the next message ends.
    pub region: Option<usize>,
    pub others: [u32; 2],
    /// Where a chunk is whose header does not agree with its content.
    pub odd_chunk: Option<u64>,
}

impl<E> Reader<'_, E> {
    pub fn hand_on(&mut self, record: Record<'_>, trust: Trust) -> Outcome<(), E> {
        (self.visit)(record, trust).map_err(ReadError::Visit)
    }

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
}
