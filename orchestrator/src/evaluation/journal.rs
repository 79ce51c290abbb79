//! `played.jsonl` in an evaluation's folder: the record of each episode played so far, a JSON object a line, so that
//! `status` can show the progress. It is removed when the result is written.

use crate::run::json_lines::{self, Writer};
use anyhow::{Context, Result};
use proto::bounded::TABLE_BYTES_MOST;
use proto::evaluation::EpisodeRecord;
use proto::run_folder::RunFolder;
use std::path::PathBuf;

fn path(folder: &RunFolder) -> PathBuf {
    folder.root().join("played.jsonl")
}

pub fn open(folder: &RunFolder) -> Result<Writer> {
    Writer::open(&path(folder))
}

pub fn read(folder: &RunFolder) -> Result<Vec<EpisodeRecord>> {
    let path = path(folder);
    let read = json_lines::read(folder, &path, TABLE_BYTES_MOST).with_context(|| path.display().to_string())?;
    Ok(read.0)
}

/// Removes it. The result is there already: a journal that stays does no harm.
pub fn remove(folder: &RunFolder) {
    let path = path(folder);
    if let Err(error) = std::fs::remove_file(&path) {
        tracing::warn!("cannot remove {}: {error}", path.display());
    }
}
