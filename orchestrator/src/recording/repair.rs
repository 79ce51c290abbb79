use super::reader::{Extent, RecordingError, open};
use crate::recording::recorder::segment::{in_words, write_options};
use anyhow::{Result, anyhow, ensure};
use mcap::McapError;
use proto::disk::sync_folder;
use salvage::{ReadError, rewrite};
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

const PARTIAL_NAMES_MAX: u32 = 1000;

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
    let (partial, file) = new_file_beside(target).map_err(|cause| failed(cause.into()))?;
    // Removed if it was not moved to its place: a failure leaves nothing behind but the error.
    let partial = Partial(partial);
    let mut out = BufWriter::new(file);
    let account = rewrite(&source, write_options(), &mut out).map_err(|error| match error {
        ReadError::Visit(cause) => failed(cause),
        ReadError::Empty => RecordingError::Empty(path.to_path_buf()).into(),
        ReadError::NotMcap => RecordingError::NotMcap(path.to_path_buf()).into(),
        ReadError::Io(cause) => RecordingError::Unreadable { path: path.to_path_buf(), cause }.into(),
    })?;
    out.flush().and_then(|()| out.get_ref().sync_all()).map_err(|cause| failed(cause.into()))?;
    if account.is_whole() && output.is_none() {
        return Ok(Repair::NotNeeded { messages: account.messages });
    }
    let kept = output.is_none().then(|| with_suffix(path, ".cut"));
    kept.as_deref().map_or(Ok(()), demand_free)?;
    let moved = match &kept {
        // A hard link keeps the old content reachable at every moment; the rename then replaces the name alone.
        Some(kept) => std::fs::hard_link(path, kept).or_else(|_| std::fs::rename(path, kept)),
        None => Ok(()),
    };
    moved
        .and_then(|()| std::fs::rename(&partial.0, target))
        .and_then(|()| sync_folder_of(target))
        .map_err(|cause| failed(cause.into()))?;
    Ok(Repair::Repaired { repaired: target.to_path_buf(), kept, extent: Extent { account, live } })
}

/// Refuses to replace something: it may be the only good copy.
fn demand_free(path: &Path) -> Result<()> {
    ensure!(path.symlink_metadata().is_err(), "{} exists: move it away first", path.display());
    Ok(())
}

struct Partial(PathBuf);

impl Drop for Partial {
    fn drop(&mut self) {
        // Not there any more if it was moved.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A new file `….partial` beside the target; where something has that name, with a number. It is made anew, so it
/// cannot be a link to a file elsewhere, and replaces nothing.
fn new_file_beside(target: &Path) -> std::io::Result<(PathBuf, File)> {
    let mut last = ErrorKind::AlreadyExists.into();
    for number in 1..=PARTIAL_NAMES_MAX {
        let suffix = if number == 1 { ".partial".to_owned() } else { format!(".partial-{number}") };
        let path = with_suffix(target, &suffix);
        match File::create_new(&path) {
            Ok(file) => return Ok((path, file)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => last = error,
            Err(error) => return Err(error),
        }
    }
    Err(last)
}

fn sync_folder_of(path: &Path) -> std::io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    sync_folder(folder)
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}
