//! TensorBoard's event files: records of protobuf, each with its length and two checksums.
//!
//! ```text
//! u64  length of the event          little-endian
//! u32  masked CRC-32C of the length
//! ...  the event
//! u32  masked CRC-32C of the event
//! ```
//!
//! A file is only ever appended to, a record in one call. What a kill cuts off is the last record, and every reader
//! stops before a record that is not whole.

use anyhow::{Context, Result};
use prost::Message;
use proto::plain_file::open_plain;
use schema::event::What;
use schema::session_log::SessionStatus;
use schema::summary::Value;
use schema::summary::value::Value as Number;
use schema::{Event, SessionLog, Summary};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{BufReader, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

mod schema {
    #![allow(missing_docs, clippy::pedantic, reason = "generated")]
    include!("../../../schemas/compiled/tensorboard.rs");
}

/// What the names of event files begin with: TensorBoard takes every file whose name holds `tfevents`.
const PREFIX: &str = "events.out.tfevents.";
/// Of files in which a start makes void what comes after its step.
const FILE_VERSION: &str = "brain.Event:2";
const HEAD: usize = 12;
/// An event that is longer is not ours: it has a few dozen figures.
const EVENT_BYTES_MOST: u64 = 1 << 20;
/// Added to a checksum after it was turned: a checksum of checksums would be weak.
const MASK: u32 = 0xa282_ead8;

#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    pub step: u64,
    pub at_unix_s: u64,
    pub values: BTreeMap<String, f32>,
}

/// What a point says, whenever it was: of two that say the same it is the same. A long run has tens of thousands of
/// points with dozens of figures each, and files are compared with all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mark {
    pub step: u64,
    content: u64,
}

impl Point {
    pub fn mark(&self) -> Mark {
        let mut hasher = DefaultHasher::new();
        for (tag, value) in &self.values {
            (tag, value.to_bits()).hash(&mut hasher);
        }
        Mark { step: self.step, content: hasher.finish() }
    }

    fn event(&self) -> Event {
        let value =
            |(tag, &value): (&String, &f32)| Value { tag: tag.clone(), value: Some(Number::SimpleValue(value)) };
        event(self.at_unix_s, self.step, What::Summary(Summary { value: self.values.iter().map(value).collect() }))
    }

    fn of(event: &Event) -> Option<Self> {
        let Some(What::Summary(summary)) = &event.what else { return None };
        let value =
            |value: &Value| value.value.as_ref().map(|Number::SimpleValue(number)| (value.tag.clone(), *number));
        let values = summary.value.iter().filter_map(value).collect();
        Some(Self { step: u64::try_from(event.step).ok()?, at_unix_s: event.wall_time as u64, values })
    }
}

fn event(at_unix_s: u64, step: u64, what: What) -> Event {
    Event { wall_time: at_unix_s as f64, step: step as i64, what: Some(what) }
}

fn masked(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(MASK)
}

fn add_record(bytes: &mut Vec<u8>, event: &Event) {
    let content = event.encode_to_vec();
    let length = (content.len() as u64).to_le_bytes();
    bytes.extend(length);
    bytes.extend(masked(&length).to_le_bytes());
    bytes.extend(&content);
    bytes.extend(masked(&content).to_le_bytes());
}

fn next_event(file: &mut impl Read) -> Option<Event> {
    let mut word = [0; 4];
    let (mut length, mut content) = ([0; HEAD - 4], Vec::new());
    file.read_exact(&mut length).ok()?;
    file.read_exact(&mut word).ok()?;
    let bytes = u64::from_le_bytes(length);
    if masked(&length) != u32::from_le_bytes(word) || bytes > EVENT_BYTES_MOST {
        return None;
    }
    file.take(bytes).read_to_end(&mut content).ok()?;
    file.read_exact(&mut word).ok()?;
    let is_whole = content.len() as u64 == bytes && masked(&content) == u32::from_le_bytes(word);
    is_whole.then(|| Event::decode(content.as_slice()).ok()).flatten()
}

fn files(folder: &Path) -> Vec<(u64, PathBuf)> {
    let paths = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let number = |path: &PathBuf| path.file_name()?.to_str()?.strip_prefix(PREFIX)?.split('.').next()?.parse().ok();
    let mut files: Vec<(u64, PathBuf)> = paths.filter_map(|path| Some((number(&path)?, path))).collect();
    files.sort();
    files
}

pub fn marks_in(folder: &Path) -> Vec<Mark> {
    kept_of(folder, |point| point.mark())
}

/// What is kept of each point in a folder: a start makes void what was there of its step and later ones.
fn kept_of<T>(folder: &Path, kept: impl Fn(Point) -> T) -> Vec<T> {
    let mut points = BTreeMap::new();
    for (_, path) in files(folder) {
        let Ok(mut file) = open_plain(&path, OpenOptions::new().read(true)).map(BufReader::new) else { continue };
        while let Some(event) = next_event(&mut file) {
            if let Some(What::SessionLog(_)) = event.what {
                drop(points.split_off(&(event.step.max(0) as u64)));
            } else if let Some(point) = Point::of(&event) {
                points.insert(point.step, kept(point));
            }
        }
    }
    points.into_values().collect()
}

#[derive(Debug)]
pub struct EventFile {
    file: File,
    path: PathBuf,
}

