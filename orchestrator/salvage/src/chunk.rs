use crate::account::Cost;
use crate::layout::{Frame, parse};
use crate::source::{Source, peek};
use crate::state::{Chunk, Outcome, Places, Reader, Trust};
use mcap::records::{ChunkHeader, Record, op};
use std::io::{self, Cursor, Read, copy};

const HEAD_BYTES: u64 = 9 + 32;
const NAME_BYTES_MAX: u32 = 64;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Need {
    Checksum,
    Lengths,
    Nothing,
}

/// Header of what begins as a chunk at `offset`, and where its packed bytes begin and end, which may be beyond the
/// source's end. None where no chunk of a sensible compression begins.
pub(crate) fn chunk_header(source: &dyn Source, offset: u64) -> io::Result<Option<(ChunkHeader, u64, u64)>> {
    let name_bytes = peek(source, offset + HEAD_BYTES - 4)?.map_or(u32::MAX, u32::from_le_bytes);
    let data = offset + HEAD_BYTES + u64::from(name_bytes) + 8;
    if name_bytes > NAME_BYTES_MAX || data > source.length() {
        return Ok(None);
    }
    // Without its packed bytes, of which there may be too many.
    let mut content = source.bytes(offset + 9..data)?.into_owned();
    let size = content.len() - 8..;
    content[size].fill(0);
    let Some(Record::Chunk { header, .. }) = parse(op::CHUNK, &content) else { return Ok(None) };
    let compressed_size = peek(source, data - 8)?.map_or(0, u64::from_le_bytes);
    Ok(Some((ChunkHeader { compressed_size, ..header }, data, data.saturating_add(compressed_size))))
}

impl<E> Reader<'_, E> {
    /// Reads the chunk at `offset`, which reaches to `until` at most, if it has what it needs; returns its end.
    pub(crate) fn chunk(&mut self, offset: u64, until: u64, need: Need) -> Outcome<Option<u64>, E> {
        let Some((header, data, end)) = chunk_header(self.source, offset)? else { return Ok(None) };
        let (is_known, sum) = (is_known(&header.compression), header.uncompressed_crc);
        let most = self.limits.chunk_bytes.min(self.budget);
        let sizes = header.compressed_size.max(header.uncompressed_size);
        if match need {
            Need::Checksum => !is_known || sum == 0 || end > until || sizes > most,
            Need::Lengths => false,
            Need::Nothing => !is_known || data > until,
        } {
            return Ok(None);
        }
        let packed = self.source.bytes(data..end.min(until).min(data + self.limits.record_bytes.min(self.budget)))?;
        let (bytes, is_all) = unpack(&header.compression, &packed, most);
        self.budget = self.budget.saturating_sub((packed.len() + bytes.len()) as u64);
        let sum_agrees = if sum == 0 { need == Need::Lengths } else { sum == crc32fast::hash(&bytes) };
        let is_whole = is_known && is_all && sum_agrees;
        if need == Need::Checksum && !is_whole {
            return Ok(None);
        }
        let trust = if is_whole { Trust::Sound } else { Trust::Doubtful };
        self.inside = Some(Chunk { offset, trust, places: Places::new(), unreadable: false });
        self.records(&&bytes[..], 0..bytes.len() as u64)?;
        let Some(mut chunk) = self.inside.take() else { return Ok(None) };

        let range = offset..if need == Need::Checksum { end } else { until };
        let said_ns = Some((header.message_start_time, header.message_end_time));
        let times_ns = said_ns.filter(|(from, to)| from <= to && *to != 0);
        let lost = if !is_known {
            let name = header.compression.escape_debug();
            Some(format!("a chunk's compression `{name}` is not known (only zstd and lz4 are)"))
        } else if !is_all || need == Need::Nothing && !is_whole {
            Some("a chunk cannot be unpacked to its end, or is bigger than is read".to_owned())
        } else {
            chunk.unreadable.then(|| "no record can be recognised in a part of a chunk".to_owned())
        };
        let count = chunk.places.values().map(Vec::len).sum::<usize>() as u64;
        if !is_whole && (lost.is_none() || count > 0) {
            let problem = "a chunk's checksum does not agree with its content";
            self.finding(range.clone(), problem, Cost::Doubt(count), times_ns);
        }
        if let Some(problem) = lost {
            self.finding(range, problem, Cost::Unknown, times_ns);
        } else if is_whole && need == Need::Nothing {
            self.finding(range, "the head of a chunk was altered", Cost::Nothing, None);
        }
        let times = chunk.places.values().flatten().map(|(time_ns, _)| *time_ns);
        let seen_ns = times.clone().min().zip(times.max());
        // Some writers leave both times 0.
        let is_timed = seen_ns.is_none() || [Some((0, 0)), seen_ns].contains(&said_ns);
        if is_whole && !(is_timed && header.uncompressed_size == bytes.len() as u64) {
            self.odd_chunk.get_or_insert(offset);
        }
        chunk.places.values_mut().for_each(|messages| messages.sort_unstable());
        self.indexed = (trust, chunk.places);
        Ok(Some(end.min(until)))
    }

    /// Whether the content of this record is an index of the chunk before, whatever its head says.
    pub(crate) fn is_index(&mut self, frame: Frame) -> io::Result<bool> {
        let Some(id) = peek(self.source, frame.content())? else { return Ok(false) };
        let messages = self.indexed.1.get(&u16::from_le_bytes(id)).map_or(0, Vec::len);
        if frame.length != 6 + 16 * messages as u64 || frame.end() > self.source.length() || !self.afford(frame.length)
        {
            return Ok(false);
        }
        let content = self.source.bytes(frame.content()..frame.end())?;
        let Some(Record::MessageIndex(index)) = parse(op::MESSAGE_INDEX, &content) else { return Ok(false) };
        let mut entries: Vec<_> = index.records.iter().map(|entry| (entry.log_time, entry.offset)).collect();
        entries.sort_unstable();
        Ok(self.indexed.1.get(&index.channel_id).map_or(entries.is_empty(), |messages| *messages == entries))
    }
}

pub(crate) fn is_known(compression: &str) -> bool {
    matches!(compression, "" | "zstd" | "lz4")
}

/// What can be unpacked, `limit` bytes at most, and whether that is all.
fn unpack(compression: &str, packed: &[u8], limit: u64) -> (Vec<u8>, bool) {
    // Not into the vector itself, for which `copy` reads larger portions: one that ends in an error is lost.
    let mut out = Cursor::new(Vec::new());
    let unpacked = match compression {
        "" => copy(&mut packed.take(limit + 1), &mut out),
        // The decoder itself refuses frames that want more than 128 MiB of memory.
        "zstd" => zstd::stream::read::Decoder::with_buffer(packed)
            .and_then(|decoder| copy(&mut decoder.take(limit + 1), &mut out)),
        "lz4" => copy(&mut lz4_flex::frame::FrameDecoder::new(packed).take(limit + 1), &mut out),
        _ => Ok(0),
    };
    let mut out = out.into_inner();
    let is_all = unpacked.is_ok() && out.len() as u64 <= limit;
    out.truncate(limit as usize);
    (out, is_all)
}
