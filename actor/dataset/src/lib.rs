//! Episodes as data sets for other programs. Whoever simulates them hands over one [`Episode`] after the other; a
//! [`Writer`] holds no more than one group of rows of them.
//!
//! ```text
//! episode   what an episode is here
//! fields    what is held of every step: one table for all formats
//! column    columns of a table, and their schema
//! table     a Parquet file that is written group by group
//! lerobot   a LeRobotDataset v3
//! stats     its statistics
//! tables    two plain Parquet tables
//! npz       an archive of `NumPy` an episode
//! page      the page that says what is in the folder
//! ```

mod column;
mod episode;
mod fields;
mod lerobot;
mod npz;
mod page;
mod stats;
mod table;
mod tables;

pub use episode::{About, Episode, Frames, Seen, Step};

use lerobot::LeRobot;
use npz::Archives;
use proto::dataset::DatasetFormat;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use tables::Tables;

/// Why a data set was not written.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The folder is there.
    #[error("{} exists; remove it or choose another --out", .0.display())]
    Exists(PathBuf),
    /// What an export that is running or was killed works in.
    #[error("{} is there: another export writes it, or was killed; if none is running, remove it", .0.display())]
    Partial(PathBuf),
    /// The disk.
    #[error("{} cannot be written", path.display())]
    Disk {
        /// File or folder.
        path: PathBuf,
        /// What is wrong.
        source: io::Error,
    },
    /// A table.
    #[error("{} cannot be written", path.display())]
    Table {
        /// Its file.
        path: PathBuf,
        /// What is wrong.
        source: parquet::errors::ParquetError,
    },
    /// An archive.
    #[error("{} cannot be written", path.display())]
    Archive {
        /// Its file.
        path: PathBuf,
        /// What is wrong.
        source: zip::result::ZipError,
    },
    /// A picture.
    #[error("a frame cannot be packed")]
    Picture(#[source] png::EncodingError),
}

/// What a data set is of.
#[derive(Debug, Clone)]
pub struct Source {
    /// Names of the actions, in the order of their numbers.
    pub actions: Vec<&'static str>,
    /// Configurations of the run, TOML.
    pub configs: Vec<String>,
}

/// How large a data set is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Size {
    /// Episodes.
    pub episodes: u64,
    /// Steps.
    pub steps: u64,
    /// Bytes of all files.
    pub bytes: u64,
}

enum Form {
    LeRobot(Box<LeRobot>),
    Tables(Box<Tables>),
    Archives(Archives),
}

/// Writes a data set. It is there when [`Writer::finish`] has returned, or not at all.
pub struct Writer {
    out: PathBuf,
    /// Where it is until then. Removed with the writer.
    partial: PathBuf,
    source: Source,
    format: DatasetFormat,
    form: Form,
    size: Size,
    cameras: Vec<String>,
}

impl Writer {
    /// A data set that is to be `out`.
    pub fn create(out: &Path, format: DatasetFormat, source: Source) -> Result<Self, DatasetError> {
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
        let form = match format {
            DatasetFormat::LeRobot => Form::LeRobot(Box::new(LeRobot::new(&partial))),
            DatasetFormat::Parquet => Form::Tables(Box::new(Tables::new(&partial, &source))),
            DatasetFormat::Npz => Form::Archives(Archives::new(&partial)),
        };
        let out = out.to_path_buf();
        Ok(Self { out, partial, source, format, form, size: Size::default(), cameras: Vec::new() })
    }

    /// Adds an episode.
    pub fn add(&mut self, episode: &Episode) -> Result<(), DatasetError> {
        if self.size.episodes == 0 {
            self.cameras = episode.cameras.iter().map(|frames| frames.name.to_owned()).collect();
        }
        match &mut self.form {
            Form::LeRobot(form) => form.add(episode)?,
            Form::Tables(form) => form.add(episode)?,
            Form::Archives(form) => form.add(episode)?,
        }
        self.size.episodes += 1;
        self.size.steps += episode.steps.len() as u64;
        Ok(())
    }

    /// Writes the rest, and gives the folder its name.
    pub fn finish(mut self) -> Result<Size, DatasetError> {
        match &mut self.form {
            Form::LeRobot(form) => form.finish(&self.source)?,
            Form::Tables(form) => form.finish()?,
            Form::Archives(_) => {}
        }
        for (number, config) in self.source.configs.iter().enumerate() {
            let name = if number == 0 { "config.toml".to_owned() } else { format!("config-{number}.toml") };
            write(&self.partial.join(name), config.as_bytes())?;
        }
        let page = page::page(self.format, &self.source, self.size, &self.cameras);
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

fn disk(path: &Path, source: io::Error) -> DatasetError {
    DatasetError::Disk { path: path.to_path_buf(), source }
}

/// Writes a whole file, and the folders above it.
fn write(path: &Path, content: &[u8]) -> Result<(), DatasetError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).and_then(|()| fs::write(path, content)).map_err(|source| disk(path, source))
}
