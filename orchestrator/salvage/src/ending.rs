//! The end of a file: checksums, statistics and indexes, compared with what was read.

use crate::account::{Account, Cost, Problem, REPAIR_METADATA};
use crate::layout::{END_MARK, Frame, HEAD_BYTES, PRIVATE, Shape, map_fits, next_frame, shape};
use crate::source::{Source, peek};
use crate::state::{Reader, Stop, Trust};
use mcap::parse_record;
use mcap::records::{Footer, Metadata, Record, Statistics, op};
use std::ops::Range;

/// Opcode, length and content of a footer, and the magic bytes after it.
const FOOTER_BYTES: u64 = HEAD_BYTES + 20 + END_MARK.len() as u64;
/// A record of the summary that is bigger than this is not looked at for definitions.
const DEFINITION_BYTES_MAX: u64 = 16 << 20;

/// Where the footer does not point to the summary, it is looked for in so many bytes before it, ...
const SUMMARY_BYTES_MAX: u64 = 4 << 20;
/// ... behind so many of what may be marks of the data's end.
const SUMMARY_MARKS_MAX: u32 = 16;

/// Of the accounts of earlier repairs no more is kept than until this is reached.
const EARLIER_REPAIRS_BYTES: usize = 1024;

impl<S: Source> Reader<'_, S> {
    /// Schemas and channels that the summary repeats, if there is one at the end.
    pub(crate) fn read_spare_definitions(&mut self) -> Result<(), Stop> {
        let length = self.source.length();
        let Some(offset) = length.checked_sub(FOOTER_BYTES) else { return Ok(()) };
        let is_footer =
            Frame::at(self.source, offset)?.is_some_and(|frame| (frame.opcode, frame.length) == (op::FOOTER, 20));
        if !is_footer || !self.is_end_mark(length - END_MARK.len() as u64)? {
            return Ok(());
        }
        let long = |at| Ok::<_, Stop>(peek(self.source, at)?.map_or(0, u64::from_le_bytes));
        let said = long(offset + HEAD_BYTES)?;
        let Some(start) = self.summary_start(said, offset)? else { return Ok(()) };
        let saved = peek(self.source, offset + HEAD_BYTES + 16)?.map_or(0, u32::from_le_bytes);
        let proven = saved != 0 && saved == self.sum(start..offset + HEAD_BYTES + 16)?;
        let mut at = start;
        while at < offset {
            let Some(frame) = Frame::at(self.source, at)? else { break };
            let Some(end) = frame.end(offset) else { break };
            at = end;
            if !matches!(frame.opcode, op::SCHEMA | op::CHANNEL)
                || frame.length > DEFINITION_BYTES_MAX
                || shape(self.source, frame.opcode, frame.content(), end)? == Shape::Wrong
            {
                continue;
            }
            let mut content = vec![0; frame.length as usize];
            self.source.peek(frame.content(), &mut content)?;
            if map_fits(frame.opcode, &content)
                && let Ok(record) = parse_record(frame.opcode, &content)
            {
                self.definitions.spare(&record, proven);
            }
        }
        Ok(())
    }

    /// Where the summary before the footer at `footer` begins: where that says, or behind a mark of the data's end from
    /// which on records follow each other up to it.
    fn summary_start(&self, said: u64, footer: u64) -> Result<Option<u64>, Stop> {
        let reaches = |start: u64| -> Result<bool, Stop> {
            let mut at = start;
            while at < footer {
                let frame =
                    Frame::at(self.source, at)?.filter(|frame| matches!(frame.opcode, 1..=op::DATA_END | PRIVATE..));
                let Some(end) = frame.and_then(|frame| frame.end(footer)) else { return Ok(false) };
                at = end;
            }
            Ok(true)
        };
        if said == 0 || said < footer && reaches(said)? {
            return Ok(Some(said).filter(|said| *said != 0));
        }
        let mut from = footer.saturating_sub(SUMMARY_BYTES_MAX);
        for _ in 0..SUMMARY_MARKS_MAX {
            let mark =
                next_frame(self.source, from, footer, |frame| Ok((frame.opcode, frame.length) == (op::DATA_END, 4)))?;
            let Some(mark) = mark else { break };
            let start = mark.content() + mark.length;
            if reaches(start)? {
                return Ok(Some(start));
            }
            from = mark.offset + 1;
        }
        Ok(None)
    }

    /// The mark of the data's end.
    pub(crate) fn data_end(&mut self, offset: u64, end: u64, saved: u32) -> Result<(), Stop> {
        (self.ending.data_end, self.ending.marked) = (Some(end), true);
        let findings = &self.account.findings;
        let explained = self.account.further > 0 || !findings.iter().all(|finding| finding.problem.may_be_original());
        // 0 stands for a checksum that was not calculated. Where something was altered already, that is why.
        if saved != 0 && !explained && saved != self.sum(0..offset)? {
            self.account.doubtful += self.unchecked;
            self.finding(0, offset, Problem::DataSum, Cost::Doubt(self.unchecked));
        }
        Ok(())
    }

    /// A record after that mark. False where its content cannot be parsed.
    pub(crate) fn after_data(&mut self, frame: Frame, end: u64, record: Record<'_>) -> Result<bool, Stop> {
        let bytes = end - frame.offset;
        let is_data = matches!(record, Record::Chunk { .. } | Record::Metadata(_));
        if is_data && !self.ending.wrong {
            self.ending.wrong = true;
            let problem = Problem::Summary("data comes after the mark of its end");
            self.finding(frame.offset, bytes, problem, Cost::Nothing);
        }
        match record {
            Record::Footer(footer) => self.footer(frame, footer)?,
            Record::Statistics(statistics) => self.ending.statistics = Some(statistics),
            Record::Chunk { header, data } => self.chunk_record(frame.offset, end, &header, (&data, true))?,
            Record::MessageIndex(index) => self.message_index(frame.offset, end, &index),
            Record::Metadata(_) => self.hand_on(record, Trust::Doubtful)?,
            Record::Schema { .. } | Record::Channel(_) | Record::SummaryOffset(_) => {}
            Record::ChunkIndex(_) | Record::AttachmentIndex(_) | Record::MetadataIndex(_) => {
                self.ending.compare(&record);
            }
            _ => self.finding(frame.offset, bytes, Problem::Misplaced(frame.opcode), Cost::Nothing),
        }
        Ok(true)
    }

    /// The footer: where the summary begins, and its checksum.
    pub(crate) fn footer(&mut self, frame: Frame, footer: Footer) -> Result<(), Stop> {
        self.ending.footer = Some(footer);
        let start = footer.summary_start;
        let begins = self.ending.data_end.is_none_or(|end| start == end || start == 0 && frame.offset == end);
        self.ending.begins = begins;
        if !begins {
            let problem = Problem::Summary("the footer does not point to the summary");
            self.finding(frame.offset, HEAD_BYTES + frame.length, problem, Cost::Nothing);
        }
        if footer.summary_crc != 0 {
            // Where bytes before it were inserted or are gone, the summary is not where the footer says.
            let sum_end = frame.content() + 16;
            for start in [Some(start).filter(|start| *start != 0), self.ending.data_end, Some(frame.offset)] {
                let Some(start) = start.filter(|start| *start <= frame.offset) else { continue };
                self.ending.proven |= self.sum(start..sum_end)? == footer.summary_crc;
            }
            if !self.ending.proven && begins {
                let problem = Problem::Summary("the summary's checksum does not agree");
                self.finding(frame.offset, HEAD_BYTES + frame.length, problem, Cost::Nothing);
            }
        }
        Ok(())
    }

    /// After the footer, at `at`, or wherever reading ended.
    pub(crate) fn finish(&mut self, at: u64) -> Result<(), Stop> {
        let length = self.source.length();
        if self.ending.footer.is_some() && !self.is_end_mark(at)? {
            let marked = peek(self.source, at)? == Some(END_MARK);
            let what = if marked { "something comes after the end mark" } else { "the end mark is missing" };
            self.account.cut |= !marked;
            self.finding(at, length - at, Problem::Summary(what), Cost::Nothing);
        }
        let consistent = |statistics: &Statistics| {
            let counts = statistics.channel_message_counts.values();
            counts.fold(0u64, |sum, count| sum.saturating_add(*count)) == statistics.message_count
        };
        let ending = &mut self.ending;
        let unsummed = ending.footer.is_some_and(|footer| footer.summary_crc == 0);
        // Where a recorder was killed between two writes, a piece of an older end may stand after newer data.
        if let Some(statistics) = ending.statistics.take()
            && (ending.proven || ending.begins && ending.marked && unsummed && consistent(&statistics))
        {
            self.reconcile(&statistics);
        }
        Ok(())
    }

    /// What the statistics say beside what was read.
    fn reconcile(&mut self, statistics: &Statistics) {
        let whole_until_now = self.account.is_whole();
        let account = &mut self.account;
        let (expected, got) = (statistics.message_count, account.messages);
        let missing = expected.saturating_sub(got);
        let others = (statistics.attachment_count as usize).saturating_sub(self.ending.attachments.len())
            + (statistics.metadata_count as usize).saturating_sub(self.ending.metadata.len());
        if account.lost_unknown && missing >= account.lost {
            price(account, missing - account.lost, others > 0);
        } else if !whole_until_now && missing > account.lost {
            let further = missing - account.lost;
            self.add_lost(expected, further);
        }
        if whole_until_now {
            let ending = &self.ending;
            let chunk_count = statistics.chunk_count as usize;
            let wrong = ending.wrong
                || ending.chunk_indexes != 0 && ending.chunk_indexes != ending.chunks.len()
                || chunk_count != ending.chunks.len();
            if expected != got {
                let cost = if missing > 0 { Cost::Lost(Some(missing)) } else { Cost::Doubt(got - expected) };
                self.finding(0, self.source.length(), Problem::Count(expected), cost);
            } else if others > 0 {
                self.finding(
                    0,
                    self.source.length(),
                    Problem::Summary("an attachment or metadata is missing"),
                    Cost::Record,
                );
            } else if wrong {
                self.finding(0, self.source.length(), Problem::Index, Cost::Nothing);
            }
        }
    }

    /// More is lost than findings say: with bytes of a chunk, an index of its messages may be gone that stood behind it.
    fn add_lost(&mut self, expected: u64, further: u64) {
        let findings = self.account.findings.iter_mut();
        let mut lost: Vec<_> = findings.filter(|finding| matches!(finding.cost, Cost::Lost(_))).collect();
        if let [finding] = &mut lost[..]
            && let Cost::Lost(Some(count)) = &mut finding.cost
        {
            *count += further;
            self.account.lost += further;
        } else {
            self.finding(0, self.source.length(), Problem::Count(expected), Cost::Lost(Some(further)));
        }
    }

    /// The checksum of a part of the file.
    fn sum(&self, range: Range<u64>) -> Result<u32, Stop> {
        const BLOCK: u64 = 256 << 10;
        let mut hasher = crc32fast::Hasher::new();
        let mut block = Vec::new();
        let mut at = range.start;
        while at < range.end {
            block.resize((range.end - at).min(BLOCK) as usize, 0);
            self.source.peek(at, &mut block)?;
            hasher.update(&block);
            at += block.len() as u64;
        }
        Ok(hasher.finalize())
    }

    /// An earlier repair left in the file what it lost.
    pub(crate) fn note_earlier_repair(&mut self, metadata: &Metadata) {
        if metadata.name == REPAIR_METADATA
            && let Some(outcome) = metadata.metadata.get("outcome")
        {
            let known = self.account.repaired_with_loss.get_or_insert_default();
            if known.len() < EARLIER_REPAIRS_BYTES {
                let between = if known.is_empty() { "" } else { "; then " };
                *known = format!("{known}{between}{outcome}");
            }
        }
    }
}

/// Now that the number of missing messages is known: sets the cost of the findings whose cost was not.
fn price(account: &mut Account, missing: u64, others: bool) {
    let unknown = account.findings.iter_mut().filter(|finding| finding.cost == Cost::Lost(None));
    let mut unknown: Vec<_> = unknown.collect();
    if missing == 0 {
        for finding in unknown {
            finding.cost = if others { Cost::Record } else { Cost::Nothing };
        }
        if others {
            account.charge(Cost::Record);
        }
    } else if let [finding] = &mut unknown[..] {
        finding.cost = Cost::Lost(Some(missing));
    }
    account.lost += missing;
    account.lost_unknown = false;
}
