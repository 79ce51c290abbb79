//! Files of one JSON object a line that are only ever appended to. A crash can truncate the last line. The next line
//! begins after it, and readers skip incomplete objects.

use anyhow::{Context, Result};
use proto::bounded::Lines;
use proto::plain_file::open_plain;
use proto::run_folder::{RunFolder, write_atomically};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

pub fn set_content(path: &Path, wanted: &[u8]) -> Result<()> {
    if is_content(path, [wanted]) {
        return Ok(());
    }
    write_atomically(path, wanted).with_context(|| format!("cannot write {}", path.display()))
}

pub fn is_content<B: AsRef<[u8]>>(path: &Path, wanted: impl IntoIterator<Item = B>) -> bool {
    let mut wanted = wanted.into_iter();
    let Ok(mut file) = open_plain(path, OpenOptions::new().read(true)).map(BufReader::new) else {
        return wanted.all(|part| part.as_ref().is_empty());
    };
    let mut found = Vec::new();
    let is_there = |part: B| {
        found.resize(part.as_ref().len(), 0);
        file.read_exact(&mut found).is_ok() && found == part.as_ref()
    };
    wanted.all(is_there) && file.fill_buf().is_ok_and(<[u8]>::is_empty)
}

/// The whole lines of a file in a run folder that has `most` bytes at most, in order, and how many others are damaged.
/// The last line may be cut off; a file that is not there has none.
pub fn read<T: DeserializeOwned>(folder: &RunFolder, path: &Path, most: u64) -> std::io::Result<(Vec<T>, usize)> {
    let (mut read, mut damaged) = (Vec::new(), 0);
    let mut lines = match folder.reader(path, most) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok((read, 0)),
        file => Lines::of(file?),
    };
    while let Some(line) = lines.read()? {
        match serde_json::from_slice::<T>(line) {
            Ok(one) => read.push(one),
            Err(_) => damaged += usize::from(line.ends_with(b"\n") && !line.trim_ascii().is_empty()),
        }
    }
    Ok((read, damaged))
}

pub struct Writer {
    file: File,
    path: PathBuf,
}

impl Writer {
    /// Opens a file for appending, made if there is none. A line that a crash cut short is ended.
    pub fn open(path: &Path) -> Result<Self> {
        let cannot = || format!("cannot open {}", path.display());
        let mut options = OpenOptions::new();
        let mut file = open_plain(path, options.create(true).read(true).append(true)).with_context(cannot)?;
        let mut last = [b'\n'];
        if file.metadata().with_context(cannot)?.len() > 0 {
            file.seek(SeekFrom::End(-1)).and_then(|_| file.read_exact(&mut last)).with_context(cannot)?;
        }
        if last != *b"\n" {
            file.write_all(b"\n").with_context(cannot)?;
        }
        Ok(Self { file, path: path.to_path_buf() })
    }

    pub fn append(&mut self, value: &impl Serialize) -> Result<()> {
        let mut line = serde_json::to_vec(value)?;
        line.push(b'\n');
        self.file.write_all(&line).with_context(|| format!("cannot write {}", self.path.display()))
    }

    pub fn is_of(&self, path: &Path) -> bool {
        let place = |metadata: Metadata| (metadata.dev(), metadata.ino());
        let (own, there) = (self.file.metadata().map(place), std::fs::symlink_metadata(path).map(place));
        matches!((own, there), (Ok(own), Ok(there)) if own == there)
    }

    pub fn clear(&mut self) -> Result<()> {
        self.file.set_len(0).with_context(|| format!("cannot write {}", self.path.display()))
    }

    pub fn sync(&self) -> Result<()> {
        self.file.sync_all().with_context(|| format!("cannot write {}", self.path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_was_cut_short_costs_itself_and_no_other() {
        let temporary = tempfile::tempdir().unwrap();
        let path = temporary.path().join("numbers.jsonl");
        let read = || read::<Vec<u32>>(&RunFolder::new(temporary.path()), &path, 1000);
        assert_eq!(read().unwrap(), (vec![], 0));
        Writer::open(&path).unwrap().append(&[1, 2]).unwrap();
        for torn in [&b"[3, "[..], b"[\"\xc3"] {
            OpenOptions::new().append(true).open(&path).unwrap().write_all(torn).unwrap();
            let mut writer = Writer::open(&path).unwrap();
            writer.append(&[4]).unwrap();
            writer.sync().unwrap();
        }
        assert_eq!(read().unwrap(), (vec![vec![1, 2], vec![4], vec![4]], 2));
        let mut writer = Writer::open(&path).unwrap();
        writer.clear().unwrap();
        writer.append(&[5]).unwrap();
        assert_eq!(read().unwrap(), (vec![vec![5]], 0));
        File::create(&path).unwrap().set_len(200 << 30).unwrap();
        assert!(read().unwrap_err().to_string().contains("more than the 1000 bytes"));

        let link = temporary.path().join("link");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        assert!(Writer::open(&link).is_err());
    }
}
