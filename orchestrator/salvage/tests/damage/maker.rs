//! Recordings to damage, made record by record or by `mcap`'s writer, and readings of them.

use mcap::records::{ChunkHeader, MessageHeader, Metadata, Record, op};
use mcap::write::PrivateRecordOptions;
use mcap::{Attachment, Compression, MAGIC, WriteOptions};
use salvage::{Account, Limits, Trust};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::ops::Range;

/// Messages in [`recording`].
pub const MESSAGES: u64 = 600;

pub struct Read {
    pub account: Account,
    /// Every message: channel, sequence, log time, content.
    pub messages: Vec<(u16, u32, u64, Vec<u8>)>,
    /// Every other record that is kept, in words; without what a repair adds.
    pub others: Vec<String>,
    /// Messages that were handed on as doubtful.
    pub doubtful: u64,
}

/// Reads a file within the usual limits.
pub fn read(file: &[u8]) -> Read {
    read_within(file, &Limits::default())
}

pub fn read_within(file: &[u8], limits: &Limits) -> Read {
    let (mut messages, mut others, mut doubtful) = (Vec::new(), Vec::new(), 0);
    let account = salvage::read(&file, limits, |record, trust| {
        match record {
            Record::Message { header, data } => {
                doubtful += u64::from(trust == Trust::Doubtful);
                messages.push((header.channel_id, header.sequence, header.log_time, data.into_owned()));
            }
            Record::Metadata(Metadata { name, .. }) if name == salvage::REPAIR_METADATA => {}
            Record::Schema { .. } | Record::Channel(_) => {}
            record => others.push(format!("{record:?}")),
        }
        Ok::<_, std::convert::Infallible>(())
    });
    Read { account: account.unwrap(), messages, others, doubtful }
}

pub fn repaired(file: &[u8]) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    salvage::rewrite(&file, &Limits::default(), WriteOptions::new(), &mut out).unwrap();
    out.into_inner()
}

/// Log time of message `number`.
pub fn time_ns(number: u64) -> u64 {
    1_790_000_000_000_000_000 + number * 1_000_000
}

/// A whole recording: three channels, an attachment, metadata, private records in and beside chunks, all checksums.
/// `compression`: that of its chunks; one that nobody knows is written over the name of zstd.
pub fn recording(compression: &str) -> Vec<u8> {
    let packed = if matches!(compression, "" | "lz4") { None } else { Some(Compression::Zstd) };
    let options = WriteOptions::new().compression(packed).chunk_size(Some(6000)).profile("ours").library("maker");
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let metadata = BTreeMap::from([("by".to_owned(), "the maker".to_owned())]);
    writer.write_metadata(&Metadata { name: "notes".to_owned(), metadata }).unwrap();
    let attachment = Attachment {
        log_time: 1,
        create_time: 2,
        name: "config.toml".to_owned(),
        media_type: "application/toml".to_owned(),
        data: Cow::Borrowed(b"seed = 7\nsteps = 12\n"),
    };
    writer.attach(&attachment).unwrap();
    let channels = [("/step", "Step"), ("/log", "Log"), ("/bare", "")].map(|(topic, name)| {
        let schema = match name {
            "" => 0,
            name => writer.add_schema(name, "protobuf", name.repeat(40).as_bytes()).unwrap(),
        };
        writer.add_channel(schema, topic, "protobuf", &BTreeMap::new()).unwrap()
    });
    let mut noise = 1u32;
    for number in 0..MESSAGES {
        let channel_id = channels[number as usize % 7 % 3];
        let time = time_ns(number);
        let header = MessageHeader { channel_id, sequence: number as u32, log_time: time, publish_time: time };
        let mut byte = || {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Half of it can be packed.
            if noise >> 31 == 0 { 0 } else { (noise >> 16) as u8 }
        };
        let data: Vec<u8> = (0..40 + number % 23).map(|_| byte()).collect();
        writer.write_to_known_channel(&header, &data).unwrap();
        if number == 200 {
            writer.write_private_record(0x90, b"between chunks", Default::default()).unwrap();
            writer.write_private_record(0x91, b"in a chunk", PrivateRecordOptions::IncludeInChunks.into()).unwrap();
        }
    }
    writer.finish().unwrap();
    let file = writer.into_inner().into_inner();
    match compression {
        "" | "zstd" => file,
        "lz4" => repacked(&file, "lz4", |data| {
            let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
            std::io::Write::write_all(&mut encoder, data).unwrap();
            encoder.finish().unwrap()
        }),
        name => repacked(&file, name, <[u8]>::to_vec),
    }
}

