//! `schemas/compiled/` is what `schemas/` compiles to: Rust types, and the descriptors that every recording carries so
//! that it can be read without this program. Both in pure Rust; no protoc is needed.
//!
//! They are files of the checkout, so that only this test needs the compiler of schemas, and no build does.
//! `make schemas` writes them.

use prost::Message;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const PACKAGES: [&str; 4] = ["foxglove", "onnx", "stillroom", "tensorboard"];

fn compiled(schemas: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut sources = Vec::new();
    for package in PACKAGES {
        for entry in std::fs::read_dir(schemas.join(package)).expect("the schemas are there") {
            sources.push(entry.expect("a file").path());
        }
    }
    // Directory order differs between machines; the descriptors must not.
    sources.sort();
    let descriptors = protox::compile(sources, [schemas]).expect("schemas that compile");
    let mut files = BTreeMap::from([("descriptors.bin".to_owned(), descriptors.encode_to_vec())]);
    let out = tempfile::tempdir().expect("a folder");
    prost_build::Config::new().btree_map(["."]).out_dir(out.path()).compile_fds(descriptors).expect("Rust types");
    files.extend(files_in(out.path()));
    files
}

fn files_in(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("a file"));
    entries
        .map(|entry| {
            (entry.file_name().into_string().expect("a name"), std::fs::read(entry.path()).expect("its contents"))
        })
        .collect()
}

#[test]
fn compiled_schemas_are_those_of_the_sources() {
    let schemas = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("schemas");
    let folder = schemas.join("compiled");
    let files = compiled(&schemas);
    if std::env::var_os("STILLROOM_WRITE_SCHEMAS").is_some() {
        std::fs::remove_dir_all(&folder).expect("it goes");
        std::fs::create_dir(&folder).expect("a new one");
        for (name, contents) in &files {
            std::fs::write(folder.join(name), contents).expect("room for it");
        }
    }
    let kept = files_in(&folder);
    let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&kept), names(&files), "in schemas/compiled/: `make schemas` mends it");
    for (name, contents) in &files {
        assert!(kept[name] == *contents, "schemas/compiled/{name} is not what schemas/ compiles to: `make schemas`");
    }
}
