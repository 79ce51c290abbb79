//! Compiles `orchestrator/schemas/` into its folder `compiled/`: Rust types, and the descriptors that every recording
//! carries so that it can be read without this program. They are files of the checkout, so that no build needs this
//! program: `make schemas` calls it. With `--check` it writes nothing, and fails where they differ.

use anyhow::{Context, Result, ensure};
use prost::Message;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

const PACKAGES: [&str; 4] = ["foxglove", "onnx", "stillroom", "tensorboard"];

fn compiled(schemas: &Path) -> Result<BTreeMap<String, Vec<u8>>> {
    let mut sources = Vec::new();
    for package in PACKAGES {
        sources.extend(files_in(&schemas.join(package))?.into_keys().map(|name| schemas.join(package).join(name)));
    }
    let descriptors = protox::compile(sources, [schemas])?;
    let mut files = BTreeMap::from([("descriptors.bin".to_owned(), descriptors.encode_to_vec())]);
    let out = tempfile::tempdir()?;
    prost_build::Config::new().btree_map(["."]).out_dir(out.path()).compile_fds(descriptors)?;
    files.extend(files_in(out.path())?);
    Ok(files)
}

/// By name: the order of folders differs between machines, the descriptors must not.
fn files_in(folder: &Path) -> Result<BTreeMap<String, Vec<u8>>> {
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let entry = entry?;
        files.insert(entry.file_name().to_string_lossy().into_owned(), fs::read(entry.path())?);
    }
    Ok(files)
}

fn main() -> Result<()> {
    let schemas = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize()?;
    let (files, folder) = (compiled(&schemas)?, schemas.join("compiled"));
    if std::env::args().nth(1).as_deref() == Some("--check") {
        ensure!(
            files_in(&folder)? == files,
            "{} is not what {} compiles to: make schemas",
            folder.display(),
            schemas.display()
        );
        return Ok(());
    }
    fs::remove_dir_all(&folder)?;
    fs::create_dir(&folder)?;
    for (name, contents) in files {
        fs::write(folder.join(name), contents)?;
    }
    Ok(())
}
