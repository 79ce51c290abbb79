//! Any bytes as the glTF file of a scene whose nodes are all sorts of things.
#![no_main]

use libfuzzer_sys::fuzz_target;
use simulator::scene_file;
use std::path::PathBuf;
use std::sync::LazyLock;

const SCENE: &str = r#"
gltf = "a.glb"
[[node]]
name = "Floor*"
role = "floor"
[[node]]
name = "Table*"
role = "surface"
[[node]]
name = "Mug*"
role = "movable"
mass_kg = 0.3
category = "Mug"
convex = "decompose"
[[node]]
name = "*"
role = "fixed"
convex = "hull"
"#;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap().keep();
    std::fs::write(folder.join("scene.toml"), SCENE).unwrap();
    folder
});

fuzz_target!(|bytes: &[u8]| {
    std::fs::write(FOLDER.join("a.glb"), bytes).unwrap();
    match scene_file::read(&FOLDER.join("scene.toml")) {
        Ok(scene) => assert!(scene.room.floor.0.is_finite() && scene.room.floor.1.is_finite()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
