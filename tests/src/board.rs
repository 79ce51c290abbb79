//! What TensorBoard shows of a run's event files, read without any code of the system: checksums bit by bit, fields of
//! protobuf by their numbers.

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

/// A field: its number, and its number or bytes.
enum Field<'a> {
    Varint(u64),
    Fixed32([u8; 4]),
    Fixed64,
    Bytes(&'a [u8]),
}

fn fields(mut bytes: &[u8]) -> Vec<(u64, Field<'_>)> {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let (mut value, mut shift) = (0, 0);
        loop {
            let byte = bytes[0];
            *bytes = &bytes[1..];
            value |= u64::from(byte & 0x7f) << shift;
            shift += 7;
            if byte < 0x80 {
                return value;
            }
        }
    }
    let mut fields = Vec::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let (field, length) = match key & 7 {
            0 => (Field::Varint(varint(&mut bytes)), 0),
            1 => (Field::Fixed64, 8),
            2 => {
                let length = varint(&mut bytes) as usize;
                (Field::Bytes(&bytes[..length]), length)
            }
            5 => (Field::Fixed32(bytes[..4].try_into().expect("four")), 4),
            kind => panic!("there is no kind {kind} of fields"),
        };
        fields.push((key >> 3, field));
        bytes = &bytes[length..];
    }
    fields
}

/// An event: field 2 is its step, 5 a summary, 7 a start.
fn take(curves: &mut Curves, event: &[u8]) {
    let fields_of_event = fields(event);
    let step = fields_of_event.iter().find_map(|(number, field)| match (number, field) {
        (2, Field::Varint(step)) => Some(*step),
        _ => None,
    });
    let step = step.unwrap_or(0);
    for (number, field) in fields_of_event {
        match (number, field) {
            (7, _) => drop(curves.split_off(&step)),
            (5, Field::Bytes(summary)) => {
                let figures = curves.entry(step).or_default();
                for (_, value) in fields(summary) {
                    let Field::Bytes(value) = value else { panic!("a value is a message") };
                    let (mut tag, mut figure) = (String::new(), 0.0);
                    for (number, field) in fields(value) {
                        match (number, field) {
                            (1, Field::Bytes(name)) => tag = String::from_utf8_lossy(name).into_owned(),
                            (2, Field::Fixed32(bytes)) => figure = f32::from_le_bytes(bytes),
                            _ => {}
                        }
                    }
                    assert!(figures.insert(tag, figure).is_none(), "a tag is there once");
                }
            }
            _ => {}
        }
    }
}
