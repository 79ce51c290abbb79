//! One MCAP file from its start to its end, or to where it was cut off.

use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// No record or chunk of ours comes near this; one that claims more is damaged.
const RECORD_LIMIT_BYTES: usize = 1 << 30;
/// Bytes asked of the file at once.
const READ_BYTES: usize = 1 << 20;

/// A file that cannot be read as a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file system returned an error.
    #[error("cannot read {path}: {cause}", path = .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// An empty file.
    #[error("{path} is empty: no recording", path = .0.display())]
    Empty(PathBuf),
    /// Something else.
    #[error("{path} is not an MCAP recording (it does not begin with MCAP's magic bytes)", path = .0.display())]
    NotMcap(PathBuf),
    /// MCAP, but not one of ours, or of another version.
    #[error("{path} is not a recording that this version can use: {problem}", path = .path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        problem: String,
    },
    /// A folder without recordings.
    #[error("{path} holds no recordings (expected .mcap files, there or in its folder recordings/)", path = .0.display())]
    NoRecordings(PathBuf),
}

/// Where a file stopped being readable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FileEnd {
    /// At its end mark: the file is complete.
    Whole,
    /// Before its end mark, because the file stops.
    Cut,
    /// Before its end mark, at something that cannot be read.
    Damaged(String),
}

/// How much of a file could be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Extent {
    /// Messages read.
    pub messages: u64,
    /// How reading ended.
    pub end: FileEnd,
}

impl Extent {
    /// The warning for the user about the file at `path`; none when it is complete.
    pub fn complaint(&self, path: &Path) -> Option<String> {
        let path = path.display();
        let Self { messages, end } = self;
        let how = match end {
            FileEnd::Whole => return None,
            FileEnd::Cut => "was cut off".to_owned(),
            FileEnd::Damaged(cause) => format!("is damaged ({cause})"),
        };
        Some(format!("{path} {how}: readable up to message {messages}; `orchestrator recover {path}` repairs it"))
    }
}

/// Hands every record of the file to `visit`, those inside chunks included and chunks checked against their sums
/// first. What the file's end repeats from its data (schemas, channels, indexes) is left out.
///
/// A cut or damaged file is no error: it is read as far as it goes. An error of `visit` ends the reading.
pub fn read<E: From<RecordingError>>(
    path: &Path,
    mut visit: impl FnMut(Record<'_>) -> Result<(), E>,
) -> Result<Extent, E> {
    let unreadable = |cause| RecordingError::Unreadable { path: path.to_path_buf(), cause };
    let mut file = File::open(path).map_err(unreadable)?;
    if file.metadata().map_err(unreadable)?.is_dir() {
        return Err(unreadable(std::io::ErrorKind::IsADirectory.into()).into());
    }
    let mut reader = LinearReader::new_with_options(
        LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(RECORD_LIMIT_BYTES),
    );
    let mut extent = Extent { messages: 0, end: FileEnd::Whole };
    let mut bytes = 0;
    let mut in_data = true;
    while let Some(event) = reader.next_event() {
        let stopped = match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let read = file.read(reader.insert(wanted.clamp(1, READ_BYTES))).map_err(unreadable)?;
                reader.notify_read(read);
                bytes += read;
                continue;
            }
            Ok(LinearReadEvent::Record { data, opcode }) => match mcap::parse_record(opcode, data) {
                Ok(record) => {
                    in_data &= !matches!(record, Record::DataEnd(_));
                    if in_data {
                        extent.messages += u64::from(matches!(record, Record::Message { .. }));
                        visit(record)?;
                    }
                    continue;
                }
                Err(error) => error,
            },
            Err(error) => error,
        };
        if bytes == 0 {
            return Err(RecordingError::Empty(path.to_path_buf()).into());
        }
        if bytes < MAGIC.len() || matches!(stopped, McapError::BadMagic) && extent.messages == 0 && in_data {
            return Err(RecordingError::NotMcap(path.to_path_buf()).into());
        }
        extent.end = match stopped {
            McapError::UnexpectedEof => FileEnd::Cut,
            error => FileEnd::Damaged(error.to_string()),
        };
        break;
    }
    Ok(extent)
}
