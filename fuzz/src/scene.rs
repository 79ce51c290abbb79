//! Any bytes as the glTF file of a scene whose nodes are all sorts of things: a scene, or a reason why not.

use simulator::scene_file;

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

/// Whether they are a scene.
pub fn take(bytes: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, SCENE).expect("the temporary folder has room");
    std::fs::write(folder.path().join("a.glb"), bytes).expect("the temporary folder has room");
    let found = scene_file::read(&path);
    match &found {
        Ok(scene) => assert!(scene.room.floor.0.is_finite() && scene.room.floor.1.is_finite()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    found.is_ok()
}
