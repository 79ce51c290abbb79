//! What TensorBoard shows of a run's event files, read without any code of the system: checksums bit by bit.

use prost::Message;
use proto::run_folder::RunFolder;
use std::collections::BTreeMap;
use std::path::Path;

/// Figures by tag, of each step.
pub type Curves = BTreeMap<u64, BTreeMap<String, f32>>;

/// The curves of a run's folder for TensorBoard: of all its stages, or of its validations.
pub fn curves(folder: &RunFolder, of_stages: bool) -> Curves {
    let mut curves = Curves::new();
    for entry in std::fs::read_dir(folder.tensorboard()).into_iter().flatten().flatten() {
        let is_stage = entry.file_name().to_string_lossy().starts_with("stage-");
        if is_stage == of_stages {
            for (step, figures) in curves_in(&entry.path()) {
                assert!(curves.insert(step, figures).is_none(), "step {step} is in two stages");
            }
        }
    }
    curves
}

fn curves_in(folder: &Path) -> Curves {
    let mut paths: Vec<_> = std::fs::read_dir(folder).expect("a folder").flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let mut curves = Curves::new();
    for path in paths {
        let bytes = std::fs::read(&path).expect("a readable file");
        for event in records(&bytes) {
            take(&mut curves, &event);
        }
    }
    curves
}

/// Whole records up to the first one that a kill cut off or a power failure damaged, as TensorBoard reads them.
fn records(mut bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut records = Vec::new();
    while bytes.len() >= 12 {
        let length = u64::from_le_bytes(bytes[..8].try_into().expect("eight")) as usize;
        if masked(&bytes[..8]).to_le_bytes() != bytes[8..12] {
            break;
        }
        let Some(rest) = bytes.get(12 + length..16 + length) else { break };
        let content = &bytes[12..12 + length];
        if masked(content).to_le_bytes() != rest {
            break;
        }
        records.push(content.to_vec());
        bytes = &bytes[16 + length..];
    }
    records
}

/// CRC-32C, bit by bit, as TensorFlow masks it.
fn masked(bytes: &[u8]) -> u32 {
    let mut crc = !0u32;
    for &byte in bytes {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0x82f6_3b78 } else { crc >> 1 };
        }
    }
    let crc = !crc;
    crc.rotate_right(15).wrapping_add(0xa282_ead8)
}

/// What is needed of `tensorflow.Event`.
#[derive(Clone, PartialEq, Message)]
struct Event {
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
    /// A start.
    #[prost(message, optional, tag = "7")]
    session: Option<Session>,
}

#[derive(Clone, PartialEq, Message)]
struct Session {}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    values: Vec<Figure>,
}

#[derive(Clone, PartialEq, Message)]
struct Figure {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, tag = "2")]
    value: f32,
}

fn take(curves: &mut Curves, event: &[u8]) {
    let event = Event::decode(event).expect("an event");
    let step = event.step.unsigned_abs();
    if event.session.is_some() {
        curves.split_off(&step);
    }
    for Figure { tag, value } in event.summary.into_iter().flat_map(|summary| summary.values) {
        assert!(curves.entry(step).or_default().insert(tag, value).is_none(), "a tag is there once");
    }
}
