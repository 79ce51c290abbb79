//! Writes a data set into a folder that has its name only when it is whole.

use crate::episode::Episode;
use crate::error::{DatasetError, disk, write};
use crate::npz::write_episode;
use crate::page::{self, Size, Source};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Writes a data set. It is there when [`Writer::finish`] has returned, or not at all.
pub struct Writer {
    out: PathBuf,
    /// Where it is until then. Removed with the writer.
    partial: PathBuf,
    source: Source,
    size: Size,
    cameras: Vec<String>,
}

impl Writer {
    pub fn create(out: &Path, source: Source) -> Result<Self, DatasetError> {
        if fs::symlink_metadata(out).is_ok() {
            return Err(DatasetError::Exists(out.to_path_buf()));
        }
        let mut name = out.file_name().unwrap_or_default().to_owned();
        name.push(".partial");
        let partial = out.with_file_name(name);
        if let Some(folder) = out.parent() {
            fs::create_dir_all(folder).map_err(|source| disk(folder, source))?;
        }
        fs::create_dir(&partial).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => DatasetError::Partial(partial.clone()),
            _ => disk(&partial, source),
        })?;
        let out = out.to_path_buf();
        Ok(Self { out, partial, source, size: Size::default(), cameras: Vec::new() })
    }

    pub fn add(&mut self, episode: &Episode) -> Result<(), DatasetError> {
        if self.size.episodes == 0 {
            self.cameras = episode.cameras.iter().map(|frames| frames.name.clone()).collect();
        }
        let path = self.partial.join(format!("episode-{:06}.npz", self.size.episodes));
        write_episode(&path, episode, &self.source)?;
        self.size.episodes += 1;
        self.size.steps += episode.moments.len() as u64 - 1;
        Ok(())
    }

    pub fn finish(mut self) -> Result<Size, DatasetError> {
        for (number, config) in self.source.configs.iter().enumerate() {
            let name = if number == 0 { "config.toml".to_owned() } else { format!("config-{number}.toml") };
            write(&self.partial.join(name), config.as_bytes())?;
        }
        let page = page::page(&self.source, self.size, &self.cameras);
        write(&self.partial.join("README.md"), page.as_bytes())?;
        self.size.bytes = bytes_in(&self.partial).map_err(|source| disk(&self.partial, source))?;
        // A folder that has come meanwhile and is empty would be replaced, which does no harm.
        fs::rename(&self.partial, &self.out).map_err(|source| disk(&self.out, source))?;
        Ok(self.size)
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // After `finish` it is not there.
        let _ = fs::remove_dir_all(&self.partial);
    }
}

fn bytes_in(folder: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let kind = entry.metadata()?;
        bytes += if kind.is_dir() { bytes_in(&entry.path())? } else { kind.len() };
    }
    Ok(bytes)
}
