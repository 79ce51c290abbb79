//! An archive of `NumPy` an episode. Arrays of what was seen have one row more than there were actions.

use crate::episode::{Episode, Frames};
use crate::error::{DatasetError, disk};
use crate::fields::{FIELDS, Value};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use zip::result::ZipResult;
use zip::write::{SimpleFileOptions, ZipWriter};

/// Writes an episode. `actions`: names of the actions, in the order of their numbers.
pub fn write_episode(path: &Path, episode: &Episode, actions: &[&str]) -> Result<(), DatasetError> {
    let file = File::create_new(path).map_err(|source| disk(path, source))?;
    let mut archive = Archive(ZipWriter::new(BufWriter::new(file)));
    let written = archive.episode(episode, actions).and_then(|()| archive.0.finish());
    let mut file = written.map_err(|source| DatasetError::Archive { path: path.to_path_buf(), source })?;
    file.flush().map_err(|source| disk(path, source))
}

struct Archive(ZipWriter<BufWriter<File>>);

impl Archive {
    fn episode(&mut self, episode: &Episode, actions: &[&str]) -> ZipResult<()> {
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
        for field in &FIELDS {
            let (mut kind, mut bytes) = ("<i8", Vec::new());
            for step in &episode.steps {
                kind = append((field.of)(step), &mut bytes);
            }
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
        self.texts("target", &[], &[about.target])?;
        self.texts("outcome", &[], &[about.outcome])?;
        self.texts("action_names", &[actions.len()], actions)
    }

    /// Texts of one width: zeros follow the shorter ones.
    fn texts(&mut self, name: &str, shape: &[usize], texts: &[&str]) -> ZipResult<()> {
        let width = texts.iter().map(|text| text.chars().count()).max().unwrap_or(0);
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

/// Appends a value; `NumPy`'s name of its type.
fn append(value: Value, bytes: &mut Vec<u8>) -> &'static str {
    match value {
        Value::Bool(value) => bytes.push(u8::from(value)),
        Value::Int(value) => bytes.extend(value.to_le_bytes()),
        Value::Real(value) => bytes.extend(value.to_le_bytes()),
    }
    match value {
        Value::Bool(_) => "|b1",
        Value::Int(_) => "<i8",
        Value::Real(_) => "<f4",
    }
}
