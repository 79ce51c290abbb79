//! Recordings: [`recorder`] makes them, in the messages of [`schema`]. Reading them back: [`reader`] goes through a
//! file however damaged it is, [`origin`] knows where it comes from, [`episodes`] puts together what can be re-simulated
//! (each of them an [`assembly`]), [`shelf`] finds single episodes in recordings that grow, [`follow`] hands on what is new in them, [`wanted`] chooses among it, [`simulate`] simulates it, [`harvest`] makes a data
//! set of it, [`repair`] makes a whole file
//! of a damaged one. [`ffmpeg`] is looked for where films are to be made.

mod assembly;
pub mod episodes;
pub mod ffmpeg;
pub mod follow;
pub mod harvest;
mod origin;
pub mod reader;
pub mod recorder;
pub mod repair;
pub mod schema;
pub mod shelf;
pub mod simulate;
#[cfg(test)]
mod tests;
pub mod wanted;

use crate::showing::format;
use proto::bounded;
use proto::run_folder::RunFolder;
use reader::RecordingError;
use serde::Serialize;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

/// The recordings meant by `path`: a file itself; of a run folder or a folder of recordings, all segments in order. Of a
/// run on several hosts those of all whose folders are here, host by host. Of a folder, empty files are left out unless
/// there is nothing else: a recorder that was killed before its first byte leaves one.
pub fn files_at(path: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let unreadable = |cause| RecordingError::Unreadable { path: path.to_path_buf(), cause };
    if !std::fs::metadata(path).map_err(unreadable)?.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let run = RunFolder::new(path);
    let of_hosts = run.host_folders().into_iter().map(|host| host.recordings()).filter(|folder| folder.is_dir());
    let mut folders: Vec<PathBuf> = Some(run.recordings()).into_iter().filter(|folder| folder.is_dir()).collect();
    folders.extend(of_hosts);
    if folders.is_empty() {
        folders.push(path.to_path_buf());
    }
    let mut files = Vec::new();
    for folder in folders {
        let mut of_host = Vec::new();
        for entry in std::fs::read_dir(&folder).map_err(unreadable)? {
            let file = entry.map_err(unreadable)?.path();
            if file.extension().is_some_and(|extension| extension == "mcap") {
                of_host.push(file);
            }
        }
        // Names hold incarnation and segment with leading zeros: their order is that of time.
        of_host.sort();
        files.append(&mut of_host);
    }
    if files.is_empty() {
        return Err(RecordingError::NoRecordings(path.to_path_buf()));
    }
    let has_bytes = |file: &PathBuf| std::fs::metadata(file).is_ok_and(|file| file.len() > 0);
    if files.iter().any(has_bytes) {
        files.retain(has_bytes);
    }
    Ok(files)
}

/// The state of a run's recordings.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct Recordings {
    /// Files.
    pub files: usize,
    /// Their size together.
    pub bytes: u64,
    /// The last one.
    pub newest: PathBuf,
    /// A recorder writes the last one at this moment.
    pub being_written: bool,
}

impl Recordings {
    /// Those of a run folder; none if there are none.
    pub fn of(folder: &RunFolder) -> Option<Self> {
        let files = files_at(folder.root()).ok()?;
        // Host 0's, if it has any.
        let newest = files.iter().rfind(|file| file.starts_with(folder.recordings())).or(files.last())?.clone();
        let bytes = files.iter().filter_map(|file| Some(std::fs::metadata(file).ok()?.len())).sum();
        let locked = |file: File| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock));
        let being_written = bounded::open(&newest).is_ok_and(locked);
        Some(Self { files: files.len(), bytes, newest, being_written })
    }

    /// As people read it.
    pub fn line(&self) -> String {
        let Self { files, bytes, newest, being_written } = self;
        let (files, bytes) = (format::counted(*files as u64, "file"), format::bytes(*bytes));
        let newest = newest.display();
        if *being_written {
            format!(
                "recordings: {files}, {bytes}; {newest} is being written, and readable as it is up to the last second"
            )
        } else {
            format!("recordings: {files}, {bytes}; the newest is {newest}")
        }
    }
}
