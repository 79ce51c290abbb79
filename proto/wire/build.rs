//! Hashes the sources of what processes exchange: programs of the same ones understand each other.

use std::path::PathBuf;

fn main() {
    let mut found = vec![PathBuf::from("../src"), PathBuf::from("src")];
    for folder in &found {
        println!("cargo:rerun-if-changed={}", folder.display());
    }
    while let Some(at) = found.iter().position(|path| path.is_dir()) {
        let items = std::fs::read_dir(found.swap_remove(at)).expect("the sources can be listed");
        found.extend(items.map(|item| item.expect("it can be listed").path()));
    }
    found.sort();
    // FNV-1a.
    let bytes = found.iter().flat_map(|path| std::fs::read(path).expect("a source can be read"));
    let hash = bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    println!("cargo:rustc-env=STILLROOM_BUILD={hash:016x}");
}
