//! MCAP files on disk: one segment after another, each complete in itself.
//!
//! A segment begins with the run's configuration and identity, so that any one file can be replayed alone. Chunks go
//! to disk whole ([`WriteOptions::disable_seeking`]) and at least each second, so that a killed recorder leaves a
//! file that is good up to its last chunk. One segment is one file and never appended to.

use crate::schema::{PROTOBUF, descriptor_of};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};
use proto::SCHEMA_VERSION;
use proto::config::Config;
use proto::run_folder::RunFolder;
use std::borrow::Cow;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Name of the attachment that holds the effective configuration.
pub const CONFIG_ATTACHMENT: &str = "config.toml";
/// Name of the metadata record that says which run this is.
pub const IDENTITY_METADATA: &str = "stillroom";
/// Keys of that record.
pub mod identity {
    /// Run id: letters and digits.
    pub const RUN_ID: &str = "run_id";
    /// Incarnation of the orchestrator.
    pub const INCARNATION: &str = "incarnation";
    /// Number of the segment within the incarnation, from 0.
    pub const SEGMENT: &str = "segment";
    /// Version of the recording's schemas and of all payloads.
    pub const SCHEMA_VERSION: &str = "schema_version";
    /// Seed of the run.
    pub const SEED: &str = "seed";
    /// Preset that the configuration came from.
    pub const PRESET: &str = "preset";
}

/// Target size of a chunk before compression, bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// A recording that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write recording {path}: {cause}", path = .path.display())]
pub struct SegmentError {
    /// The segment.
    pub path: PathBuf,
    /// What the file system or the writer said.
    pub cause: McapError,
}

/// How all our MCAP files are written.
pub fn write_options() -> WriteOptions {
    WriteOptions::new()
        .library(concat!("stillroom-orchestrator/", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Zstd))
        // Depth frames shrink 3 to 40 times at the fastest level; higher ones cost more than the disk they save.
        .compression_level(1)
        // The default, a thread for each core, would take them from the simulators.
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        .disable_seeking(true)
}

/// A topic, known to all segments of an incarnation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic(usize);

#[derive(Debug)]
struct TopicEntry {
    name: String,
    message: &'static str,
    sequence: u32,
    /// Its number in the open segment, once something was written.
    channel: Option<u16>,
}

/// What every segment begins with.
#[derive(Debug, Clone)]
pub struct Preamble {
    /// Run id.
    pub run_id: String,
    /// Incarnation of the orchestrator.
    pub incarnation: u32,
    /// The run's configuration.
    pub config: Config,
}

/// The segments of one incarnation.
pub struct Segments {
    folder: RunFolder,
    preamble: Preamble,
    topics: Vec<TopicEntry>,
    open: Option<Writer<CountedFile>>,
    files: Vec<PathBuf>,
    finished_bytes: u64,
    open_bytes: Rc<Cell<u64>>,
}

impl Segments {
    /// Begins with the first segment; creates the folder of recordings if it is missing.
    pub fn create(folder: RunFolder, preamble: Preamble, time_ns: u64) -> Result<Self, SegmentError> {
        std::fs::create_dir_all(folder.recordings())
            .map_err(|cause| SegmentError { path: folder.recordings(), cause: cause.into() })?;
        let mut segments = Self {
            folder,
            preamble,
            topics: Vec::new(),
            open: None,
            files: Vec::new(),
            finished_bytes: 0,
            open_bytes: Rc::default(),
        };
        segments.begin(time_ns)?;
        Ok(segments)
    }

    /// Registers a topic that carries `message`, the full name of a message in `schemas/`.
    pub fn topic(&mut self, name: String, message: &'static str) -> Topic {
        self.topics.push(TopicEntry { name, message, sequence: 0, channel: None });
        Topic(self.topics.len() - 1)
    }

    /// Writes one encoded message; begins the next segment when this one is full.
    pub fn write(&mut self, topic: Topic, time_ns: u64, data: &[u8]) -> Result<(), SegmentError> {
        if self.open_bytes.get() >= self.preamble.config.recording.segment_bytes {
            self.finish()?;
            self.begin(time_ns)?;
        }
        let channel = match self.topics[topic.0].channel {
            Some(channel) => channel,
            None => self.announce(topic)?,
        };
        let entry = &mut self.topics[topic.0];
        let header =
            MessageHeader { channel_id: channel, sequence: entry.sequence, log_time: time_ns, publish_time: time_ns };
        entry.sequence = entry.sequence.wrapping_add(1);
        self.writing(|writer| writer.write_to_known_channel(&header, data))
    }

    /// Hands everything written so far to the operating system.
    pub fn flush(&mut self) -> Result<(), SegmentError> {
        self.writing(Writer::flush)
    }

