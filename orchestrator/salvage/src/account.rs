//! What was read, what was found wrong, and what that cost.

use std::fmt::{Display, Formatter};

/// Findings that are kept one by one; further ones are counted.
const FINDINGS_MAX: usize = 64;

/// Name of the metadata record in which a file that was repaired carries what was lost: `outcome` in a few words, and
/// `finding-00` and so on.
pub const REPAIR_METADATA: &str = "stillroom.repair";
/// What is wrong somewhere.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Problem {
    /// The first bytes are not MCAP's.
    Magic,
    /// The file stops before its end mark.
    Cut,
    /// Bytes in which no record can be recognised.
    Unreadable,
    /// A record whose head was altered; its content proves what it is.
    Head(&'static str),
    /// A chunk whose checksum is not that of its content.
    ChunkSum,
    /// A chunk that can be unpacked only up to some point.
    ChunkPart,
    /// A chunk whose header says something else than its content.
    ChunkHeader,
    /// A chunk with a compression that nobody knows.
    Compression(String),
    /// Something bigger than is read.
    Limit(&'static str),
    /// A record that may not stand where it stands, or of a kind that the format does not have.
    Misplaced(u8),
    /// A schema that cannot be one.
    Schema(u16),
    /// Messages of a channel that cannot be read, and why.
    Channel(u16, &'static str),
    /// An attachment whose checksum is not that of its content.
    Attachment(String),
    /// An index that does not describe what is there.
    Index,
    /// The checksum over all data does not agree, and nothing else says where.
    DataSum,
    /// The end of the file: summary, its checksum, the end mark.
    Summary(&'static str),
    /// The statistics count other messages than there are.
    Count(u64),
}

impl Display for Problem {
    fn fmt(&self, out: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Magic => write!(out, "the magic bytes at the beginning were altered"),
            Self::Cut => write!(out, "the file ends here, before its end mark"),
            Self::Unreadable => write!(out, "no record can be recognised"),
            Self::Head(kind) => write!(out, "the head of a {kind} was altered"),
            Self::ChunkSum => write!(out, "a chunk's checksum does not agree with its content"),
            Self::ChunkPart => write!(out, "a chunk cannot be unpacked to its end"),
            Self::ChunkHeader => write!(out, "a chunk's header does not agree with its content"),
            Self::Compression(name) => {
                write!(out, "a chunk's compression `{}` is not known (only zstd and lz4 are)", name.escape_debug())
            }
            Self::Limit(what) | Self::Summary(what) => write!(out, "{what}"),
            Self::Misplaced(opcode) => write!(out, "a record of type 0x{opcode:02x} may not stand here"),
            Self::Schema(id) => write!(out, "schema {id} is not valid, or contradicts an earlier one"),
            Self::Channel(id, why) => write!(out, "messages of channel {id} cannot be read: {why}"),
            Self::Attachment(name) => {
                write!(out, "the checksum of attachment `{}` does not agree with its content", name.escape_debug())
            }
            Self::Index => write!(out, "an index does not describe what is there"),
            Self::DataSum => write!(out, "the checksum over all data does not agree: something was altered"),
            Self::Count(count) => write!(out, "the statistics count {count} messages"),
        }
    }
}

impl Problem {
    /// Whether it can be the work of the writer, so that a checksum over it agrees.
    pub(crate) fn may_be_original(&self) -> bool {
        matches!(
            self,
            Self::ChunkHeader
                | Self::Compression(_)
                | Self::Limit(_)
                | Self::Misplaced(_)
                | Self::Schema(_)
                | Self::Channel(..)
        )
    }
}

/// What a finding cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cost {
    /// Nothing: all that was recorded was read.
    Nothing,
    /// So many messages, or an attachment, were read but may hold wrong content.
    Doubt(u64),
    /// So many messages are gone; none where that is not known.
    Lost(Option<u64>),
    /// Something else than messages is gone.
    Record,
}

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Where it begins: in the file, and for what is in a chunk the chunk's place.
    pub offset: u64,
    /// Bytes of the file that it covers.
    pub bytes: u64,
    pub problem: Problem,
    pub cost: Cost,
    /// Log times between which something was lost or may be wrong, nanoseconds since 1970.
    pub times_ns: Option<(u64, u64)>,
}

impl Display for Finding {
    fn fmt(&self, out: &mut Formatter<'_>) -> std::fmt::Result {
        write!(out, "at byte {}: {}", self.offset, self.problem)?;
        if let (Problem::Cut, Cost::Lost(None)) = (&self.problem, self.cost) {
            return match self.times_ns {
                Some((_, to)) => write!(out, "; what came after {} is lost", clock(to)),
                None => write!(out, "; what came after is lost"),
            };
        }
        match self.cost {
            Cost::Nothing => write!(out, "; nothing was lost")?,
            Cost::Doubt(0) => write!(out, "; its content may be wrong")?,
            Cost::Doubt(count) => write!(out, "; {} kept that may be wrong", messages(count))?,
            Cost::Lost(Some(count)) => write!(out, "; {} lost", messages(count))?,
            Cost::Lost(None) => write!(out, "; the messages in {} bytes are lost", self.bytes)?,
            Cost::Record => write!(out, "; {} bytes are lost", self.bytes)?,
        }
        match self.times_ns {
            Some((from, to)) if self.cost != Cost::Nothing && from == to => write!(out, ", at {}", clock(from)),
            Some((from, to)) if self.cost != Cost::Nothing => write!(out, ", from {} to {}", clock(from), clock(to)),
            _ => Ok(()),
        }
    }
}

