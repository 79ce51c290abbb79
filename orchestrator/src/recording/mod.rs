//! Reading recordings back: [`reader`] goes through a file however it ends, [`episodes`] puts together what can be
//! re-simulated, [`simulate`] does so, [`repair`] makes a whole file of a cut one.

pub mod episodes;
pub mod reader;
pub mod repair;
pub mod simulate;

use reader::RecordingError;
use std::path::{Path, PathBuf};

/// The recordings meant by `path`: a file itself; of a run folder or a folder of recordings, all segments in order.
pub fn files_at(path: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let unreadable = |cause| RecordingError::Unreadable { path: path.to_path_buf(), cause };
    if !std::fs::metadata(path).map_err(unreadable)?.is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    let recordings = proto::run_folder::RunFolder::new(path).recordings();
    let folder = if recordings.is_dir() { recordings } else { path.to_path_buf() };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(&folder).map_err(unreadable)? {
        let file = entry.map_err(unreadable)?.path();
        if file.extension().is_some_and(|extension| extension == "mcap") {
            files.push(file);
        }
    }
    if files.is_empty() {
        return Err(RecordingError::NoRecordings(path.to_path_buf()));
    }
    // Names hold incarnation and segment with leading zeros: their order is that of time.
    files.sort();
    Ok(files)
}
