//! What a run must not leave behind: shared memory, temporary folders, locks that are held.

use anyhow::{Context, Result};
use proto::run_folder::RunFolder;
use std::fs::File;
use std::path::Path;

/// What is left of a run whose processes have ended.
pub fn of_run(folder: &RunFolder) -> Result<Vec<String>> {
    let id = folder.id().context("run.toml holds the run's id")?;
    let mut left = of_id(&id)?;
    for entry in std::fs::read_dir(folder.root())?.flatten().map(|entry| entry.path()) {
        let is_lock = entry.extension().is_some_and(|extension| extension == "lock");
        if is_lock && File::open(&entry)?.try_lock().is_err() {
            left.push(format!("{} is held", entry.display()));
        }
    }
    Ok(left)
}

/// Names of the run with this id in shared memory and among temporary folders.
pub fn of_id(id: &str) -> Result<Vec<String>> {
    let prefix = format!("{}{id}_", wire::PREFIX_MARK);
    let mut left = vec![];
    for folder in [Path::new(wire::SHARED_MEMORY), &std::env::temp_dir()] {
        for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())?.flatten() {
            if entry.file_name().to_string_lossy().starts_with(&prefix) {
                left.push(entry.path().display().to_string());
            }
        }
    }
    Ok(left)
}