/// All about one reading.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Account {
    /// Messages read.
    pub messages: u64,
    /// Of these, those that may hold wrong content.
    pub doubtful: u64,
    /// Messages that are known to be lost.
    pub lost: u64,
    /// More may be lost than is known: the file was cut, or holds bytes that cannot be read.
    pub lost_unknown: bool,
    /// The file stops before its end mark.
    pub cut: bool,
    /// What is wrong, in the order of places; at most 64.
    pub findings: Vec<Finding>,
    /// Findings beyond those.
    pub further: u64,
    /// An earlier repair left its account in the file: it lost something then.
    pub repaired_with_loss: Option<String>,
    costly: bool,
}

impl Account {
    /// Whether nothing at all is wrong.
    pub fn is_whole(&self) -> bool {
        self.findings.is_empty() && self.further == 0
    }

    /// Whether all that was recorded was read, and as it was recorded.
    pub fn is_lossless(&self) -> bool {
        !self.costly && self.lost == 0 && !self.lost_unknown && self.doubtful == 0
    }

    /// The outcome in a few words: what was lost, or that nothing was.
    pub fn outcome(&self) -> String {
        if self.is_lossless() {
            return "nothing was lost".to_owned();
        }
        let mut words = Vec::new();
        if self.lost > 0 {
            let more = if self.lost_unknown { " at least" } else { "" };
            words.push(format!("{}{more} lost", messages(self.lost)));
        } else if self.lost_unknown && self.cut {
            words.push("what came after its end is lost".to_owned());
        } else if self.lost_unknown {
            words.push("an unknown number of messages lost".to_owned());
        }
        if self.doubtful > 0 {
            words.push(format!("{} may be wrong", messages(self.doubtful)));
        }
        if words.is_empty() {
            words.push("not all that was recorded is there, or as it was".to_owned());
        }
        words.join(", ")
    }

    /// Every finding as a line, and how many more there are.
    pub fn lines(&self) -> Vec<String> {
        let mut lines: Vec<_> = self.findings.iter().map(ToString::to_string).collect();
        if self.further > 0 {
            lines.push(format!("and {} findings more", self.further));
        }
        lines
    }

    /// Adds a finding; returns its number, for what is learned about it later.
    pub(crate) fn add(&mut self, finding: Finding) -> Option<usize> {
        self.charge(finding.cost);
        if self.findings.len() == FINDINGS_MAX {
            self.further += 1;
            return None;
        }
        self.findings.push(finding);
        Some(self.findings.len() - 1)
    }

    /// Counts what something cost.
    pub(crate) fn charge(&mut self, cost: Cost) {
        match cost {
            Cost::Nothing => {}
            Cost::Doubt(_) | Cost::Record => self.costly = true,
            Cost::Lost(Some(count)) => self.lost += count,
            Cost::Lost(None) => self.lost_unknown = true,
        }
    }
}

fn messages(count: u64) -> String {
    if count == 1 { "1 message".to_owned() } else { format!("{count} messages") }
}

/// Nanoseconds since 1970 as a date and a time of the day (UTC); small numbers, which are no dates, as seconds.
fn clock(time_ns: u64) -> String {
    const DAY_S: u64 = 24 * 3600;
    let (seconds, milliseconds) = (time_ns / 1_000_000_000, time_ns / 1_000_000 % 1000);
    if seconds < 365 * DAY_S {
        return format!("{seconds}.{milliseconds:03} s");
    }
    // Days from 1 March of year 0: leap days are then the last of their year (Hinnant, "chrono-Compatible Low-Level
    // Date Algorithms").
    let days = seconds / DAY_S + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let (day, month) =
        (day_of_year - (153 * shifted + 2) / 5 + 1, if shifted < 10 { shifted + 3 } else { shifted - 9 });
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    format!("{year}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}.{milliseconds:03} UTC")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_calendar() {
        assert_eq!(clock(1_709_210_096_789_000_000), "2024-02-29 12:34:56.789 UTC");
        assert_eq!(clock(1_767_225_599_999_999_999), "2025-12-31 23:59:59.999 UTC");
        assert_eq!(clock(951_782_400_000_000_000), "2000-02-29 00:00:00.000 UTC");
        assert_eq!(clock(1_500_000_000), "1.500 s");
    }

    #[test]
    fn a_finding_names_place_cost_and_times() {
        let finding = Finding {
            offset: 1507,
            bytes: 24_612,
            problem: Problem::ChunkSum,
            cost: Cost::Doubt(40),
            times_ns: Some((1_000_000_000, 2_250_000_000)),
        };
        let expected = "at byte 1507: a chunk's checksum does not agree with its content; 40 messages kept that may be \
                        wrong, from 1.000 s to 2.250 s";
        assert_eq!(finding.to_string(), expected);
    }

    #[test]
    fn findings_beyond_the_limit_are_counted_and_cost_as_much() {
        let mut account = Account::default();
        for offset in 0..100 {
            let problem = Problem::Misplaced(0);
            account.add(Finding { offset, bytes: 9, problem, cost: Cost::Lost(Some(2)), times_ns: None });
        }
        assert_eq!((account.findings.len(), account.further, account.lost), (64, 36, 200));
        assert!(!account.is_lossless());
        assert_eq!(account.lines().len(), 65);
        assert_eq!(account.outcome(), "200 messages lost");
    }
}
