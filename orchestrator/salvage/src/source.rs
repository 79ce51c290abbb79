//! Where the bytes come from: a file, or memory.

use std::borrow::Cow;
use std::fs::File;
use std::io::{ErrorKind, Result};
use std::ops::Range;
use std::os::unix::fs::FileExt;

/// Bytes that can be read at any place.
pub trait Source {
    /// How many there are.
    fn length(&self) -> u64;

    /// The bytes of this range; all of them must be there.
    fn bytes(&self, range: Range<u64>) -> Result<Cow<'_, [u8]>>;
}

/// The `N` bytes from `offset` on, if there are so many.
pub fn peek<const N: usize>(source: &dyn Source, offset: u64) -> Result<Option<[u8; N]>> {
    match offset.checked_add(N as u64) {
        Some(end) if end <= source.length() => Ok(source.bytes(offset..end)?.as_ref().try_into().ok()),
        _ => Ok(None),
    }
}

impl Source for &[u8] {
    fn length(&self) -> u64 {
        self.len() as u64
    }

    fn bytes(&self, range: Range<u64>) -> Result<Cow<'_, [u8]>> {
        let found = self.get(range.start as usize..range.end as usize);
        Ok(Cow::Borrowed(found.ok_or(ErrorKind::UnexpectedEof)?))
    }
}

/// A file, as long as it was when it was opened: one that is being written may grow meanwhile.
#[derive(Debug)]
pub struct FileSource {
    file: File,
    length: u64,
}

impl FileSource {
    /// Reads this file.
    pub fn new(file: File) -> Result<Self> {
        let length = file.metadata()?.len();
        Ok(Self { file, length })
    }

    /// As if it had no more than so many bytes.
    #[must_use]
    pub fn up_to(self, most: u64) -> Self {
        Self { length: self.length.min(most), ..self }
    }
}

impl Source for FileSource {
    fn length(&self) -> u64 {
        self.length
    }

    fn bytes(&self, range: Range<u64>) -> Result<Cow<'_, [u8]>> {
        let mut bytes = vec![0; (range.end - range.start) as usize];
        self.file.read_exact_at(&mut bytes, range.start)?;
        Ok(bytes.into())
    }
}
