//! A file of lines that grows: what is new in it since it was read last, a block at a time.

use proto::run_folder::RunFolder;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::PathBuf;

const BLOCK: u64 = 64 << 10;
const LINE_MAX: usize = 256 << 10;

pub struct Tail {
    folder: RunFolder,
    path: PathBuf,
    from: u64,
    /// Number of the file that was read: another one with the same name is read from its start.
    inode: u64,
    offset: u64,
    begun: Vec<u8>,
    is_cut: bool,
    /// The first bytes of the file: where they differ it was written anew.
    first: Vec<u8>,
}

#[derive(Debug, Default, PartialEq, Eq)]
pub struct New {
    pub anew: bool,
    pub lines: Vec<Vec<u8>>,
    pub more: bool,
}

impl Tail {
    pub fn of(folder: RunFolder, path: PathBuf, from: u64) -> Self {
        Self { folder, path, from, inode: 0, offset: 0, begun: Vec::new(), is_cut: false, first: Vec::new() }
    }

    pub fn length(&self, most: u64) -> std::io::Result<u64> {
        match self.folder.reader(&self.path, most) {
            Ok(file) => Ok(file.get_ref().get_ref().metadata()?.len()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(0),
            Err(error) => Err(error),
        }
    }

    fn begin(&mut self, inode: u64, offset: u64) {
        (self.inode, self.offset, self.is_cut) = (inode, offset, offset > 0);
        self.begun.clear();
        self.first.clear();
    }

    pub fn read(&mut self) -> std::io::Result<New> {
        let mut new = New::default();
        let file = match self.folder.open(&self.path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                new.anew = self.offset > 0;
                self.begin(0, 0);
                return Ok(new);
            }
            Err(error) => return Err(error),
        };
        let metadata = file.metadata()?;
        let length = metadata.len();
        let mut first = vec![0; self.first.len()];
        let is_same = metadata.ino() == self.inode
            && length >= self.offset
            && file.read_exact_at(&mut first, 0).is_ok()
            && first == self.first;
        if !is_same {
            new.anew = self.offset > 0;
            let from = if self.inode == 0 { self.from.min(length) } else { 0 };
            self.begin(metadata.ino(), from);
        }
        if self.first.len() < 64 {
            self.first.resize(length.min(64) as usize, 0);
            file.read_exact_at(&mut self.first, 0)?;
        }
        let mut block = vec![0; BLOCK.min(length - self.offset) as usize];
        file.read_exact_at(&mut block, self.offset)?;
        self.offset += block.len() as u64;
        new.more = self.offset < length;
        for piece in block.split_inclusive(|&byte| byte == b'\n') {
            self.begun.extend_from_slice(piece);
            if self.begun.last() == Some(&b'\n') {
                self.begun.pop();
                let line = std::mem::take(&mut self.begun);
                if !std::mem::take(&mut self.is_cut) {
                    new.lines.push(line);
                }
            } else if self.begun.len() > LINE_MAX {
                self.begun.clear();
                self.is_cut = true;
            }
        }
        Ok(new)
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
        let mut tail = Tail::of(RunFolder::new(folder.path()), path.clone(), 0);
        let mut read = || {
            let New { anew, lines, more } = tail.read().unwrap();
            assert!(!more);
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

    #[test]
    fn a_huge_file_is_read_a_block_at_a_time_from_where_it_is_to_begin() {
        let temporary = tempfile::tempdir().unwrap();
        let (folder, path) = (RunFolder::new(temporary.path()), temporary.path().join("lines"));
        let mut file = File::create(&path).unwrap();
        file.set_len(200 << 30).unwrap();
        std::io::Seek::seek(&mut file, std::io::SeekFrom::End(0)).unwrap();
        file.write_all(b"\nlast\n").unwrap();
        let mut tail = Tail::of(folder.clone(), path.clone(), (200 << 30) - BLOCK);
        let first = tail.read().unwrap();
        assert!(first.lines.is_empty() && first.more);
        assert_eq!(tail.read().unwrap().lines, [b"last"]);
        assert_eq!(tail.read().unwrap(), New::default());
        assert!(tail.length(1 << 30).is_err());
    }
}
