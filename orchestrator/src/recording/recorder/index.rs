//! The index of an MCAP file that still grows: the end of a complete file, available after every write.
//!
//! [`Index::note`] reads the records as they are written; [`Index::tail`] is the end of the file as it is now: end of
//! the data, schemas, channels, counts, the offset of each chunk, footer, magic bytes. (`mcap`'s writer makes a tail
//! too, but only once, when it is finished.)

use mcap::records::{AttachmentHeader, Record, op};
use mcap::{MAGIC, McapError, parse_record};
use std::collections::BTreeMap;

const RECORD_HEAD_BYTES: usize = 9;

#[derive(Debug, Default)]
pub struct Index {
    described: Vec<u8>,
    schemas: u16,
    channels: u32,
    extras: Vec<u8>,
    attachments: u32,
    metadata: u32,
    /// Index records of all chunks but the last: it may still get message indexes.
    chunks: Vec<u8>,
    chunk_count: u32,
    last_chunk: Option<Chunk>,
    messages: BTreeMap<u16, u64>,
    times_ns: Option<(u64, u64)>,
}

#[derive(Debug)]
struct Chunk {
    offset: u64,
    length: u64,
    start_ns: u64,
    end_ns: u64,
    message_indexes: BTreeMap<u16, u64>,
    message_indexes_length: u64,
    compression: String,
    compressed_size: u64,
    uncompressed_size: u64,
}

impl Index {
    /// Describes a schema, before the first message of a channel that uses it. The same one may be described again.
    pub fn schema(&mut self, id: u16, name: &str, encoding: &str, data: &[u8]) {
        // Numbers are given in order, from 1.
        if id > self.schemas {
            self.schemas = id;
            let body = [&id.to_le_bytes()[..], &text(name), &text(encoding), &sized(data)].concat();
            put(&mut self.described, op::SCHEMA, &body);
        }
    }

    pub fn channel(&mut self, id: u16, schema: u16, topic: &str, encoding: &str) {
        self.channels += 1;
        let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
        put(&mut self.described, op::CHANNEL, &[&ids[..], &text(topic), &text(encoding), &sized(&[])].concat());
    }

    pub fn chunk_count(&self) -> u32 {
        self.chunk_count
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
        match record {
            Record::Chunk { header, .. } => {
                self.complete_chunk();
                self.chunk_count += 1;
                self.last_chunk = Some(Chunk {
                    offset,
                    length,
                    start_ns: header.message_start_time,
                    end_ns: header.message_end_time,
                    message_indexes: BTreeMap::new(),
                    message_indexes_length: 0,
                    compression: header.compression.clone(),
                    compressed_size: header.compressed_size,
                    uncompressed_size: header.uncompressed_size,
                });
            }
            Record::MessageIndex(index) => {
                let Some(chunk) = &mut self.last_chunk else { return };
                chunk.message_indexes.insert(index.channel_id, offset);
                chunk.message_indexes_length += length;
                *self.messages.entry(index.channel_id).or_default() += index.records.len() as u64;
                let (start, end) = self.times_ns.unwrap_or((chunk.start_ns, chunk.end_ns));
                self.times_ns = Some((start.min(chunk.start_ns), end.max(chunk.end_ns)));
            }
            Record::Attachment { header, data, .. } => {
                self.attachments += 1;
                let AttachmentHeader { log_time, create_time, name, media_type } = header;
                let numbers = [offset, length, *log_time, *create_time, data.len() as u64].map(u64::to_le_bytes);
                let body = [numbers.as_flattened(), &text(name), &text(media_type)].concat();
                put(&mut self.extras, op::ATTACHMENT_INDEX, &body);
            }
            Record::Metadata(metadata) => {
                self.metadata += 1;
                let numbers = [offset, length].map(u64::to_le_bytes);
                put(&mut self.extras, op::METADATA_INDEX, &[numbers.as_flattened(), &text(&metadata.name)].concat());
            }
            _ => {}
        }
    }

    fn complete_chunk(&mut self) {
        if let Some(chunk) = self.last_chunk.take() {
            put(&mut self.chunks, op::CHUNK_INDEX, &chunk.index());
        }
    }

    pub fn tail(&self, data_end: u64) -> Vec<u8> {
        let mut tail = Vec::new();
        // 0 means that no checksum was calculated.
        put(&mut tail, op::DATA_END, &0u32.to_le_bytes());
        let summary_start = data_end + tail.len() as u64;
        tail.extend_from_slice(&self.described);
        put(&mut tail, op::STATISTICS, &self.statistics());
        tail.extend_from_slice(&self.chunks);
        if let Some(chunk) = &self.last_chunk {
            put(&mut tail, op::CHUNK_INDEX, &chunk.index());
        }
        tail.extend_from_slice(&self.extras);
        // No group of offsets into the summary, no checksum of it.
        let footer = [summary_start.to_le_bytes(), [0; 8]].concat();
        put(&mut tail, op::FOOTER, &[&footer[..], &0u32.to_le_bytes()].concat());
        tail.extend_from_slice(MAGIC);
        tail
    }

    fn statistics(&self) -> Vec<u8> {
        let (start_ns, end_ns) = self.times_ns.unwrap_or_default();
        let mut body = self.messages.values().sum::<u64>().to_le_bytes().to_vec();
        body.extend(self.schemas.to_le_bytes());
        for count in [self.channels, self.attachments, self.metadata, self.chunk_count] {
            body.extend(count.to_le_bytes());
        }
        body.extend([start_ns, end_ns].map(u64::to_le_bytes).as_flattened());
        body.extend(numbers_by_channel(&self.messages));
        body
    }
}

impl Chunk {
    fn index(&self) -> Vec<u8> {
        let place = [self.start_ns, self.end_ns, self.offset, self.length].map(u64::to_le_bytes);
        let sizes = [self.compressed_size, self.uncompressed_size].map(u64::to_le_bytes);
        [
            place.as_flattened(),
            &numbers_by_channel(&self.message_indexes),
            &self.message_indexes_length.to_le_bytes(),
            &text(&self.compression),
            sizes.as_flattened(),
        ]
        .concat()
    }
}

fn put(out: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    out.push(opcode);
    out.extend((body.len() as u64).to_le_bytes());
    out.extend_from_slice(body);
}

fn text(text: &str) -> Vec<u8> {
    sized(text.as_bytes())
}

fn sized(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat()
}

fn numbers_by_channel(map: &BTreeMap<u16, u64>) -> Vec<u8> {
    let mut pairs = Vec::with_capacity(map.len() * 10);
    for (channel, number) in map {
        pairs.extend(channel.to_le_bytes());
        pairs.extend(number.to_le_bytes());
    }
    sized(&pairs)
}
