//! What a recording holds changes nothing that is trained on. `kills.rs` has deaths beside it.

use system_tests::{Workshop, complete, recorded_depth};

/// Where the network averages over 2 × 2 pixels, actors write the sums of those alone, but of what is recorded.
#[test]
fn what_is_recorded_of_the_frames_changes_nothing_that_is_trained_on() {
    let workshop = Workshop::new();
    let runs = [("none", 0.0), ("some", 0.4), ("all", 1.0)].map(|(name, share)| {
        let mut command = workshop.up(name, 2, 3, 303);
        let share = format!("recording.depth_share={share:?}");
        command.args(["--set", "network.input_pool=2", "--set", &share]);
        (complete(command).result(), recorded_depth(&workshop.run(name)))
    });
    let [(none, no_frames), (some, some_frames), (all, all_frames)] = runs;
    assert_eq!((&some, &all), (&none, &none));
    let count = |frames: &std::collections::BTreeMap<_, Vec<_>>| frames.values().map(Vec::len).sum::<usize>();
    // Each observation of an episode: one more than its steps.
    assert!(count(&no_frames) == 0 && count(&all_frames) > 303, "{} and {}", count(&no_frames), count(&all_frames));
    assert!((30..200).contains(&count(&some_frames)), "{}", count(&some_frames));
    for (topic, frames) in &some_frames {
        // Beside frames of which the sums alone were written: each is whole, and in its place.
        let mut rest = all_frames[topic].iter();
        assert!(frames.iter().all(|frame| rest.any(|other| other == frame)), "{topic}");
        assert!(frames.iter().all(|frame| frame.len() == 224 * 224 * 2), "{topic}");
    }
}
