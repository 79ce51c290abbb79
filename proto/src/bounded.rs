//! Reading files that a user names, or that come from somebody else: ordinary files of a bounded size only.
//!
//! A pipe would have us wait for ever, `/dev/zero` would fill the memory, and so would a file of a hundred gigabytes. What
//! lies in a run folder is opened by [`crate::run_folder::RunFolder`], with these bounds.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{BufRead, BufReader, Error, ErrorKind, Read, Result, Take};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// A text that a person writes, or that we write for one: configurations, suites, scene files. A manifest, a summary.
pub(crate) const TEXT_BYTES_MOST: u64 = 4 << 20;
/// The result of an evaluation; the lines of all validations of a run.
pub const RESULT_BYTES_MOST: u64 = 16 << 20;
/// An evaluation's table of episodes, which has a hundred bytes for each.
pub const TABLE_BYTES_MOST: u64 = 256 << 20;
/// The figures of a run, about a kilobyte a rollout: 950M frames in the paper's shape, five billion of `recipe`.
pub const FIGURES_BYTES_MOST: u64 = 256 << 20;
/// A line of any of them.
pub(crate) const LINE_BYTES_MOST: u64 = 1 << 20;
/// What a folder holds: recordings, logs, checkpoints.
pub(crate) const ENTRIES_MOST: usize = 100_000;

/// Opens an ordinary file for reading. Links are followed: the user named the file, and nothing is written to it.
pub fn open(path: &Path) -> Result<File> {
    let ordinary = |metadata: Metadata| {
        let what = if metadata.is_dir() { "it is a folder" } else { "it is not an ordinary file" };
        if metadata.is_file() { Ok(metadata) } else { Err(Error::new(ErrorKind::InvalidInput, what)) }
    };
    // Before it is opened, since to open a device can do something; and after, since it can be another one by then.
    // Without O_NONBLOCK the opening of a pipe waits for its other end.
    ordinary(std::fs::metadata(path)?)?;
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path)?;
    ordinary(file.metadata()?)?;
    Ok(file)
}

pub(crate) fn too_long(what: &str) -> Error {
    Error::new(ErrorKind::FileTooLarge, format!("it has more than the {what} that are read"))
}

pub fn reader(file: File, most: u64) -> Result<BufReader<Take<File>>> {
    let is_too_long = file.metadata()?.len() > most;
    if is_too_long { Err(too_long(&format!("{most} bytes"))) } else { Ok(BufReader::new(file.take(most))) }
}

/// All bytes of a file that has `most` at most.
pub fn content(file: File, most: u64) -> Result<Vec<u8>> {
    let length = file.metadata()?.len();
    // It may have grown since, and the size of what lies in /proc is unknown.
    let mut rest = reader(file, most)?.into_inner();
    rest.set_limit(most + 1);
    let mut bytes = Vec::with_capacity(length as usize + 1);
    rest.read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(too_long(&format!("{most} bytes"))) } else { Ok(bytes) }
}

pub fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    content(open(path)?, most)
}

/// The text of an ordinary file of [`TEXT_BYTES_MOST`] bytes at most.
pub fn read_text(path: &Path) -> Result<String> {
    text(read(path, TEXT_BYTES_MOST)?)
}

pub(crate) fn text(bytes: Vec<u8>) -> Result<String> {
    String::from_utf8(bytes).map_err(|_| Error::new(ErrorKind::InvalidData, "it is not text in UTF-8"))
}

/// Lines, one after the other, of which only one is in memory.
#[derive(Debug)]
pub struct Lines<R> {
    file: R,
    line: Vec<u8>,
}

impl<R: BufRead> Lines<R> {
    pub fn of(file: R) -> Self {
        Self { file, line: Vec::new() }
    }

    /// The next line, with its end if that is there; of a line of more than [`LINE_BYTES_MOST`] bytes only so many.
    pub fn read(&mut self) -> Result<Option<&[u8]>> {
        self.line.clear();
        (&mut self.file).take(LINE_BYTES_MOST).read_until(b'\n', &mut self.line)?;
        let is_cut = self.line.len() as u64 == LINE_BYTES_MOST && !self.line.ends_with(b"\n");
        if is_cut && self.file.skip_until(b'\n')? > 0 {
            self.line.push(b'\n');
        }
        Ok(Some(self.line.as_slice()).filter(|line| !line.is_empty()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ordinary_files_of_a_bounded_size_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("short"), "seed = 1").unwrap();
        std::os::unix::fs::symlink(at("short"), at("link")).unwrap();
        assert_eq!(read_text(&at("short")).unwrap(), "seed = 1");
        assert_eq!(read_text(&at("link")).unwrap(), "seed = 1");
        assert_eq!(read(&at("short"), 8).unwrap(), b"seed = 1");
        let message = |error: Error| error.to_string();
        assert!(message(read(&at("short"), 7).unwrap_err()).contains("more than the 7 bytes"));

        assert!(std::process::Command::new("mkfifo").arg(at("pipe")).status().unwrap().success());
        // A file with nothing in it that says that it is huge.
        std::fs::File::create(at("long")).unwrap().set_len(100 << 30).unwrap();
        for (path, problem) in [
            (at("pipe"), "not an ordinary file"),
            ("/dev/zero".into(), "not an ordinary file"),
            (folder.path().to_path_buf(), "it is a folder"),
            (at("long"), "more than the 4194304 bytes"),
        ] {
            let found = message(read_text(&path).unwrap_err());
            assert!(found.contains(problem), "{}: {found}", path.display());
        }
        std::fs::write(at("latin"), [b'a', 0xe4]).unwrap();
        assert!(message(read_text(&at("latin")).unwrap_err()).contains("UTF-8"));
        assert_eq!(read_text(&at("none")).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[test]
    fn a_line_without_end_costs_no_memory_and_itself_alone() {
        let long = std::io::repeat(0).take(300 << 20).chain(&b"\nlast\ncut off"[..]);
        let mut lines = Lines::of(BufReader::new((&b"first\n"[..]).chain(long)));
        let mut read = || lines.read().unwrap().map(|line| (line.len(), line.last().copied()));
        assert_eq!(read(), Some((6, Some(b'\n'))));
        assert_eq!(read(), Some((LINE_BYTES_MOST as usize + 1, Some(b'\n'))));
        assert_eq!([read(), read(), read()], [Some((5, Some(b'\n'))), Some((7, Some(b'f'))), None]);
        assert!(lines.line.capacity() < 4 << 20);
    }
}
