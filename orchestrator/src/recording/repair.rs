//! Makes a complete file from a truncated one.

use super::reader::{Extent, FileEnd, RecordingError, read};
use crate::recording::recorder::segment::{in_words, write_options};
use mcap::records::{Metadata, Record};
use mcap::{Attachment, McapError, Writer};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fs::{File, TryLockError};
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

/// Why a file could not be repaired.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The old file.
    #[error(transparent)]
    Read(#[from] RecordingError),
    /// A recorder writes it at this moment.
    #[error("{path} is still being written: stop the run first", path = .0.display())]
    Busy(PathBuf),
    /// Something would be replaced that may be the only good copy.
    #[error("{path} exists: move it away first", path = .0.display())]
    Exists(PathBuf),
    /// The new file.
    #[error("cannot write {path}: {cause}", path = .path.display(), cause = in_words(.cause))]
    Write {
        /// Where it was to be.
        path: PathBuf,
        /// Why not.
        cause: McapError,
    },
}

/// What was done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Repair {
    /// The file is complete; nothing was touched.
    NotNeeded {
        /// Messages in it.
        messages: u64,
    },
    /// A complete file was written.
    Repaired {
        /// The complete file.
        repaired: PathBuf,
        /// The old file, where it was kept under another name.
        kept: Option<PathBuf>,
        /// What the old file held.
        extent: Extent,
    },
}

/// Copies all that is readable in `path` into a complete file: to `output`, or in place of the old file, which is then
/// kept as `….cut`. Neither `output` nor `….cut` may exist yet.
pub fn repair(path: &Path, output: Option<&Path>) -> Result<Repair, RepairError> {
    let unreadable = |cause| RecordingError::Unreadable { path: path.to_path_buf(), cause };
    let old = File::open(path).map_err(unreadable)?;
    if let Err(TryLockError::WouldBlock) = old.try_lock_shared() {
        return Err(RepairError::Busy(path.to_path_buf()));
    }
    if let Some(output) = output
        && output.symlink_metadata().is_ok()
    {
        return Err(RepairError::Exists(output.to_path_buf()));
    }
    let target = output.unwrap_or(path);
    let partial = with_suffix(target, ".partial");
    let failed = |cause: McapError| RepairError::Write { path: target.to_path_buf(), cause };
    let extent = match copy(path, &partial) {
        Ok(extent) => extent,
        Err(error) => {
            // Leaves nothing behind but the error.
            let _ = std::fs::remove_file(&partial);
            return Err(error);
        }
    };
    if extent.end == FileEnd::Whole && output.is_none() {
        std::fs::remove_file(&partial).map_err(|cause| failed(cause.into()))?;
        return Ok(Repair::NotNeeded { messages: extent.messages });
    }
    let kept = output.is_none().then(|| with_suffix(path, ".cut"));
    if let Some(kept) = kept.as_ref().filter(|kept| kept.symlink_metadata().is_ok()) {
        std::fs::remove_file(&partial).map_err(|cause| failed(cause.into()))?;
        return Err(RepairError::Exists(kept.clone()));
    }
    let moved = match &kept {
        // A hard link keeps the old content reachable at every moment; the rename then replaces the name alone.
        Some(kept) => std::fs::hard_link(path, kept).or_else(|_| std::fs::rename(path, kept)),
        None => Ok(()),
    };
    moved
        .and_then(|()| std::fs::rename(&partial, target))
        .and_then(|()| sync_folder_of(target))
        .map_err(|cause| failed(cause.into()))?;
    Ok(Repair::Repaired { repaired: target.to_path_buf(), kept, extent })
}

fn sync_folder_of(path: &Path) -> std::io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder)?.sync_all()
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

fn copy(from: &Path, to: &Path) -> Result<Extent, RepairError> {
    let failed = |cause: McapError| RepairError::Write { path: to.to_path_buf(), cause };
    // One that a cut repair left gives way. Made anew, it cannot be a link to a file elsewhere.
    match std::fs::remove_file(to) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(failed(error.into())),
        _ => {}
    }
    let file = File::create_new(to).map_err(|cause| failed(cause.into()))?;
    let mut writer = write_options().create(BufWriter::new(file)).map_err(failed)?;
    let mut channels = BTreeSet::new();
    let extent = read(from, |record| copy_record(&mut writer, &mut channels, record).map_err(failed))?;
    writer.finish().map_err(failed)?;
    let synced = writer.into_inner().into_inner().map_err(std::io::IntoInnerError::into_error);
    synced.and_then(|file| file.sync_all()).map_err(|cause| failed(cause.into()))?;
    Ok(extent)
}

/// Copies one record under its old numbers. Indexes are made anew by the writer.
fn copy_record<W: Write + Seek>(
    writer: &mut Writer<W>,
    channels: &mut BTreeSet<u16>,
    record: Record<'_>,
) -> Result<(), McapError> {
    match record {
        Record::Schema { header, data } => {
            writer.add_schema_with_id(header.id, &header.name, &header.encoding, &data).map(drop)
        }
        Record::Channel(channel) => {
            channels.insert(channel.id);
            writer
                .add_channel_with_id(
                    channel.id,
                    channel.schema_id,
                    &channel.topic,
                    &channel.message_encoding,
                    &channel.metadata,
                )
                .map(drop)
        }
        // A message without a channel record cannot be decoded.
        Record::Message { header, .. } if !channels.contains(&header.channel_id) => Ok(()),
        Record::Message { header, data } => writer.write_to_known_channel(&header, &data),
        Record::Attachment { header, data, .. } => writer.attach(&Attachment {
            log_time: header.log_time,
            create_time: header.create_time,
            name: header.name,
            media_type: header.media_type,
            data: Cow::Borrowed(&data),
        }),
        Record::Metadata(Metadata { name, metadata }) => writer.write_metadata(&Metadata { name, metadata }),
        _ => Ok(()),
    }
}
