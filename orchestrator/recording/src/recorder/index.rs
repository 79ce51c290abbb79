//! The index of an MCAP file that still grows: the end of a complete file, available after every write.
//!
//! [`Index::note`] reads the records as they are written; [`Index::tail`] is the end of the file as it is now: end of
//! the data, schemas, channels, counts, the offset of each chunk, footer, magic bytes. (`mcap`'s writer makes a tail
//! too, but only once, when it is finished.)

use binrw::BinWrite;
use mcap::records::{
    AttachmentHeader, AttachmentIndex, Channel, ChunkIndex, DataEnd, Footer, MetadataIndex, Record, SchemaHeader,
    Statistics, op,
};
use mcap::{MAGIC, McapError, parse_record};
use std::collections::BTreeMap;
use std::io::Cursor;

const RECORD_HEAD_BYTES: usize = 9;

#[derive(Debug, Default)]
pub struct Index {
    /// Schema and channel records as a file's summary holds them.
    described: Vec<u8>,
    extras: Vec<u8>,
    /// Index records of all chunks but the last: it may still get message indexes.
    chunks: Vec<u8>,
    last_chunk: Option<ChunkIndex>,
    statistics: Statistics,
}

impl Index {
    /// Describes a schema, before the first message of a channel that uses it. The same one may be described again.
    pub fn schema(&mut self, id: u16, name: &str, encoding: &str, data: &[u8]) {
        // Numbers are given in order, from 1.
        if id > self.statistics.schema_count {
            self.statistics.schema_count = id;
            let header = SchemaHeader { id, name: name.to_owned(), encoding: encoding.to_owned() };
            put(&mut self.described, op::SCHEMA, &(header, data.len() as u32, data.to_vec()));
        }
    }

    pub fn channel(&mut self, id: u16, schema_id: u16, topic: &str, encoding: &str) {
        self.statistics.channel_count += 1;
        let (topic, message_encoding, metadata) = (topic.to_owned(), encoding.to_owned(), BTreeMap::new());
        put(&mut self.described, op::CHANNEL, &Channel { id, schema_id, topic, message_encoding, metadata });
    }

    pub fn chunk_count(&self) -> u32 {
        self.statistics.chunk_count
    }

    /// Notes whole records that were written from `offset` on. Returns whether the data ends in them: then what comes
    /// after it is the writer's own tail.
    pub fn note(&mut self, mut offset: u64, mut bytes: &[u8]) -> Result<bool, McapError> {
        while !bytes.is_empty() {
            let head = bytes.get(..RECORD_HEAD_BYTES).ok_or(McapError::UnexpectedEof)?;
            if head[0] == op::DATA_END {
                return Ok(true);
            }
            let length = u64::from_le_bytes(head[1..].try_into().expect("the head's last eight bytes"));
            let end = RECORD_HEAD_BYTES + usize::try_from(length).map_err(|_| McapError::UnexpectedEof)?;
            let body = bytes.get(RECORD_HEAD_BYTES..end).ok_or(McapError::UnexpectedEof)?;
            self.record(offset, end as u64, &parse_record(head[0], body)?);
            offset += end as u64;
            bytes = &bytes[end..];
        }
        Ok(false)
    }

    fn record(&mut self, offset: u64, length: u64, record: &Record<'_>) {
        let all = &mut self.statistics;
        match record {
            Record::Chunk { header, .. } => {
                all.chunk_count += 1;
                let next = ChunkIndex {
                    message_start_time: header.message_start_time,
                    message_end_time: header.message_end_time,
                    chunk_start_offset: offset,
                    chunk_length: length,
                    message_index_offsets: BTreeMap::new(),
                    message_index_length: 0,
                    compression: header.compression.clone(),
                    compressed_size: header.compressed_size,
                    uncompressed_size: header.uncompressed_size,
                };
                if let Some(complete) = self.last_chunk.replace(next) {
                    put(&mut self.chunks, op::CHUNK_INDEX, &complete);
                }
            }
            Record::MessageIndex(index) => {
                let Some(chunk) = &mut self.last_chunk else { return };
                chunk.message_index_offsets.insert(index.channel_id, offset);
                chunk.message_index_length += length;
                let is_first = all.channel_message_counts.is_empty();
                let start = if is_first { chunk.message_start_time } else { all.message_start_time };
                all.message_start_time = start.min(chunk.message_start_time);
                all.message_end_time = all.message_end_time.max(chunk.message_end_time);
                all.message_count += index.records.len() as u64;
                *all.channel_message_counts.entry(index.channel_id).or_default() += index.records.len() as u64;
            }
            Record::Attachment { header, data, .. } => {
                all.attachment_count += 1;
                let AttachmentHeader { log_time, create_time, name, media_type } = header.clone();
                let data_size = data.len() as u64;
                let index = AttachmentIndex { offset, length, log_time, create_time, data_size, name, media_type };
                put(&mut self.extras, op::ATTACHMENT_INDEX, &index);
            }
            Record::Metadata(metadata) => {
                all.metadata_count += 1;
                let index = MetadataIndex { offset, length, name: metadata.name.clone() };
                put(&mut self.extras, op::METADATA_INDEX, &index);
            }
            _ => {}
        }
    }

    pub fn tail(&self, data_end: u64) -> Vec<u8> {
        let mut tail = Vec::new();
        // 0 means that no checksum was calculated.
        put(&mut tail, op::DATA_END, &DataEnd { data_section_crc: 0 });
        let summary_start = data_end + tail.len() as u64;
        tail.extend_from_slice(&self.described);
        put(&mut tail, op::STATISTICS, &self.statistics);
        tail.extend_from_slice(&self.chunks);
        if let Some(chunk) = &self.last_chunk {
            put(&mut tail, op::CHUNK_INDEX, chunk);
        }
        tail.extend_from_slice(&self.extras);
        // No group of offsets into the summary, no checksum of it.
        put(&mut tail, op::FOOTER, &Footer { summary_start, summary_offset_start: 0, summary_crc: 0 });
        tail.extend_from_slice(MAGIC);
        tail
    }
}

fn put(out: &mut Vec<u8>, opcode: u8, record: &impl for<'a> BinWrite<Args<'a> = ()>) {
    let mut body = Vec::new();
    record.write_le(&mut Cursor::new(&mut body)).expect("memory takes any record");
    out.push(opcode);
    out.extend((body.len() as u64).to_le_bytes());
    out.append(&mut body);
}
