//! The file system, as far as files are written that must survive: one seam, so that a test can take the power away.
//!
//! [`LocalDisk`] is the machine's. The simulated world has another one, which forgets what was not synchronised.

use crate::bounded;
use crate::plain_file::open_plain;
use std::fmt::Debug;
use std::fs::File;
use std::io::{Error, Result, Write};
use std::path::{Path, PathBuf};

/// What a writer of files that must survive asks of a file system.
pub trait Disk: Debug {
    type File;
    /// Makes a folder and those above it.
    fn create_folders(&self, folder: &Path) -> Result<()>;
    /// Makes a new, empty file; an error if the name is taken.
    fn create_new(&self, path: &Path) -> Result<Self::File>;
    /// Opens a plain file that is there; an error of the kind `InvalidInput` if it is a link or something else.
    fn open(&self, path: &Path) -> Result<Self::File>;
    fn write_all(&self, file: &mut Self::File, content: &[u8]) -> Result<()>;
    /// Returns when its content would survive a power failure.
    fn sync(&self, file: &Self::File) -> Result<()>;
    /// Returns when the names in a folder would survive one.
    fn sync_folder(&self, folder: &Path) -> Result<()>;
    /// Gives a file another name, in place of whatever had it.
    fn rename(&self, from: &Path, to: &Path) -> Result<()>;
    fn remove(&self, path: &Path) -> Result<()>;
    /// A whole plain file that has `most` bytes at most.
    fn read(&self, path: &Path, most: u64) -> Result<Vec<u8>>;
    fn size(&self, path: &Path) -> Result<u64>;
    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>>;
}

/// Returns when the names in a folder would survive a power failure. Shared folders of virtual machines and some network
/// disks cannot synchronise a folder: there names are as safe as the disk makes them.
pub fn sync_folder(folder: &Path) -> Result<()> {
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(error) if error.raw_os_error() == Some(libc::EBADF) || is_not_offered(&error) => Ok(()),
        synced => synced,
    }
}

/// Copies an ordinary file onto the disk. Its permissions are not copied: some file systems refuse to set them.
pub fn copy(from: &Path, to: &Path) -> Result<()> {
    let mut from = bounded::open(from)?;
    let mut to = File::create(to)?;
    std::io::copy(&mut from, &mut to)?;
    to.sync_all()
}

/// Whether an error says that a file system does not offer an operation, to whomever and for whatever file.
pub fn is_not_offered(error: &Error) -> bool {
    matches!(error.raw_os_error(), Some(libc::EINVAL | libc::ENOLCK | libc::ENOSYS | libc::EOPNOTSUPP))
}

/// The tensors of a checkpoint, bytes: those of the largest network with the most environments have a tenth.
pub const TENSORS_BYTES_MOST: u64 = 64 << 30;

#[derive(Debug, Clone, Copy, Default)]
pub struct LocalDisk;

impl Disk for LocalDisk {
    type File = File;

    fn create_folders(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder)
    }

    fn create_new(&self, path: &Path) -> Result<File> {
        File::create_new(path)
    }

    fn open(&self, path: &Path) -> Result<File> {
        open_plain(path, File::options().read(true))
    }

    fn write_all(&self, file: &mut File, content: &[u8]) -> Result<()> {
        file.write_all(content)
    }

    fn sync(&self, file: &File) -> Result<()> {
        file.sync_all()
    }

    fn sync_folder(&self, folder: &Path) -> Result<()> {
        sync_folder(folder)
    }

    fn rename(&self, from: &Path, to: &Path) -> Result<()> {
        std::fs::rename(from, to)
    }

    fn remove(&self, path: &Path) -> Result<()> {
        std::fs::remove_file(path)
    }

    fn read(&self, path: &Path, most: u64) -> Result<Vec<u8>> {
        bounded::content(self.open(path)?, most)
    }

    fn size(&self, path: &Path) -> Result<u64> {
        Ok(self.open(path)?.metadata()?.len())
    }

    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect()
    }
}
