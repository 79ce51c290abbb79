use std::borrow::Cow;
use std::cell::RefCell;
use std::fs::File;
use std::io::{ErrorKind, Result};
use std::ops::Range;
use std::os::unix::fs::FileExt;

/// Shorter reads of a file are served from a block of this size.
const BLOCK_BYTES: u64 = 4096;

pub trait Source {
    fn length(&self) -> u64;

    fn bytes(&self, range: Range<u64>) -> Result<Cow<'_, [u8]>>;
}

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
pub struct FileSource {
    file: File,
    length: u64,
    block: RefCell<(u64, Vec<u8>)>,
}

impl FileSource {
    pub fn new(file: File) -> Result<Self> {
        let length = file.metadata()?.len();
        Ok(Self { file, length, block: RefCell::default() })
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
        let count = (range.end - range.start) as usize;
        if count as u64 >= BLOCK_BYTES {
            let mut bytes = vec![0; count];
            self.file.read_exact_at(&mut bytes, range.start)?;
            return Ok(bytes.into());
        }
        let (start, block) = &mut *self.block.borrow_mut();
        if range.start < *start || range.end > *start + block.len() as u64 {
            *start = range.start;
            block.resize(BLOCK_BYTES.min(self.length.saturating_sub(*start)) as usize, 0);
            self.file.read_exact_at(block, *start)?;
        }
        let found = block.get((range.start - *start) as usize..).and_then(|rest| rest.get(..count));
        Ok(found.ok_or(ErrorKind::UnexpectedEof)?.to_vec().into())
    }
}
