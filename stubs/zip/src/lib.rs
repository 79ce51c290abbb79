//! What tch and torch-sys name of zip 0.6. Each call of it is an error, which says so.
//!
//! tch reads and writes `.npz` files with it (`Tensor::read_npz`, `Tensor::write_npz`), and torch-sys's build script
//! unpacks a libtorch that it has fetched itself: a feature of torch-sys that is off. Stillroom does neither. The real
//! crate would be compiled twice, for the build script and for the learner, and with it encryption, bzip2, zstd, dates.

use result::{ZipError, ZipResult};
use std::io::{Read, Write};
use std::marker::PhantomData;
use std::path::PathBuf;

/// Why there is no archive.
pub mod result {
    /// The one error that there is.
    #[derive(Debug)]
    pub struct ZipError;

    /// What every function returns.
    pub type ZipResult<T> = Result<T, ZipError>;

    impl std::fmt::Display for ZipError {
        fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
            formatter.write_str("Stillroom is built without the zip archives of tch (stubs/zip)")
        }
    }

    impl std::error::Error for ZipError {}
}

/// How a file would be written.
pub mod write {
    /// No options.
    #[derive(Clone, Copy, Default)]
    pub struct FileOptions;

    impl FileOptions {
        /// Changes nothing.
        pub fn compression_method(self, _: super::CompressionMethod) -> Self {
            self
        }
    }
}

/// How a file would be compressed.
pub enum CompressionMethod {
    /// Not at all.
    Stored,
}

/// An archive to read. There is no value of it.
pub struct ZipArchive<R> {
    never: Never,
    reader: PhantomData<R>,
}

/// A file of an archive. There is no value of it.
pub struct ZipFile<'archive> {
    never: Never,
    archive: PhantomData<&'archive ()>,
}

/// An archive to write, which takes no file.
pub struct ZipWriter<W> {
    writer: PhantomData<W>,
}

enum Never {}

impl<R> ZipArchive<R> {
    /// Always an error.
    pub fn new(_: R) -> ZipResult<Self> {
        Err(ZipError)
    }

    /// Cannot be called.
    pub fn len(&self) -> usize {
        match self.never {}
    }

    /// Cannot be called.
    pub fn is_empty(&self) -> bool {
        match self.never {}
    }

    /// Cannot be called.
    pub fn by_index(&mut self, _: usize) -> ZipResult<ZipFile<'_>> {
        match self.never {}
    }
}

impl ZipFile<'_> {
    /// Cannot be called.
    pub fn name(&self) -> &str {
        match self.never {}
    }

    /// Cannot be called.
    pub fn mangled_name(&self) -> PathBuf {
        match self.never {}
    }

    /// Cannot be called.
    pub fn size(&self) -> u64 {
        match self.never {}
    }
}

impl Read for ZipFile<'_> {
    fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
        match self.never {}
    }
}

impl<W> ZipWriter<W> {
    /// Takes a writer and writes nothing to it.
    pub fn new(_: W) -> Self {
        Self { writer: PhantomData }
    }

    /// Always an error.
    pub fn start_file<S: Into<String>>(&mut self, _: S, _: write::FileOptions) -> ZipResult<()> {
        Err(ZipError)
    }
}

impl<W> Write for ZipWriter<W> {
    fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
        Err(std::io::Error::other(ZipError))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
