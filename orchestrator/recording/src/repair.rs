use super::reader::{Extent, RecordingError, open};
use crate::recorder::segment::{in_words, write_options};
use anyhow::{Result, anyhow, ensure};
use mcap::McapError;
use proto::disk::sync_folder;
use salvage::{Limits, ReadError, rewrite};
use std::fs::Permissions;
use std::io::{BufWriter, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Repair {
    NotNeeded { messages: u64 },
    Repaired { repaired: PathBuf, kept: Option<PathBuf>, extent: Extent },
}

/// Copies all that is readable in `path` into a complete file: to `output`, or in place of the old file, which is then
/// kept as `….cut`. Neither `output` nor `….cut` may exist yet.
pub fn repair(path: &Path, output: Option<&Path>) -> Result<Repair> {
    let (source, live) = open(path)?;
    ensure!(!live, "{} is still being written: stop the run first", path.display());
    output.map_or(Ok(()), demand_free)?;
    let target = output.unwrap_or(path);
    let failed = |cause: McapError| anyhow!("cannot write {}: {}", target.display(), in_words(&cause));
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // As any new file, and removed if it is not moved to its place: a failure leaves nothing behind but the error.
    let mut partial = tempfile::Builder::new()
        .suffix(".partial")
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder)
        .map_err(|cause| failed(cause.into()))?;
    let mut out = BufWriter::new(partial.as_file_mut());
    let account = rewrite(&source, &Limits::default(), write_options(), &mut out).map_err(|error| match error {
        ReadError::Visit(cause) => failed(cause),
        ReadError::Empty => RecordingError::Empty(path.to_path_buf()).into(),
        ReadError::NotMcap => RecordingError::NotMcap(path.to_path_buf()).into(),
        ReadError::Io(cause) => RecordingError::Unreadable { path: path.to_path_buf(), cause }.into(),
    })?;
    out.flush().and_then(|()| out.get_ref().sync_all()).map_err(|cause| failed(cause.into()))?;
    drop(out);
    let extent = Extent::of(account, live);
    if extent.account.is_whole() && output.is_none() {
        return Ok(Repair::NotNeeded { messages: extent.messages });
    }
    let kept = output.is_none().then(|| with_suffix(path, ".cut"));
    kept.as_deref().map_or(Ok(()), demand_free)?;
    let moved = match &kept {
        // A hard link keeps the old content reachable at every moment; the rename then replaces the name alone.
        Some(kept) => std::fs::hard_link(path, kept).or_else(|_| std::fs::rename(path, kept)),
        None => Ok(()),
    };
    moved
        .and_then(|()| Ok(partial.persist(target)?))
        .and_then(|_| sync_folder(folder))
        .map_err(|cause| failed(cause.into()))?;
    Ok(Repair::Repaired { repaired: target.to_path_buf(), kept, extent })
}

/// Refuses to replace something: it may be the only good copy.
fn demand_free(path: &Path) -> Result<()> {
    ensure!(path.symlink_metadata().is_err(), "{} exists: move it away first", path.display());
    Ok(())
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}