/// The recording with the content of its chunks packed otherwise. It keeps the statistics, but no checksum of the whole
/// and no index of chunks: their places are others.
fn repacked(file: &[u8], compression: &str, pack: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let mut raw = Raw(MAGIC.to_vec());
    let body = |at: u64, end: u64| &file[at as usize + 9..end as usize];
    for (opcode, at, end) in records(file) {
        match mcap::parse_record(opcode, body(at, end)).unwrap() {
            Record::Chunk { mut header, data } => {
                compression.clone_into(&mut header.compression);
                raw.chunk_of(&header, &pack(&data));
            }
            Record::DataEnd(_) => {
                raw.record(op::DATA_END, &[0; 4]);
                break;
            }
            _ => raw.record(opcode, body(at, end)),
        }
    }
    let summary_start = raw.0.len() as u64;
    let statistics = records(file).into_iter().find(|(opcode, ..)| *opcode == op::STATISTICS).unwrap();
    raw.record(op::STATISTICS, body(statistics.1, statistics.2));
    raw.record(op::FOOTER, &[&summary_start.to_le_bytes()[..], &[0; 12]].concat());
    raw.0.extend_from_slice(MAGIC);
    raw.0
}

/// Opcode, place and end of every record of a whole file.
pub fn records(file: &[u8]) -> Vec<(u8, u64, u64)> {
    let mut records = Vec::new();
    let mut at = MAGIC.len();
    while at + MAGIC.len() < file.len() {
        let end = at + 9 + u64::from_le_bytes(file[at + 1..at + 9].try_into().unwrap()) as usize;
        records.push((file[at], at as u64, end as u64));
        at = end;
    }
    records
}

/// A file that is put together record by record.
#[derive(Clone)]
pub struct Raw(Vec<u8>);

impl Raw {
    /// Magic bytes and a header.
    pub fn new() -> Self {
        let mut raw = Self(MAGIC.to_vec());
        raw.record(op::HEADER, &[text(""), text("x")].concat());
        raw
    }

    /// Any record.
    pub fn record(&mut self, opcode: u8, body: &[u8]) {
        put(&mut self.0, opcode, body);
    }

    /// Schema 1 and channel 1.
    pub fn definitions(&mut self) {
        self.record(op::SCHEMA, &schema(1, "s"));
        self.record(op::CHANNEL, &channel(1, 1, "/t"));
    }

    /// Messages of channel 1.
    pub fn messages(&mut self, numbers: Range<u64>) {
        for number in numbers {
            self.record(op::MESSAGE, &message(1, number));
        }
    }

    /// A chunk of these records, not packed.
    pub fn chunk(&mut self, records: &[(u8, &[u8])]) {
        let mut inside = Vec::new();
        for (opcode, body) in records {
            put(&mut inside, *opcode, body);
        }
        let sum = crc32fast::hash(&inside);
        self.chunk_of(&header("", inside.len(), sum), &inside);
    }

    /// A chunk of these bytes, packed with zstd, without a checksum.
    pub fn packed(&mut self, inside: &[u8]) {
        self.chunk_of(&header("zstd", inside.len(), 0), &zstd::encode_all(inside, 1).unwrap());
    }

    fn chunk_of(&mut self, header: &ChunkHeader, data: &[u8]) {
        let numbers = [header.message_start_time, header.message_end_time, header.uncompressed_size];
        let mut body = numbers.map(u64::to_le_bytes).concat();
        body.extend(header.uncompressed_crc.to_le_bytes());
        body.extend(text(&header.compression));
        body.extend((data.len() as u64).to_le_bytes());
        body.extend_from_slice(data);
        self.record(op::CHUNK, &body);
    }

    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// The file with its end, but without a summary. `sum`: what it says is its data's checksum.
    pub fn end(mut self, sum: u32) -> Vec<u8> {
        self.record(op::DATA_END, &sum.to_le_bytes());
        self.record(op::FOOTER, &[0; 20]);
        self.0.extend_from_slice(MAGIC);
        self.0
    }
}

fn header(compression: &str, size: usize, sum: u32) -> ChunkHeader {
    ChunkHeader {
        message_start_time: 0,
        message_end_time: 0,
        uncompressed_size: size as u64,
        uncompressed_crc: sum,
        compression: compression.to_owned(),
        compressed_size: 0,
    }
}

fn put(out: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    out.push(opcode);
    out.extend((body.len() as u64).to_le_bytes());
    out.extend_from_slice(body);
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// A schema's body.
pub fn schema(id: u16, name: &str) -> Vec<u8> {
    [&id.to_le_bytes()[..], &text(name), &text("protobuf"), &text("")].concat()
}

/// A channel's body.
pub fn channel(id: u16, schema: u16, topic: &str) -> Vec<u8> {
    [&id.to_le_bytes()[..], &schema.to_le_bytes(), &text(topic), &text("protobuf"), &text("")].concat()
}

/// A message's body.
pub fn message(channel: u16, number: u64) -> Vec<u8> {
    let time = time_ns(number).to_le_bytes();
    [&channel.to_le_bytes()[..], &(number as u32).to_le_bytes(), &time, &time, b"hello"].concat()
}
