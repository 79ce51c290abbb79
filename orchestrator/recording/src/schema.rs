//! Messages of recordings: those of `schemas/` as Rust types, and their descriptors, both compiled by `make schemas`. What
//! is recorded of steps and episodes follows from the task: [`super::form`].
//!
//! A recording describes itself: with every channel goes the descriptor of its message, so that Foxglove, `mcap cat`
//! or ten lines of Python read it without this program. Names and numbers of the `foxglove` messages are those that
//! Foxglove draws without configuration; our own signals follow protobuf's rules of evolution (numbers are never
//! used twice).

use prost::Message;
use prost_types::{FileDescriptorProto, FileDescriptorSet};
use std::sync::Arc;

pub mod foxglove {
    #![allow(missing_docs, clippy::pedantic, clippy::enum_variant_names, dead_code, reason = "generated")]
    include!("../../schemas/compiled/foxglove.rs");
}

pub mod stillroom {
    #![allow(missing_docs, clippy::pedantic, dead_code, reason = "generated")]
    include!("../../schemas/compiled/stillroom.rs");
}

pub const PROTOBUF: &str = "protobuf";

/// Topic of [`stillroom::StageSwitch`].
pub const STAGES: &str = "/stage";

#[derive(Debug, Clone)]
pub struct Schema {
    pub name: String,
    /// Its file and all files that this one imports, imports first.
    pub descriptor: Arc<[u8]>,
}

impl Schema {
    pub fn of(message: &str) -> Self {
        Self { name: message.to_owned(), descriptor: descriptor_of(message).into() }
    }
}

/// The descriptor of one message, e.g. `foxglove.Log`: its file and all files that this one imports, imports first.
pub fn descriptor_of(message: &str) -> Vec<u8> {
    let all = FileDescriptorSet::decode(include_bytes!("../../schemas/compiled/descriptors.bin").as_slice())
        .expect("a test compiles the schemas and compares");
    let defines = |file: &&FileDescriptorProto| {
        file.message_type.iter().any(|defined| format!("{}.{}", file.package(), defined.name()) == message)
    };
    let root = all.file.iter().find(defines).unwrap_or_else(|| panic!("no schema defines {message}"));
    let mut chosen = FileDescriptorSet::default();
    add_with_imports(&all, root, &mut chosen);
    chosen.encode_to_vec()
}

fn add_with_imports(all: &FileDescriptorSet, file: &FileDescriptorProto, chosen: &mut FileDescriptorSet) {
    if chosen.file.iter().any(|present| present.name() == file.name()) {
        return;
    }
    for import in &file.dependency {
        let imported = all.file.iter().find(|other| other.name() == import).expect("protox includes imports");
        add_with_imports(all, imported, chosen);
    }
    chosen.file.push(file.clone());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_descriptor_holds_its_imports_before_their_users() {
        let set = FileDescriptorSet::decode(descriptor_of("foxglove.FrameTransforms").as_slice()).unwrap();
        for (position, file) in set.file.iter().enumerate() {
            for import in &file.dependency {
                assert!(set.file[..position].iter().any(|earlier| earlier.name() == import), "{import}");
            }
        }
        assert_eq!(set.file.last().unwrap().message_type[0].name(), "FrameTransforms");
    }
}
