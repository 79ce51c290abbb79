//! One MCAP file from its start to its end, or as much of it as can be read: [`salvage`] with our errors.

use mcap::records::Record;
use proto::plain_file::open_plain;
use proto::shell::quoted;
use salvage::{Account, FileSource, Limits, ReadError, Trust};
use std::fs::{OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    #[error("cannot read {path}: {cause}", path = .path.display())]
    Unreadable { path: PathBuf, cause: std::io::Error },
    #[error("{path} is empty: no recording", path = .0.display())]
    Empty(PathBuf),
    #[error("{path} is not an MCAP recording (it does not begin with MCAP's magic bytes)", path = .0.display())]
    NotMcap(PathBuf),
    #[error("{path} is not a recording that this version can use: {problem}", path = .path.display())]
    Foreign { path: PathBuf, problem: String },
    #[error("{path} holds no recordings (expected .mcap files, there or in its folder recordings/)", path = .0.display())]
    NoRecordings(PathBuf),
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FileEnd {
    Whole,
    Cut,
    Damaged(String),
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Extent {
    pub messages: u64,
    pub end: FileEnd,
    pub account: Account,
    pub live: bool,
}

impl Extent {
    pub fn of(account: Account, live: bool) -> Self {
        let end = match (account.is_whole(), account.cut) {
            (true, _) => FileEnd::Whole,
            (false, true) => FileEnd::Cut,
            (false, false) => FileEnd::Damaged(account.outcome()),
        };
        Self { messages: account.messages, end, account, live }
    }

    pub fn complaints(&self, path: &Path) -> Vec<String> {
        let (file, path, account) = (quoted(path), path.display(), &self.account);
        if self.live {
            return vec![format!("{path} is being written: read up to message {}", self.messages)];
        }
        let earlier = account.repaired_with_loss.as_ref();
        let mut lines: Vec<_> = earlier
            .map(|outcome| format!("{path} was repaired, and not all was there: {outcome}"))
            .into_iter()
            .collect();
        if self.end != FileEnd::Whole {
            let how = if self.end == FileEnd::Cut { "was cut off" } else { "is damaged" };
            let (messages, outcome) = (self.messages, account.outcome());
            lines.push(format!(
                "{path} {how}: {messages} messages are readable, {outcome}; `orchestrator recover {file}` repairs it"
            ));
            lines.extend(account.lines().into_iter().map(|line| format!("  {line}")));
        }
        lines
    }

    /// Whether anything is wrong with the file. What a recorder has not written yet does not count.
    pub fn is_damaged(&self) -> bool {
        !self.live && (self.end != FileEnd::Whole || self.account.repaired_with_loss.is_some())
    }

    /// Whether something that was recorded is not in the file, or not as it was recorded. What a recorder has not
    /// written yet does not count.
    pub fn is_incomplete(&self) -> bool {
        !self.live && (!self.account.is_lossless() || self.account.repaired_with_loss.is_some())
    }
}

pub fn open(path: &Path) -> Result<(FileSource, bool), RecordingError> {
    let unreadable = |cause| RecordingError::Unreadable { path: path.to_path_buf(), cause };
    if path.is_dir() {
        return Err(unreadable(std::io::ErrorKind::IsADirectory.into()));
    }
    let file = open_plain(path, OpenOptions::new().read(true)).map_err(unreadable)?;
    let live = matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock));
    Ok((FileSource::new(file).map_err(unreadable)?, live))
}

/// Hands every record of the file's data to `visit`, those inside chunks included, and whether it can be trusted. What
/// the file's end repeats (schemas, channels, indexes) is left out.
///
/// A cut or damaged file is no error: it is read as far as it goes. An error of `visit` ends the reading.
pub fn read_with_trust<E: From<RecordingError>>(
    path: &Path,
    visit: impl FnMut(Record<'_>, Trust) -> Result<(), E>,
) -> Result<Extent, E> {
    let (source, live) = open(path)?;
    read_source(path, &source, live, visit)
}

pub fn read_source<E: From<RecordingError>>(
    path: &Path,
    source: &FileSource,
    live: bool,
    visit: impl FnMut(Record<'_>, Trust) -> Result<(), E>,
) -> Result<Extent, E> {
    match salvage::read(source, &Limits::default(), visit) {
        Ok(account) => Ok(Extent::of(account, live)),
        Err(ReadError::Visit(error)) => Err(error),
        Err(ReadError::Empty) => Err(RecordingError::Empty(path.to_path_buf()).into()),
        Err(ReadError::NotMcap) => Err(RecordingError::NotMcap(path.to_path_buf()).into()),
        Err(ReadError::Io(cause)) => Err(RecordingError::Unreadable { path: path.to_path_buf(), cause }.into()),
    }
}