    /// Completes the open segment: index, end mark, and all of it on the disk.
    pub fn finish(&mut self) -> Result<(), SegmentError> {
        let Some(mut writer) = self.open.take() else { return Ok(()) };
        let path = self.path().to_path_buf();
        let finished = writer.finish().and_then(|_| Ok(writer.into_inner().sync()?));
        // The folder too, or the file may have no name after a power cut.
        let finished = finished.and_then(|()| Ok(File::open(self.folder.recordings())?.sync_all()?));
        self.finished_bytes += self.open_bytes.take();
        finished.map_err(|cause| SegmentError { path, cause })
    }

    /// Gives the open segment up after a failure: nothing more is written, not even by its destructor.
    pub fn abandon(mut self) {
        if let Some(writer) = self.open.take() {
            writer.into_inner().discard();
        }
    }

    /// All segments so far, in order.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.finished_bytes + self.open_bytes.get()
    }

    fn begin(&mut self, time_ns: u64) -> Result<(), SegmentError> {
        let segment = self.files.len() as u32;
        let path = self.folder.recording(self.preamble.incarnation, segment);
        self.files.push(path.clone());
        for topic in &mut self.topics {
            topic.channel = None;
        }
        let config = self.preamble.config.to_toml();
        let metadata = self.identity(segment);
        let begun = CountedFile::create(&path, self.open_bytes.clone()).map_err(McapError::from).and_then(|file| {
            let mut writer = write_options().create(file)?;
            writer.write_metadata(&metadata)?;
            writer.attach(&Attachment {
                log_time: time_ns,
                create_time: time_ns,
                name: CONFIG_ATTACHMENT.to_owned(),
                media_type: "application/toml".to_owned(),
                data: Cow::Borrowed(config.as_bytes()),
            })?;
            writer.flush()?;
            Ok(writer)
        });
        self.open = Some(begun.map_err(|cause| SegmentError { path, cause })?);
        Ok(())
    }

    fn identity(&self, segment: u32) -> Metadata {
        let config = &self.preamble.config;
        let pairs = [
            (identity::RUN_ID, self.preamble.run_id.clone()),
            (identity::INCARNATION, self.preamble.incarnation.to_string()),
            (identity::SEGMENT, segment.to_string()),
            (identity::SCHEMA_VERSION, SCHEMA_VERSION.to_string()),
            (identity::SEED, config.seed.to_string()),
            (identity::PRESET, config.preset.clone()),
        ];
        let metadata = pairs.map(|(key, value)| (key.to_owned(), value)).into();
        Metadata { name: IDENTITY_METADATA.to_owned(), metadata }
    }

    fn announce(&mut self, topic: Topic) -> Result<u16, SegmentError> {
        let TopicEntry { name, message, .. } = &self.topics[topic.0];
        let (name, message) = (name.clone(), *message);
        let channel = self.writing(|writer| {
            let schema = writer.add_schema(message, PROTOBUF, &descriptor_of(message))?;
            writer.add_channel(schema, &name, PROTOBUF, &BTreeMap::new())
        })?;
        self.topics[topic.0].channel = Some(channel);
        Ok(channel)
    }

    fn writing<T>(
        &mut self,
        write: impl FnOnce(&mut Writer<CountedFile>) -> Result<T, McapError>,
    ) -> Result<T, SegmentError> {
        let written = match &mut self.open {
            Some(writer) => write(writer),
            None => Err(McapError::AttemptedWriteAfterFailure),
        };
        written.map_err(|cause| SegmentError { path: self.path().to_path_buf(), cause })
    }

    fn path(&self) -> &Path {
        self.files.last().expect("the first segment is begun on creation")
    }
}

/// A new file that counts the bytes it is given.
struct CountedFile {
    buffer: BufWriter<File>,
    bytes: Rc<Cell<u64>>,
}

impl CountedFile {
    /// Refuses to replace a file: a segment is written once.
    fn create(path: &Path, bytes: Rc<Cell<u64>>) -> std::io::Result<Self> {
        let file = File::options().write(true).create_new(true).open(path)?;
        // Tells `recover` to leave it alone. Where the file system has no locks there is none.
        let _ = file.try_lock();
        Ok(Self { buffer: BufWriter::with_capacity(CHUNK_BYTES as usize, file), bytes })
    }

    fn sync(self) -> std::io::Result<()> {
        self.buffer.into_inner().map_err(std::io::IntoInnerError::into_error)?.sync_all()
    }

    fn discard(self) {
        // `into_parts` does not flush, dropping the buffer itself would.
        drop(self.buffer.into_parts());
    }
}

impl Write for CountedFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.buffer.write(bytes)?;
        self.bytes.set(self.bytes.get() + written as u64);
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.buffer.flush()
    }
}

impl Seek for CountedFile {
    fn seek(&mut self, position: SeekFrom) -> std::io::Result<u64> {
        self.buffer.seek(position)
    }
}
