//! The file that keeps the scores of the paper's tables over many reports.

use anyhow::{Context, Result};
use proto::bounded;
use proto::run_folder::write_atomically;
use report::Kept;
use report::comparison::Comparison;
use std::path::Path;

pub fn read(path: &Path) -> Result<Kept> {
    let text = bounded::read_text(path).with_context(|| path.display().to_string())?;
    serde_json::from_str(&text).with_context(|| format!("{} keeps no table", path.display()))
}

pub fn add(path: &Path, tables: &[Comparison]) -> Result<Kept> {
    let mut kept = if path.exists() { read(path)? } else { Kept::default() };
    kept.add(tables)?;
    let mut text = serde_json::to_string_pretty(&kept).context("plain data")?;
    text.push('\n');
    write_atomically(path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(kept)
}
