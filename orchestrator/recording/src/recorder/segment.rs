//! MCAP files on disk: one segment after another, each complete in itself.
//!
//! A segment begins with the run's configuration and identity, so that any one file can be replayed alone. Chunks go
//! to disk whole ([`WriteOptions::disable_seeking`]) and at least each second, with an index and an end mark after
//! them ([`LiveFile`]), so that every reader can open the file while it grows, and after the recorder was killed. One
//! segment is one file and never appended to.

use super::index::Index;
use super::live::LiveFile;
use crate::schema::{PROTOBUF, Schema};
use anyhow::{Result, anyhow};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};
use proto::config::Config;
use proto::disk::sync_folder;
use proto::run_folder::RunFolder;
use std::borrow::Cow;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::rc::Rc;

pub const CONFIG_ATTACHMENT: &str = "config.toml";
pub const IDENTITY_METADATA: &str = "stillroom";
/// Version of recordings. Before 4 the fields of steps and episodes were those of one task.
pub const RECORDING_VERSION: u32 = 4;
pub mod identity {
    pub const RUN_ID: &str = "run_id";
    /// The host that wrote the file, where the run has several; otherwise it is not there.
    pub const HOST: &str = "host";
    pub const INCARNATION: &str = "incarnation";
    pub const SEGMENT: &str = "segment";
    pub const VERSION: &str = "schema_version";
    pub const SEED: &str = "seed";
    pub const PRESET: &str = "preset";
}

const CHUNK_BYTES: u64 = 1 << 20;
/// Data that is held in memory at most, bytes; what comes between two flushes is seldom so much.
const PENDING_BYTES_MAX: u64 = 8 << 20;
/// Chunks of a segment at most: its index is written again with each flush. With one a second half an hour.
const CHUNKS_MAX: u32 = 2048;

fn cannot_write(path: &Path, cause: &McapError) -> anyhow::Error {
    anyhow!(
        "cannot write recording {}: {}; see that the folder is writable and its disk has space, or set \
         recording.enabled = false to run without",
        path.display(),
        in_words(cause)
    )
}

/// Why nothing can be written. The writer reports any error of the file system without its cause, which the user needs.
pub fn in_words(cause: &McapError) -> String {
    match cause {
        McapError::Io(cause) if cause.kind() == ErrorKind::StorageFull => format!("the disk is full ({cause})"),
        McapError::Io(cause) => cause.to_string(),
        cause => cause.to_string(),
    }
}

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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic(usize);

struct TopicEntry {
    name: String,
    schema: Schema,
    sequence: u32,
    channel: Option<u16>,
}

#[derive(Debug, Clone)]
pub struct Preamble {
    pub run_id: String,
    pub host: u32,
    pub incarnation: u32,
    pub config: Config,
}

pub struct Segments {
    folder: RunFolder,
    preamble: Preamble,
    topics: Vec<TopicEntry>,
    open: Option<Writer<LiveFile>>,
    pub files: Vec<PathBuf>,
    finished_bytes: u64,
    open_bytes: Rc<Cell<u64>>,
    flushed_bytes: u64,
    index: Rc<RefCell<Index>>,
}

impl Segments {
    pub fn create(folder: RunFolder, preamble: Preamble, time_ns: u64) -> Result<Self> {
        std::fs::create_dir_all(folder.recordings())
            .map_err(|cause| cannot_write(&folder.recordings(), &cause.into()))?;
        let mut segments = Self {
            folder,
            preamble,
            topics: Vec::new(),
            open: None,
            files: Vec::new(),
            finished_bytes: 0,
            open_bytes: Rc::default(),
            flushed_bytes: 0,
            index: Rc::default(),
        };
        segments.begin(time_ns)?;
        Ok(segments)
    }

    pub fn topic(&mut self, name: impl Into<String>, schema: &Schema) -> Topic {
        let (name, schema) = (name.into(), schema.clone());
        self.topics.push(TopicEntry { name, schema, sequence: 0, channel: None });
        Topic(self.topics.len() - 1)
    }

