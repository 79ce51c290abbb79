//! A recording on disk that is a complete file at every moment, also while it grows.
//!
//! Programs that seek begin at a file's end: without index and end mark they read nothing of it. So each time data
//! goes to the operating system, index and end mark go with it, in one write after the data; the next write begins
//! where the data ended and replaces them. A killed recorder leaves a complete file, too.

use super::index::Index;
use mcap::MAGIC;
use std::cell::{Cell, RefCell};
use std::fs::File;
use std::io::{Error, ErrorKind, Result, Seek, SeekFrom, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::rc::Rc;
use wire::fault;

/// A new file that counts the bytes of data it is given.
pub struct LiveFile {
    file: File,
    /// Shared with the writer of schemas and channels: the file holds them in compressed chunks.
    index: Rc<RefCell<Index>>,
    pending: Vec<u8>,
    data_end: u64,
    tail: Vec<u8>,
    bytes: Rc<Cell<u64>>,
}

impl LiveFile {
    pub fn create(path: &Path, index: Rc<RefCell<Index>>, bytes: Rc<Cell<u64>>) -> Result<Self> {
        let file = File::options().write(true).create_new(true).open(path)?;
        // Tells `recover` to leave it alone, and `status` that it grows. Where the file system has no locks there is
        // none.
        let _ = file.try_lock();
        Ok(Self { file, index, pending: Vec::new(), data_end: 0, tail: Vec::new(), bytes })
    }

    pub fn close(mut self) -> Result<()> {
        self.commit()?;
        // The last tail of ours may have been longer than the writer's.
        self.file.set_len(self.data_end)?;
        fault::reach("recorder.before_fsync");
        self.file.sync_all()?;
        fault::reach("recorder.after_fsync");
        Ok(())
    }

    fn commit(&mut self) -> Result<()> {
        if self.pending.is_empty() {
            return Ok(());
        }
        let begin = self.data_end;
        let end = begin + self.pending.len() as u64;
        let magic = if begin == 0 { MAGIC.len() } else { 0 };
        let records = self.pending.get(magic..).unwrap_or_default();
        let mut index = self.index.borrow_mut();
        let finished = index.note(begin + magic as u64, records).map_err(Error::other)?;
        let tail = if finished { Vec::new() } else { index.tail(end) };
        self.pending.extend_from_slice(&tail);
        fault::reach("recorder.before_chunk");
        if let Err(error) = self.file.write_all_at(&self.pending, begin) {
            // The space that the old tail took is there again.
            let _ = self.file.set_len(begin).and_then(|()| self.file.write_all_at(&self.tail, begin));
            return Err(error);
        }
        fault::reach("recorder.after_chunk");
        self.pending.clear();
        self.data_end = end;
        self.tail = tail;
        Ok(())
    }
}

impl Write for LiveFile {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.pending.extend_from_slice(bytes);
        self.bytes.set(self.bytes.get() + bytes.len() as u64);
        Ok(bytes.len())
    }

    /// The data so far must end with a whole record.
    fn flush(&mut self) -> Result<()> {
        self.commit()
    }
}

/// The writer only asks where it is: chunks are put together in memory ([`mcap::WriteOptions::disable_seeking`]).
impl Seek for LiveFile {
    fn seek(&mut self, position: SeekFrom) -> Result<u64> {
        match position {
            SeekFrom::Current(0) => Ok(self.data_end + self.pending.len() as u64),
            _ => Err(Error::new(ErrorKind::Unsupported, "a recording is written from its start to its end")),
        }
    }
}
