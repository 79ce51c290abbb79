//! An archive of `NumPy` an episode. Arrays of what was seen have one row more than there were actions.

use crate::column::Values;
use crate::episode::{Episode, Frames};
use crate::error::DatasetError;
use crate::error::disk;
use crate::fields::FIELDS;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use zip::result::ZipResult;
use zip::write::{SimpleFileOptions, ZipWriter};

/// Archives that are written.
pub struct Archives {
    folder: PathBuf,
    count: u64,
}

impl Archives {
    /// In this folder.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_path_buf(), count: 0 }
    }

    /// Adds an episode.
    pub fn add(&mut self, episode: &Episode) -> Result<(), DatasetError> {
        let path = self.folder.join(format!("episode-{:06}.npz", self.count));
        let file = File::create_new(&path).map_err(|source| disk(&path, source))?;
        let mut archive = Archive(ZipWriter::new(BufWriter::new(file)));
        let written = archive.episode(episode).and_then(|()| archive.0.finish());
        let mut file = written.map_err(|source| DatasetError::Archive { path: path.clone(), source })?;
        file.flush().map_err(|source| disk(&path, source))?;
        self.count += 1;
        Ok(())
    }
}

struct Archive(ZipWriter<BufWriter<File>>);

impl Archive {
    fn episode(&mut self, episode: &Episode) -> ZipResult<()> {
        for frames in &episode.cameras {
            self.frames(frames)?;
        }
        let goals: Vec<u8> = episode.seen.iter().flat_map(|seen| seen.goal_m).flat_map(f32::to_le_bytes).collect();
        self.array("goal_m", "<f4", &[episode.seen.len(), 3], &goals)?;
        let hashes: Vec<u8> = episode.seen.iter().flat_map(|seen| seen.state_hash.to_le_bytes()).collect();
        self.array("state_hash", "<u8", &[episode.seen.len()], &hashes)?;
        let previous: Vec<u8> =
            episode.seen.iter().flat_map(|seen| i64::from(seen.previous_action).to_le_bytes()).collect();
        self.array("previous_action", "<i8", &[episode.seen.len()], &previous)?;
        // Hashes and previous actions are those of what was seen, and have a row more.
        let of_steps = |name: &str| !["state_hash", "previous_action"].contains(&name);
        for field in FIELDS.iter().filter(|field| of_steps(field.name)) {
            let (kind, bytes) = bytes_of(&field.values(episode));
            self.array(field.name, kind, &[episode.steps.len()], &bytes)?;
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
        self.array("seed", "<u8", &[], &about.seed.to_le_bytes())?;
        for (name, text) in [("target", about.target), ("outcome", about.outcome)] {
            let letters: Vec<u8> = text.chars().flat_map(|letter| (letter as u32).to_le_bytes()).collect();
            self.array(name, &format!("<U{}", text.chars().count()), &[], &letters)?;
        }
        Ok(())
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

    /// An array: magic, version, length and description, padded so that the data begins at a multiple of 64 bytes.
    fn array(&mut self, name: &str, kind: &str, shape: &[usize], bytes: &[u8]) -> ZipResult<()> {
        // The same bytes for the same episode: without a time.
        let options = SimpleFileOptions::default().compression_level(Some(1)).large_file(bytes.len() >= 1 << 31);
        self.0.start_file(format!("{name}.npy"), options)?;
        let lengths: Vec<String> = shape.iter().map(|length| format!("{length}, ")).collect();
        let description =
            format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}", lengths.concat().trim_end());
        let padded = (10 + description.len() + 1).next_multiple_of(64) - 10;
        self.0.write_all(b"\x93NUMPY\x01\x00")?;
        self.0.write_all(&(padded as u16).to_le_bytes())?;
        self.0.write_all(format!("{description:<width$}\n", width = padded - 1).as_bytes())?;
        self.0.write_all(bytes)?;
        Ok(())
    }
}

/// `NumPy`'s name of a type, and values in it.
fn bytes_of(values: &Values) -> (&'static str, Vec<u8>) {
    match values {
        Values::Bool(values) => ("|b1", values.iter().map(|value| u8::from(*value)).collect()),
        Values::Int(values) => ("<i8", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        Values::Hash(values) => ("<u8", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        Values::Real(values) => ("<f4", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        Values::Double(values) => ("<f8", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        Values::Bytes(_) | Values::Text(_) => unreachable!("no field of a step is text"),
    }
}