impl EventFile {
    /// Begins a new file, which is read after all that are in the folder; `void_from`: what was written of this step
    /// and later ones does not count.
    pub fn create(folder: &Path, name: &str, at_unix_s: u64, void_from: Option<u64>) -> Result<Self> {
        let parent = folder.parent().unwrap_or(folder);
        for made in [parent, folder] {
            match std::fs::create_dir(made) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists && made.is_dir() && !made.is_symlink() => {}
                made_now => made_now.with_context(|| format!("cannot create {}", made.display()))?,
            }
        }
        // The clock can have been set back meanwhile.
        let newest = files(folder).last().map_or(0, |(number, _)| number + 1);
        let number = at_unix_s.max(newest);
        let path = folder.join(format!("{PREFIX}{number:010}.{name}"));
        let mut options = OpenOptions::new();
        let file = open_plain(&path, options.append(true).create_new(true))
            .with_context(|| format!("cannot create {}", path.display()))?;
        let mut bytes = Vec::new();
        add_record(&mut bytes, &event(at_unix_s, 0, What::FileVersion(FILE_VERSION.to_owned())));
        if let Some(step) = void_from {
            let start = SessionLog { status: SessionStatus::Start.into() };
            add_record(&mut bytes, &event(at_unix_s, step, What::SessionLog(start)));
        }
        let mut begun = Self { file, path };
        begun.write(&bytes)?;
        Ok(begun)
    }

    pub fn append(&mut self, point: &Point) -> Result<()> {
        let mut bytes = Vec::new();
        add_record(&mut bytes, &point.event());
        self.write(&bytes)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).with_context(|| format!("cannot write {}", self.path.display()))
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    pub fn points_in(folder: &Path) -> Vec<Point> {
        kept_of(folder, |point| point)
    }

    fn append(mut file: EventFile, points: &[Point]) {
        for point in points {
            file.append(point).unwrap();
        }
    }

    fn point(step: u64, value: f32) -> Point {
        Point { step, at_unix_s: 1_763_800_000 + step, values: BTreeMap::from([("charts/a".to_owned(), value)]) }
    }

    fn file(folder: &Path, void_from: Option<u64>) -> EventFile {
        EventFile::create(folder, "lab7.001", 1_763_800_000, void_from).unwrap()
    }

    #[test]
    fn a_file_is_that_of_tensorboards_own_writer_byte_for_byte() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().join("stage-1-I");
        let written = EventFile::create(&folder, "lab7.002", 1_763_800_000, Some(2433)).unwrap();
        let values = [("charts/episodic_return", -0.062_5), ("charts/SPS", 1253.0), ("losses/policy_loss", 1e-8)];
        let values = values.map(|(tag, value)| (tag.to_owned(), value));
        let first = Point { step: 4864, at_unix_s: 1_763_800_060, values: BTreeMap::from(values) };
        append(written, &[first, point(7296, f32::NAN), point(45_000_000, 0.0)]);
        let path = files(&folder).pop().unwrap().1;
        let reference = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/reference/tensorboard");
        assert_eq!(path.file_name(), Some(std::ffi::OsStr::new("events.out.tfevents.1763800000.lab7.002")));
        assert_eq!(std::fs::read(path).unwrap(), std::fs::read(reference.join("written.tfevents")).unwrap());
    }

    #[test]
    fn what_a_kill_cuts_off_costs_the_last_record_alone() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().join("stage");
        append(file(&folder, None), &[point(1, 0.5), point(2, 1.5)]);
        let path = files(&folder).pop().unwrap().1;
        let whole = std::fs::read(&path).unwrap();
        assert_eq!(points_in(&folder), [point(1, 0.5), point(2, 1.5)]);
        let last = whole.len() - {
            let mut record = Vec::new();
            add_record(&mut record, &point(2, 1.5).event());
            record.len()
        };
        for length in last..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert_eq!(points_in(&folder), [point(1, 0.5)], "{length} bytes of {}", whole.len());
        }
        for damaged in last..whole.len() {
            let mut bytes = whole.clone();
            bytes[damaged] ^= 4;
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(points_in(&folder), [point(1, 0.5)], "byte {damaged} is damaged");
        }
    }

    #[test]
    fn a_start_voids_its_step_and_later_ones_and_a_new_file_is_read_last() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().join("stage");
        append(file(&folder, None), &[point(10, 1.0), point(20, 2.0), point(30, 3.0)]);
        // In the same second.
        append(file(&folder, Some(20)), &[point(25, 4.0)]);
        assert_eq!(points_in(&folder), [point(10, 1.0), point(25, 4.0)]);
        let numbers: Vec<u64> = files(&folder).into_iter().map(|(number, _)| number).collect();
        assert_eq!(numbers, [1_763_800_000, 1_763_800_001]);
    }

    #[test]
    fn nothing_is_written_through_a_link() {
        let [temporary, elsewhere] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let folder = temporary.path().join("stage");
        std::os::unix::fs::symlink(elsewhere.path(), &folder).unwrap();
        let error = EventFile::create(&folder, "lab7.001", 1, None).unwrap_err();
        assert!(format!("{error:#}").contains("cannot create"), "{error:#}");
        assert_eq!(std::fs::read_dir(elsewhere.path()).unwrap().count(), 0);
    }
}
