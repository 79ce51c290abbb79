//! Words that several processes share: a file that each of them maps. The unsafe code of receipts, bells and notes.

use rustix::fs::{Mode, OFlags};
use rustix::mm::{MapFlags, ProtFlags};
use std::io::{Error, ErrorKind, Result, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

pub struct SharedWords {
    start: NonNull<AtomicU64>,
    count: usize,
    writable: bool,
}

// SAFETY: the mapping belongs to the process, not to a thread, and lives as long as this; all use it through atomics
// only.
unsafe impl Send for SharedWords {}
// SAFETY: as above.
unsafe impl Sync for SharedWords {}

impl SharedWords {
    /// Makes the file, all zero, for this user alone. It is written, not only made long: a full disk is an error here,
    /// and not a fatal signal at a first store.
    pub fn create(path: &Path, count: usize) -> Result<()> {
        let mut file = std::fs::File::options().write(true).create_new(true).mode(0o600).open(path)?;
        file.write_all(&vec![0; count * size_of::<u64>()])
    }

    /// Maps a file that holds at least `count` words.
    pub fn open(path: &Path, count: usize, writable: bool) -> Result<Self> {
        let (access, protection) = if writable {
            (OFlags::RDWR, ProtFlags::READ | ProtFlags::WRITE)
        } else {
            (OFlags::RDONLY, ProtFlags::READ)
        };
        let file = rustix::fs::open(path, access | OFlags::NOFOLLOW | OFlags::CLOEXEC, Mode::empty())?;
        let bytes = count * size_of::<u64>();
        let found = u64::try_from(rustix::fs::fstat(&file)?.st_size).unwrap_or(0);
        if bytes == 0 || found < bytes as u64 {
            return Err(Error::new(ErrorKind::InvalidData, format!("it has {found} bytes of {bytes}")));
        }
        // SAFETY: a new mapping at an address of the kernel's choice: no memory of ours is touched.
        let start =
            unsafe { rustix::mm::mmap(std::ptr::null_mut(), bytes, protection, MapFlags::SHARED, file.as_fd(), 0)? };
        let start = NonNull::new(start.cast()).ok_or_else(|| Error::other("mapped at address 0"))?;
        Ok(Self { start, count, writable })
    }

    /// A word; what was written before it was stored is seen, too. Panics if there is none with this index.
    pub fn load(&self, index: usize) -> u64 {
        self.word(index).load(Ordering::Acquire)
    }

    /// Stores a word. Panics if there is none with this index, or the words were mapped for reading.
    pub fn store(&self, index: usize, value: u64) {
        assert!(self.writable, "words that were mapped for reading are not written");
        self.word(index).store(value, Ordering::Release);
    }

    /// The lower half of a word that is never used as a whole: the kernel waits for 32 bits. Panics if there is none
    /// with this index, or the words were mapped for reading.
    pub fn low(&self, index: usize) -> &AtomicU32 {
        assert!(self.writable, "a word that is only read is read whole");
        let word: *const AtomicU64 = self.word(index);
        // SAFETY: a word's lower half comes first on this processor, and its alignment suffices; the word lives as long
        // as self, and is used by halves only, in all processes.
        unsafe { &*word.cast() }
    }

    fn word(&self, index: usize) -> &AtomicU64 {
        assert!(index < self.count, "there are {} words, not {index}", self.count);
        // SAFETY: the word lies in the mapping, which begins on a page and so is aligned, and lives as long as self.
        // All processes use it through atomics only; any bits are a valid number.
        unsafe { self.start.add(index).as_ref() }
    }
}

impl Drop for SharedWords {
    fn drop(&mut self) {
        // SAFETY: exactly the mapping that `open` made; no reference into it outlives self.
        let _ = unsafe { rustix::mm::munmap(self.start.as_ptr().cast(), self.count * size_of::<u64>()) };
    }
}
