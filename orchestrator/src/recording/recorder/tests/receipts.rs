//! What learners and actors are told of what the recorder has taken.

use super::*;
use std::time::Instant;
use wire::message::observation_kind;
use wire::{Receipt, Receipts, Sleeper, Wire, Written};

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

fn ready(frames: u64) -> LearnerEvent {
    let device = "cpu".to_owned();
    LearnerEvent::Ready { rank: 0, rollout: 0, frames, device, parameters: 1, checkpoint: None }
}

#[test]
fn actors_are_met_samples_receipted_and_whole_rollouts_confirmed() {
    let bench = Bench::new("rcpt");
    let recorder = bench.start();
    let receipts = Receipts::open(&bench.address, 2).unwrap();
    let learner = Wire::join(&bench.address, shape(), "learner-1").unwrap();
    let wakeup = learner.bells().wakeup(Sleeper::Learner(1));
    assert!(wakeup.wait(Duration::ZERO), "the first wait returns at once");
    let [first, second] = bench.actors();
    let of = |half| receipts.of(1, half);
    assert_eq!((receipts.met(1), of(0), receipts.written()), (0, None, None));
    second.send_as(observation_kind::HELLO, 0, 0, 0, |_| {});
    wait_for("it is met", || receipts.met(1) == 1);
    assert_eq!((receipts.met(0), of(0)), (0, None), "a HELLO is no observation");

    let at = |learner_incarnation, step| Some(Receipt { learner_incarnation, step });
    second.send(1, 3, 7, |_| {});
    wait_for("it is taken", || of(1) == at(3, 7));
    // Every actor of this learner, which is this one: it can go on, and is woken.
    assert!(wakeup.wait(Duration::from_secs(20)), "a ring");
    // What comes twice or late takes no receipt back.
    second.send(1, 3, 8, |_| {});
    second.send(1, 3, 7, |_| {});
    second.send(1, 2, 9, |_| {});
    second.send(0, 3, 7, |_| {});
    wait_for("the last is taken", || of(0) == at(3, 7));
    assert_eq!(of(1), at(3, 8));

    // One step of two environments under learner 3; then a rollout of both actors.
    recorder.learner(3, &ready(100));
    recorder.learner(3, &collected(0, 1, 101));
    let written = |rollout| Some(Written { learner_incarnation: 3, rollout });
    wait_for("it is written", || receipts.written() == written(1));
    let file = RunFolder::new(bench.folder.path()).recording(1, 0);
    assert_eq!(messages(&file)["/step"].len(), 1, "what is confirmed is in the file");
    for step in 7..=8 {
        first.send(0, 3, step, |_| {});
    }
    second.send(0, 3, 8, |_| {});
    wait_for("all are taken", || of(0) == at(3, 8) && receipts.of(0, 0) == at(3, 8));
    // Two environments of each actor are in half 0: four steps.
    recorder.learner(3, &collected(1, 4, 105));
    wait_for("it is written", || receipts.written() == written(2));
    assert!(!receipts.failed());
    assert_eq!(recorder.finish().unwrap().frames, Some(105));
}

#[test]
fn a_rollout_with_a_hole_is_an_error_and_never_confirmed() {
    let bench = Bench::new("hole");
    let recorder = bench.start();
    let receipts = Receipts::open(&bench.address, 2).unwrap();
    let [actor, _] = bench.actors();
    recorder.learner(1, &ready(0));
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
