use std::fs::File;
use std::io::{ErrorKind, Result};
use std::ops::Range;
use std::os::unix::fs::FileExt;

pub trait Source {
    fn length(&self) -> u64;

    fn bytes(&self, range: Range<u64>) -> Result<Vec<u8>>;
}

impl Source for &[u8] {
    fn length(&self) -> u64 {
        self.len() as u64
    }

    fn bytes(&self, range: Range<u64>) -> Result<Vec<u8>> {
        let found = self.get(range.start as usize..range.end as usize);
        Ok(found.ok_or(ErrorKind::UnexpectedEof)?.to_vec())
    }
}

/// A file, as long as it was when it was opened: one that is being written may grow meanwhile.
pub struct FileSource {
    file: File,
    length: u64,
}

impl FileSource {
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

    fn bytes(&self, range: Range<u64>) -> Result<Vec<u8>> {
        let mut bytes = vec![0; (range.end - range.start) as usize];
        self.file.read_exact_at(&mut bytes, range.start)?;
        Ok(bytes)
    }
}
