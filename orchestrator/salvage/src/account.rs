use std::fmt::{Display, Formatter};
use std::time::Duration;
use time::OffsetDateTime;

const FINDINGS_MAX: usize = 64;

/// Name of the metadata record in which a file that was repaired carries what was lost: `outcome` in a few words, and
/// `finding-00` and so on.
pub const REPAIR_METADATA: &str = "stillroom.repair";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cost {
    Nothing,
    /// So many messages, or something else, were read but may hold wrong content.
    Doubt(u64),
    Lost(u64),
    /// The messages in these bytes are gone; how many is not known.
    Unknown,
    /// All that came after is gone.
    Rest,
    /// Something else than messages is gone.
    Record,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Where it begins: in the file, and for what is in a chunk the chunk's place.
    pub offset: u64,
    pub bytes: u64,
    pub problem: String,
    pub cost: Cost,
    /// Log times between which something was lost or may be wrong, nanoseconds since 1970.
    pub times_ns: Option<(u64, u64)>,
}

impl Display for Finding {
    fn fmt(&self, out: &mut Formatter<'_>) -> std::fmt::Result {
        write!(out, "at byte {}: {}; ", self.offset, self.problem)?;
        match self.cost {
            Cost::Nothing => return write!(out, "nothing was lost"),
            Cost::Doubt(0) => write!(out, "its content may be wrong")?,
            Cost::Doubt(count) => write!(out, "{} kept that may be wrong", messages(count))?,
            Cost::Lost(count) => write!(out, "{} lost", messages(count))?,
            Cost::Unknown => write!(out, "the messages in {} bytes are lost", self.bytes)?,
            Cost::Rest => write!(out, "what came after is lost")?,
            Cost::Record => write!(out, "{} bytes are lost", self.bytes)?,
        }
        match self.times_ns {
            Some((from, to)) if from == to => write!(out, ", at {}", clock(from)),
            Some((from, to)) => write!(out, ", from {} to {}", clock(from), clock(to)),
            None => Ok(()),
        }
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Account {
    pub messages: u64,
    /// Of these, those that may hold wrong content.
    pub doubtful: u64,
    pub lost: u64,
    pub lost_unknown: bool,
    pub cut: bool,
    pub findings: Vec<Finding>,
    pub further: u64,
    /// An earlier repair left its account in the file: it lost something then.
    pub repaired_with_loss: Option<String>,
    pub(crate) costly: bool,
}

impl Account {
    pub fn is_whole(&self) -> bool {
        self.findings.is_empty()
    }

    pub fn is_lossless(&self) -> bool {
        !self.costly && self.lost == 0 && !self.lost_unknown && self.doubtful == 0
    }

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

    pub fn lines(&self) -> Vec<String> {
        let mut lines: Vec<_> = self.findings.iter().map(ToString::to_string).collect();
        if self.further > 0 {
            lines.push(format!("and {} findings more", self.further));
        }
        lines
    }

    pub(crate) fn add(&mut self, finding: Finding) {
        match finding.cost {
            Cost::Nothing => {}
            Cost::Doubt(_) | Cost::Record => self.costly = true,
            Cost::Lost(count) => self.lost += count,
            Cost::Unknown | Cost::Rest => self.lost_unknown = true,
        }
        if self.findings.len() < FINDINGS_MAX {
            self.findings.push(finding);
        } else {
            self.further += 1;
        }
    }

    /// So many messages, and maybe other records, are missing in all: prices what cost an unknown number.
    pub(crate) fn price(&mut self, missing: u64, others: bool) {
        let unknown = self.findings.iter_mut().filter(|finding| finding.cost == Cost::Unknown).collect::<Vec<_>>();
        let cost = match missing {
            0 if others => Cost::Record,
            0 => Cost::Nothing,
            _ if unknown.len() == 1 => Cost::Lost(missing),
            _ => Cost::Unknown,
        };
        for finding in unknown {
            finding.cost = cost;
        }
        self.costly |= others;
        self.lost += missing;
        self.lost_unknown = false;
    }
}

fn messages(count: u64) -> String {
    if count == 1 { "1 message".to_owned() } else { format!("{count} messages") }
}

fn clock(time_ns: u64) -> String {
    let at = OffsetDateTime::UNIX_EPOCH + Duration::from_nanos(time_ns);
    format!("{} {:02}:{:02}:{:02}.{:03} UTC", at.date(), at.hour(), at.minute(), at.second(), at.millisecond())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_calendar() {
        assert_eq!(clock(1_709_210_096_789_000_000), "2024-02-29 12:34:56.789 UTC");
        assert_eq!(clock(1_767_225_599_999_999_999), "2025-12-31 23:59:59.999 UTC");
        assert_eq!(clock(951_782_400_000_000_000), "2000-02-29 00:00:00.000 UTC");
        assert_eq!(clock(1_500_000_000), "1970-01-01 00:00:01.500 UTC");
    }

    #[test]
    fn findings_beyond_the_limit_are_counted_and_cost_as_much() {
        let mut account = Account::default();
        for offset in 0..100 {
            let times_ns = Some((951_782_400_000_000_000, 951_782_400_000_000_000));
            account.add(Finding { offset, bytes: 9, problem: "it is odd".to_owned(), cost: Cost::Lost(2), times_ns });
        }
        assert_eq!((account.findings.len(), account.further, account.lost), (64, 36, 200));
        assert!(!account.is_lossless());
        assert_eq!(account.lines()[7], "at byte 7: it is odd; 2 messages lost, at 2000-02-29 00:00:00.000 UTC");
        assert_eq!(account.lines()[64], "and 36 findings more");
        assert_eq!(account.outcome(), "200 messages lost");
    }
}
