//! What fuzzing has kept of glTF files.

#[path = "../../../../fuzz/src/kept.rs"]
mod corpus;
#[path = "../../../../fuzz/src/scene.rs"]
mod scene;

#[test]
fn kept_scenes_are_read_or_refused() {
    corpus::each("scene", scene::take);
}
