//! What fuzzing has kept of checkpoints.

#[path = "../../../fuzz/src/checkpoint.rs"]
mod checkpoint;
#[path = "../../../fuzz/src/kept.rs"]
mod corpus;

#[test]
fn kept_checkpoints_are_loaded_or_rejected() {
    assert!(corpus::each("checkpoint", checkpoint::take) > 0);
}
