//! Any bytes as the glTF file of a scene whose nodes are all sorts of things: a scene, or a reason why not.

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
    let folder = tempfile::tempdir().expect("a temporary folder can be made").keep();
    std::fs::write(folder.join("scene.toml"), SCENE).expect("it can be written to");
    folder
});

pub fn take(bytes: &[u8]) {
    std::fs::write(FOLDER.join("a.glb"), bytes).expect("the temporary folder has room");
    match scene_file::read(&FOLDER.join("scene.toml")) {
        Ok(scene) => assert!(scene.room.floor.0.is_finite() && scene.room.floor.1.is_finite()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
