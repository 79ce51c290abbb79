//! Where the bytes come from: a file, or memory.

use std::cell::RefCell;
use std::fs::File;
use std::io::{ErrorKind, Result};
use std::os::unix::fs::FileExt;

/// Bytes of a file that are read at once.
const WINDOW_BYTES: usize = 256 << 10;

/// Bytes that can be read at any place.
pub trait Source {
    /// How many there are.
    fn length(&self) -> u64;

    /// Fills `buffer` with those from `offset` on; all of them must be there. What comes next is read soon.
    fn read(&self, offset: u64, buffer: &mut [u8]) -> Result<()>;

    /// The same for a short look at some place: nothing is read ahead.
    fn peek(&self, offset: u64, buffer: &mut [u8]) -> Result<()>;
}

/// The `N` bytes from `offset` on, if there are so many.
pub fn peek<const N: usize>(source: &impl Source, offset: u64) -> Result<Option<[u8; N]>> {
    let mut bytes = [0; N];
    if offset.checked_add(N as u64).is_none_or(|end| end > source.length()) {
        return Ok(None);
    }
    source.peek(offset, &mut bytes)?;
    Ok(Some(bytes))
}

impl Source for &[u8] {
    fn length(&self) -> u64 {
        self.len() as u64
    }

    fn read(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        let rest =
            usize::try_from(offset).ok().and_then(|offset| self.get(offset..)).ok_or(ErrorKind::UnexpectedEof)?;
        buffer.copy_from_slice(rest.get(..buffer.len()).ok_or(ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn peek(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        self.read(offset, buffer)
    }
}

/// A file, as long as it was when it was opened: one that is being written may grow meanwhile.
#[derive(Debug)]
pub struct FileSource {
    file: File,
    length: u64,
    /// Where it begins, and what was read there.
    window: RefCell<(u64, Vec<u8>)>,
}

impl FileSource {
    /// Reads this file.
    pub fn new(file: File) -> Result<Self> {
        let length = file.metadata()?.len();
        Ok(Self { file, length, window: RefCell::default() })
    }

    /// As if it had no more than so many bytes.
    #[must_use]
    pub fn up_to(self, most: u64) -> Self {
        Self { length: self.length.min(most), ..self }
    }

    /// Copies from the window, if all is in it.
    fn copy(&self, offset: u64, buffer: &mut [u8]) -> bool {
        let window = self.window.borrow();
        let (start, bytes) = &*window;
        let Some(at) = offset.checked_sub(*start).and_then(|at| usize::try_from(at).ok()) else { return false };
        let Some(found) = bytes.get(at..).and_then(|rest| rest.get(..buffer.len())) else { return false };
        buffer.copy_from_slice(found);
        true
    }
}

impl Source for FileSource {
    fn length(&self) -> u64 {
        self.length
    }

    fn read(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        if self.copy(offset, buffer) {
            return Ok(());
        }
        if buffer.len() >= WINDOW_BYTES {
            return self.file.read_exact_at(buffer, offset);
        }
        let length = (WINDOW_BYTES as u64).min(self.length.saturating_sub(offset)) as usize;
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, offset)?;
        *self.window.borrow_mut() = (offset, bytes);
        if self.copy(offset, buffer) { Ok(()) } else { Err(ErrorKind::UnexpectedEof.into()) }
    }

    fn peek(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        if self.copy(offset, buffer) { Ok(()) } else { self.file.read_exact_at(buffer, offset) }
    }
}
