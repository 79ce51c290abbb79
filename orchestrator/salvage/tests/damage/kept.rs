//! What fuzzing has kept of recordings.

#[path = "../../../../fuzz/src/kept.rs"]
mod corpus;
#[path = "../../../../fuzz/src/recording.rs"]
mod recording;

#[test]
fn of_kept_recordings_whole_files_are_made() {
    corpus::each("recording", recording::take);
}