    pub fn write(&mut self, topic: Topic, time_ns: u64, data: &[u8]) -> Result<()> {
        if self.open_bytes.get() >= self.preamble.config.recording.segment_bytes
            || self.index.borrow().chunk_count() >= CHUNKS_MAX
        {
            self.finish()?;
            self.begin(time_ns)?;
        } else if self.open_bytes.get() - self.flushed_bytes >= PENDING_BYTES_MAX {
            self.flush()?;
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

    pub fn flush(&mut self) -> Result<()> {
        self.writing(Writer::flush)?;
        self.flushed_bytes = self.open_bytes.get();
        Ok(())
    }

    pub fn finish(&mut self) -> Result<()> {
        let Some(mut writer) = self.open.take() else { return Ok(()) };
        let path = self.path().to_path_buf();
        let finished = writer.finish().and_then(|_| Ok(writer.into_inner().close()?));
        // The folder too, or the file may have no name after a power cut.
        let finished = finished.and_then(|()| Ok(sync_folder(&self.folder.recordings())?));
        self.finished_bytes += self.open_bytes.take();
        finished.map_err(|cause| cannot_write(&path, &cause))
    }

    /// Gives the open segment up after a failure: nothing more is written, not even by its destructor.
    pub fn abandon(mut self) {
        // Taken out of its writer, whose destructor would write an end.
        drop(self.open.take().map(Writer::into_inner));
    }

    pub fn bytes(&self) -> u64 {
        self.finished_bytes + self.open_bytes.get()
    }

    fn begin(&mut self, time_ns: u64) -> Result<()> {
        let segment = self.files.len() as u32;
        let path = self.folder.recording(self.preamble.incarnation, segment);
        self.files.push(path.clone());
        for topic in &mut self.topics {
            topic.channel = None;
        }
        let config = self.preamble.config.to_toml();
        let metadata = self.identity(segment);
        self.index = Rc::default();
        let file = LiveFile::create(&path, self.index.clone(), self.open_bytes.clone());
        let begun = file.map_err(McapError::from).and_then(|file| {
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
        self.open = Some(begun.map_err(|cause| cannot_write(&path, &cause))?);
        self.flushed_bytes = self.open_bytes.get();
        Ok(())
    }

    fn identity(&self, segment: u32) -> Metadata {
        let config = &self.preamble.config;
        let pairs = [
            (identity::RUN_ID, self.preamble.run_id.clone()),
            (identity::INCARNATION, self.preamble.incarnation.to_string()),
            (identity::SEGMENT, segment.to_string()),
            (identity::VERSION, RECORDING_VERSION.to_string()),
            (identity::SEED, config.seed.to_string()),
            (identity::PRESET, config.preset.clone()),
        ];
        let host = Some((identity::HOST, self.preamble.host.to_string())).filter(|_| self.preamble.host > 0);
        let metadata = pairs.into_iter().chain(host).map(|(key, value)| (key.to_owned(), value)).collect();
        Metadata { name: IDENTITY_METADATA.to_owned(), metadata }
    }

    fn announce(&mut self, topic: Topic) -> Result<u16> {
        let TopicEntry { name, schema: Schema { name: message, descriptor }, .. } = &self.topics[topic.0];
        let (name, message, descriptor) = (name.clone(), message.clone(), descriptor.clone());
        let (schema, channel) = self.writing(|writer| {
            let schema = writer.add_schema(&message, PROTOBUF, &descriptor)?;
            Ok((schema, writer.add_channel(schema, &name, PROTOBUF, &BTreeMap::new())?))
        })?;
        let mut index = self.index.borrow_mut();
        index.schema(schema, &message, PROTOBUF, &descriptor);
        index.channel(channel, schema, &name, PROTOBUF);
        drop(index);
        self.topics[topic.0].channel = Some(channel);
        Ok(channel)
    }

    fn writing<T>(&mut self, write: impl FnOnce(&mut Writer<LiveFile>) -> Result<T, McapError>) -> Result<T> {
        let written = match &mut self.open {
            Some(writer) => write(writer),
            None => Err(McapError::AttemptedWriteAfterFailure),
        };
        written.map_err(|cause| cannot_write(self.path(), &cause))
    }

    fn path(&self) -> &Path {
        self.files.last().expect("the first segment is begun on creation")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_called_that() {
        let full = rustix::io::Errno::NOSPC;
        let error = cannot_write(Path::new("runs/a/b.mcap"), &McapError::Io(full.into()));
        let said = error.to_string();
        let expected = "cannot write recording runs/a/b.mcap: the disk is full (No space left on device";
        assert!(said.starts_with(expected), "{said}");
        let denied = cannot_write(Path::new("b.mcap"), &McapError::Io(rustix::io::Errno::ACCESS.into()));
        assert!(denied.to_string().contains("Permission denied"), "{denied}");
    }
}
