//! Compiles `schemas/` twice: into Rust types, and into the descriptors that every recording carries so that it can
//! be read without this program. Both in pure Rust; no protoc is needed.

use prost_build::Config;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=schemas");
    let mut files = Vec::new();
    for package in ["foxglove", "stillroom", "tensorboard"] {
        for entry in std::fs::read_dir(Path::new("schemas").join(package))? {
            files.push(entry?.path());
        }
    }
    // Directory order differs between machines; the descriptors must not.
    files.sort();
    let descriptors = protox::compile(files, ["schemas"])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.bin"), prost::Message::encode_to_vec(&descriptors))?;
    Config::new().btree_map(["."]).compile_fds(descriptors)?;
    Ok(())
}
