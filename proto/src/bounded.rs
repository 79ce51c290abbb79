//! Reading files that a user names, or that come from somebody else: ordinary files of a bounded size only.
//!
//! A pipe would have us wait for ever, `/dev/zero` would fill the memory, and so would a file of a hundred gigabytes.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{BufRead, BufReader, Error, ErrorKind, Read, Result};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// A text that a person writes, or that we write for one: configurations, suites, scene files.
pub(crate) const TEXT_BYTES_MOST: u64 = 4 << 20;
/// Lines and tables that grow with a run or an evaluation: tens of megabytes where there are very many.
const FIGURES_BYTES_MOST: u64 = 1 << 30;

/// Opens an ordinary file for reading. Links are followed: the user named the file, and nothing is written to it.
pub fn open(path: &Path) -> Result<File> {
    let ordinary = |metadata: Metadata| {
        let refused = || Error::new(ErrorKind::InvalidInput, "it is not an ordinary file");
        if metadata.is_file() { Ok(metadata) } else { Err(refused()) }
    };
    // Before it is opened, since to open a device can do something; and after, since it can be another one by then.
    // Without O_NONBLOCK the opening of a pipe waits for its other end.
    ordinary(std::fs::metadata(path)?)?;
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path)?;
    ordinary(file.metadata()?)?;
    Ok(file)
}

/// The same for a file that has `most` bytes at most, with its length.
fn open_at_most(path: &Path, most: u64) -> Result<(File, u64)> {
    let file = open(path)?;
    let length = file.metadata()?.len();
    if length > most { Err(too_long(most)) } else { Ok((file, length)) }
}

fn too_long(most: u64) -> Error {
    Error::new(ErrorKind::FileTooLarge, format!("it has more than the {most} bytes that such a file may have"))
}

/// The bytes of an ordinary file that has `most` at most.
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    let (file, length) = open_at_most(path, most)?;
    // It may have grown since, and the size of what lies in /proc is unknown.
    let mut bytes = Vec::with_capacity(length as usize + 1);
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(too_long(most)) } else { Ok(bytes) }
}

/// The text of an ordinary file of [`TEXT_BYTES_MOST`] bytes at most.
pub fn read_text(path: &Path) -> Result<String> {
    text(read(path, TEXT_BYTES_MOST)?)
}

/// The figures of a run or of an evaluation: the text of an ordinary file of 1 GiB at most.
pub fn read_figures_text(path: &Path) -> Result<String> {
    text(read(path, FIGURES_BYTES_MOST)?)
}

/// The same, to be read line by line.
pub fn open_figures(path: &Path) -> Result<impl BufRead> {
    open_at_most(path, FIGURES_BYTES_MOST).map(|(file, _)| BufReader::new(file.take(FIGURES_BYTES_MOST)))
}

fn text(bytes: Vec<u8>) -> Result<String> {
    String::from_utf8(bytes).map_err(|_| Error::new(ErrorKind::InvalidData, "it is not text in UTF-8"))
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
            (folder.path().to_path_buf(), "not an ordinary file"),
            (at("long"), "more than the 4194304 bytes"),
        ] {
            let found = message(read_text(&path).unwrap_err());
            assert!(found.contains(problem), "{}: {found}", path.display());
            let found = message(read_figures_text(&path).unwrap_err());
            assert!(found.contains(&problem.replace("4194304", "1073741824")), "{}: {found}", path.display());
        }
        std::fs::write(at("latin"), [b'a', 0xe4]).unwrap();
        assert!(message(read_text(&at("latin")).unwrap_err()).contains("UTF-8"));
        assert_eq!(read_text(&at("none")).unwrap_err().kind(), ErrorKind::NotFound);
    }
}
