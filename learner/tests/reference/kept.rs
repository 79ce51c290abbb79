//! What fuzzing has kept of checkpoints.

#[path = "../../../fuzz/src/checkpoint.rs"]
mod checkpoint;
#[path = "../../../fuzz/src/kept.rs"]
mod corpus;

#[test]
fn kept_checkpoints_are_loaded_or_rejected() {
    corpus::each("checkpoint", checkpoint::take);
}
