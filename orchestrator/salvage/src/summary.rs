use crate::layout::{Frame, MAGIC, PRIVATE, find_frame, parse, sum};
use crate::source::{Source, peek};
use mcap::records::{Channel, Record, SchemaHeader, Statistics, op};
use std::collections::BTreeMap;
use std::io::Result;

/// The end mark is looked for in so many bytes, ...
const END_BYTES: u64 = 4096;
/// ... the mark of the data's end in so many before it, ...
const SUMMARY_BYTES: u64 = 4 << 20;
/// ... of which so many are tried.
const MARKS_MAX: u32 = 16;
const KEPT_BYTES_MAX: u64 = 64 << 20;

pub(crate) type Schema = (SchemaHeader, Vec<u8>);

#[derive(Debug, Default)]
pub(crate) struct Summary {
    pub start: u64,
    /// Where the file should end: behind the end mark.
    end: u64,
    /// Its checksum agrees; without one, its records follow each other up to the footer.
    pub intact: bool,
    pub schemas: BTreeMap<u16, Schema>,
    pub channels: BTreeMap<u16, Channel>,
    pub statistics: Option<Statistics>,
}

impl Summary {
    /// The summary; none where the end mark is missing, or neither footer nor mark of the data's end lead to it.
    pub fn read(source: &dyn Source) -> Result<Option<Self>> {
        let tail = source.length().saturating_sub(END_BYTES);
        let bytes = source.bytes(tail..source.length())?;
        let Some(mark) = bytes.windows(MAGIC.len()).rposition(|window| window == MAGIC) else { return Ok(None) };
        let mark = tail + mark as u64;
        // Head and content of the footer.
        let Some(footer) = mark.checked_sub(9 + 20) else { return Ok(None) };
        let readable = Frame::at(source, footer)?.is_some_and(|frame| (frame.opcode, frame.length) == (op::FOOTER, 20));
        let said = peek(source, footer + 9)?.filter(|_| readable).map_or(u64::MAX, u64::from_le_bytes);
        let saved = peek(source, mark - 4)?.map_or(0, u32::from_le_bytes);
        let mut tries = MARKS_MAX;
        let marked = find_frame(source, footer.saturating_sub(SUMMARY_BYTES)..footer, |frame| {
            let is_mark = (frame.opcode, frame.length) == (op::DATA_END, 4) && tries > 0;
            tries -= u32::from(is_mark);
            Ok(is_mark && (frame.end() == said || reaches(source, frame.end(), footer)?))
        })?;
        let start = match marked {
            Some(mark) => mark.end(),
            None if said == 0 => footer,
            None if reaches(source, said, footer)? => said,
            None => return Ok(None),
        };
        let intact = if saved == 0 { reaches(source, start, footer)? } else { saved == sum(source, start..mark - 4)? };
        let mut summary = Self { start, end: mark + MAGIC.len() as u64, intact, ..Self::default() };
        summary.read_records(source, footer)?;
        Ok(Some(summary))
    }

    fn read_records(&mut self, source: &dyn Source, footer: u64) -> Result<()> {
        let (mut at, mut kept_bytes) = (self.start, 0);
        while let Some(frame) = Frame::at(source, at)?.filter(|frame| frame.end() <= footer) {
            at = frame.end();
            let is_wanted = matches!(frame.opcode, op::SCHEMA | op::CHANNEL | op::STATISTICS);
            if !is_wanted || kept_bytes + frame.length > KEPT_BYTES_MAX {
                continue;
            }
            kept_bytes += frame.length;
            match parse(frame.opcode, &source.bytes(frame.content()..at)?) {
                Some(Record::Schema { header, data }) => {
                    self.schemas.insert(header.id, (header, data.into_owned()));
                }
                Some(Record::Channel(channel)) => {
                    self.channels.insert(channel.id, channel);
                }
                // Where a recorder was killed between two writes, an older end may stand after newer data.
                Some(Record::Statistics(statistics)) if self.intact => self.statistics = Some(statistics),
                _ => {}
            }
        }
        Ok(())
    }

    pub fn problem(&self, data_end: Option<u64>, length: u64) -> Option<&'static str> {
        let checks = [
            (data_end == Some(self.start), "the end of the data is not marked"),
            (self.intact, "the summary's checksum does not agree"),
            (self.end == length, "something comes after the end mark"),
        ];
        checks.into_iter().find(|(agrees, _)| !agrees).map(|(_, problem)| problem)
    }
}

/// Whether records of a summary follow each other from `start` to `footer`.
fn reaches(source: &dyn Source, start: u64, footer: u64) -> Result<bool> {
    let mut at = start;
    while at < footer {
        let Some(frame) = Frame::at(source, at)? else { return Ok(false) };
        let is_data = matches!(frame.opcode, op::MESSAGE..=op::MESSAGE_INDEX | op::ATTACHMENT | op::METADATA);
        if is_data || !matches!(frame.opcode, op::SCHEMA..op::DATA_END | PRIVATE..) {
            return Ok(false);
        }
        at = frame.end();
    }
    Ok(at == footer)
}
