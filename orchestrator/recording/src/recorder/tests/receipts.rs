//! What learners and actors are told of what the recorder has taken.

use super::*;
use std::time::Instant;
use wire::Receipts;

/// Waits until it is so: the recorder is a thread of its own.
fn wait_for(what: &str, so: impl Fn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !so() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn collected(rollout: u64, here: u64, frames: u64) -> LearnerEvent {
    LearnerEvent::RolloutCollected { rank: 0, rollout, frames, here }
}

#[test]
fn a_rollout_with_a_hole_is_an_error_and_never_confirmed() {
    let bench = Bench::new("hole");
    let recorder = bench.start();
    let receipts = Receipts::open(&bench.address, 2).unwrap();
    let [actor, _] = bench.actors();
    let device = "cpu".to_owned();
    let ready = LearnerEvent::Ready { rank: 0, rollout: 0, frames: 0, device, parameters: 1, checkpoint: None };
    recorder.learner(1, &ready);
    // Exchange 1 never comes: two of four steps.
    actor.send(0, 1, 0, |_| {});
    actor.send(0, 1, 2, |_| {});
    wait_for("it is taken", || receipts.of(0, 0).is_some_and(|receipt| receipt.step == 2));
    recorder.learner(1, &collected(0, 4, 4));
    wait_for("it is told", || receipts.failed());
    assert_eq!(receipts.written(), None);
    let failure = recorder.failure().unwrap();
    assert!(failure.contains("2 of the 4 steps of rollout 0 were recorded"), "{failure}");
    // Actors are served all the same, until the run has ended.
    actor.send(0, 1, 3, |_| {});
    wait_for("it is taken", || receipts.of(0, 0).is_some_and(|receipt| receipt.step == 3));
    assert!(recorder.finish().unwrap_err().to_string().contains("rollout 0"));
}
