use crate::account::{Account, Cost};
use crate::layout::{Frame, MAGIC, parse};
use crate::source::{Source, peek};
use crate::state::{Definitions, Limits, Places, ReadError, Reader, Trust};
use crate::summary::Summary;
use mcap::records::{Header, Record, op};

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

impl<E> Reader<'_, E> {
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
