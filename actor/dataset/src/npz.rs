//! An archive of `NumPy` an episode. Arrays of what was seen have one row more than there were actions.

use crate::episode::{Episode, Frames};
use crate::error::{DatasetError, disk};
use crate::page::Source;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use zip::result::ZipResult;
use zip::write::{SimpleFileOptions, ZipWriter};

pub fn write_episode(path: &Path, episode: &Episode, source: &Source) -> Result<(), DatasetError> {
    let file = File::create_new(path).map_err(|source| disk(path, source))?;
    let mut archive = Archive(ZipWriter::new(BufWriter::new(file)));
    let written = archive.episode(episode, source).and_then(|()| archive.0.finish());
    let mut file = written.map_err(|source| DatasetError::Archive { path: path.to_path_buf(), source })?;
    file.flush().map_err(|source| disk(path, source))
}

struct Archive(ZipWriter<BufWriter<File>>);

impl Archive {
    fn episode(&mut self, episode: &Episode, source: &Source) -> ZipResult<()> {
        for frames in &episode.cameras {
            self.frames(frames)?;
        }
        for column in source.columns() {
            let (rows, mut bytes) = (column.rows(episode), Vec::new());
            for (row, moment) in rows.iter().enumerate() {
                column.append(moment, column.is_seen && row == 0, &source.numbers, &mut bytes);
            }
            let shape = [&[rows.len()], &*column.shape].concat();
            self.array(&column.name, column.kind, &shape, &bytes)?;
        }
        let about = &episode.about;
        let numbers = [
            ("kitchen", i64::from(about.kitchen)),
            ("environment", i64::from(about.environment)),
            ("episode", i64::from(about.number)),
            ("fixed_episode", about.fixed.map_or(-1, i64::from)),
        ];
        for (name, number) in numbers {
            self.array(name, "<i8", &[], &number.to_le_bytes())?;
        }
        for (metric, number) in source.spec.metrics.iter().zip(&about.metrics) {
            self.array(&format!("metric_{}", metric.name), "<f8", &[], &number.to_le_bytes())?;
        }
        self.array("seed", "<u8", &[], &about.seed.to_le_bytes())?;
        self.texts("outcome", &[], &[&about.outcome])?;
        for channel in source.spec.channels.iter().filter(|channel| !channel.names.is_empty()) {
            let names: Vec<&str> = channel.names.iter().map(String::as_str).collect();
            self.texts(&format!("{}_names", channel.name), &[names.len()], &names)?;
        }
        self.texts("task", &[], &[&source.spec.name])?;
        let observations = source.observations();
        self.texts("observation_names", &[observations.len()], &observations)?;
        let actions: Vec<&str> = source.actions.iter().map(String::as_str).collect();
        self.texts("action_names", &[actions.len()], &actions)
    }

    /// Texts of one width: zeros follow the shorter ones.
    fn texts(&mut self, name: &str, shape: &[usize], texts: &[&str]) -> ZipResult<()> {
        // NumPy has no texts of no letters.
        let width = texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
        let padded = texts.iter().flat_map(|text| text.chars().map(u32::from).chain(std::iter::repeat(0)).take(width));
        let letters: Vec<u8> = padded.flat_map(u32::to_le_bytes).collect();
        self.array(name, &format!("<U{width}"), shape, &letters)
    }

    fn frames(&mut self, frames: &Frames) -> ZipResult<()> {
        let (count, side) = (frames.frames.len(), frames.side);
        let pixels = frames.frames.concat();
        if frames.is_depth {
            self.array(&format!("{}_mm", frames.name), "<u2", &[count, side, side], &pixels)
        } else {
            self.array(&format!("{}_rgb", frames.name), "|u1", &[count, side, side, 3], &pixels)
        }
    }

    fn array(&mut self, name: &str, kind: &str, shape: &[usize], bytes: &[u8]) -> ZipResult<()> {
        // The same bytes for the same episode: without a time.
        let options = SimpleFileOptions::default().compression_level(Some(1)).large_file(bytes.len() >= 1 << 31);
        self.0.start_file(format!("{name}.npy"), options)?;
        self.0.write_all(&npy_header(kind, shape))?;
        self.0.write_all(bytes)?;
        Ok(())
    }
}

/// What an NPY file begins with: magic, version, length and description, padded so that the data begins at a multiple of 64
/// bytes. `kind`: `NumPy`'s name of the elements' type.
pub fn npy_header(kind: &str, shape: &[usize]) -> Vec<u8> {
    let lengths: Vec<String> = shape.iter().map(|length| format!("{length}, ")).collect();
    let lengths = lengths.concat();
    let description = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}", lengths.trim_end());
    // Ten bytes stand before the description, a line feed ends it.
    let padded = (10 + description.len() + 1).next_multiple_of(64) - 10;
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend_from_slice(&(padded as u16).to_le_bytes());
    header.extend_from_slice(format!("{description:<width$}\n", width = padded - 1).as_bytes());
    header
}
