//! A file of lines that grows: what is new in it since it was read last.

use proto::bounded;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::PathBuf;

/// Bytes that are read at a time.
const BLOCK: usize = 4 << 20;
/// A line longer than this is no line of ours.
const LINE_MAX: usize = 16 << 20;

/// The file, and how much of it was read.
#[derive(Debug)]
pub struct Tail {
    path: PathBuf,
    /// Number of the file that was read: another one with the same name is read from its start.
    inode: u64,
    offset: u64,
    /// The beginning of a line whose end was not there yet.
    begun: Vec<u8>,
    /// The first bytes of the file: where they differ it was written anew.
    first: Vec<u8>,
}

/// What was read.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct New {
    /// The file was replaced or cut: all that was read before is void.
    pub anew: bool,
    /// Whole lines, without their ends.
    pub lines: Vec<Vec<u8>>,
}

impl Tail {
    /// Nothing was read yet.
    pub fn of(path: PathBuf) -> Self {
        Self { path, inode: 0, offset: 0, begun: Vec::new(), first: Vec::new() }
    }

    /// The lines that are new. A file that is not there has none.
    pub fn read(&mut self) -> std::io::Result<New> {
        let mut new = New::default();
        let file = match bounded::open(&self.path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                new.anew = self.offset > 0;
                *self = Self::of(std::mem::take(&mut self.path));
                return Ok(new);
            }
            Err(error) => return Err(error),
        };
        let metadata = file.metadata()?;
        let mut first = vec![0; self.first.len()];
        let is_same = metadata.ino() == self.inode
            && metadata.len() >= self.offset
            && file.read_exact_at(&mut first, 0).is_ok()
            && first == self.first;
        if !is_same {
            new.anew = self.offset > 0;
            *self = Self { inode: metadata.ino(), ..Self::of(std::mem::take(&mut self.path)) };
        }
        let mut block = vec![0; BLOCK.min(metadata.len().saturating_sub(self.offset) as usize + 1)];
        loop {
            let count = file.read_at(&mut block, self.offset)?;
            if count == 0 {
                return Ok(new);
            }
            if self.first.len() < 64 && self.offset < 64 {
                self.first.extend_from_slice(&block[..count.min(64 - self.first.len())]);
            }
            self.offset += count as u64;
            for piece in block[..count].split_inclusive(|&byte| byte == b'\n') {
                self.begun.extend_from_slice(piece);
                if self.begun.last() == Some(&b'\n') {
                    self.begun.pop();
                    new.lines.push(std::mem::take(&mut self.begun));
                } else if self.begun.len() > LINE_MAX {
                    self.begun.clear();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::io::Write;

    #[test]
    fn only_new_whole_lines_are_read_and_a_new_file_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let mut tail = Tail::of(path.clone());
        let mut read = || {
            let New { anew, lines } = tail.read().unwrap();
            (anew, lines.into_iter().map(|line| String::from_utf8(line).unwrap()).collect::<Vec<_>>())
        };
        let lines = |lines: &[&str]| lines.iter().map(|&line| line.to_owned()).collect::<Vec<_>>();
        assert_eq!(read(), (false, vec![]), "no file yet");
        let mut file = File::options().create(true).append(true).open(&path).unwrap();
        file.write_all(b"one\ntwo\nthr").unwrap();
        assert_eq!(read(), (false, lines(&["one", "two"])));
        file.write_all(b"ee\n").unwrap();
        assert_eq!(read(), (false, lines(&["three"])));
        assert_eq!(read(), (false, vec![]));
        // Written anew in place, and as long as before.
        std::fs::write(&path, b"ONE\nTWO\nTHREE\nfour\n").unwrap();
        assert_eq!(read(), (true, lines(&["ONE", "TWO", "THREE", "four"])));
        std::fs::write(folder.path().join("other"), b"a\n").unwrap();
        std::fs::rename(folder.path().join("other"), &path).unwrap();
        assert_eq!(read(), (true, lines(&["a"])));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(read(), (true, vec![]));
    }
}
