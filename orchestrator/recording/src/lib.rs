//! Recordings: [`recorder`] makes them, in messages that follow from the task (`form.rs`). [`reader`] goes through a file
//! however damaged it is, and [`episodes`] puts together what can be simulated again.

mod assembly;
mod declared;
mod engine;
pub mod episode_index;
pub mod episodes;
mod form;
mod origin;
pub mod reader;
mod reading;
pub mod recorder;
pub mod repair;
pub mod schema;
#[cfg(test)]
mod tests;
mod told;
pub mod wanted;

use proto::run_folder::{Item, RunFolder};
use reader::RecordingError;
use serde::Serialize;
use std::fs::TryLockError;
use std::path::{Path, PathBuf};

/// The recordings meant by `path`: a file itself; of a run folder or a folder of recordings, all segments in order. Of a
/// run on several hosts those of all whose folders are here, host by host. Of a folder, empty files are left out unless
/// there is nothing else: a recorder that was killed before its first byte leaves one.
pub fn files_at(path: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let unreadable = |cause| RecordingError::Unreadable { path: path.to_path_buf(), cause };
    if std::fs::metadata(path).map_err(unreadable)?.is_dir() {
        return Ok(files_in(&RunFolder::new(path))?.into_iter().map(|item| item.path).collect());
    }
    // The user named the file, so it may be a link.
    let resolved =
        if path.is_symlink() { std::fs::canonicalize(path).map_err(unreadable)? } else { path.to_path_buf() };
    Ok(vec![resolved])
}

fn files_in(run: &RunFolder) -> Result<Vec<Item>, RecordingError> {
    let recorded = |folder: &Path| {
        let mut items =
            run.list(folder).map_err(|cause| RecordingError::Unreadable { path: folder.to_path_buf(), cause })?;
        // They come by incarnation and segment: their order is that of time.
        items.retain(|item| !item.is_folder && item.path.extension().is_some_and(|extension| extension == "mcap"));
        Ok(items)
    };
    let mut files = recorded(&run.recordings())?;
    for host in run.host_folders() {
        files.append(&mut recorded(&host.recordings())?);
    }
    if files.is_empty() {
        files = recorded(run.root())?;
    }
    if files.is_empty() {
        return Err(RecordingError::NoRecordings(run.root().to_path_buf()));
    }
    if files.iter().any(|file| file.bytes > 0) {
        files.retain(|file| file.bytes > 0);
    }
    Ok(files)
}

/// Whether a recorder writes this file of a run folder at this moment.
fn is_growing(folder: &RunFolder, path: &Path) -> bool {
    folder.open(path).is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
}

#[derive(Debug, PartialEq, Eq, Serialize)]
pub struct Recordings {
    pub files: usize,
    pub bytes: u64,
    pub newest: PathBuf,
    /// A recorder writes the last one at this moment.
    pub being_written: bool,
}

impl Recordings {
    /// Those of a run folder; none if there are none.
    pub fn of(folder: &RunFolder) -> Option<Self> {
        let files = files_in(folder).ok()?;
        // Host 0's, if it has any.
        let newest = files.iter().rfind(|file| file.path.starts_with(folder.recordings())).or(files.last())?;
        let newest = newest.path.clone();
        let bytes = files.iter().map(|file| file.bytes).sum();
        let being_written = is_growing(folder, &newest);
        Some(Self { files: files.len(), bytes, newest, being_written })
    }
}
