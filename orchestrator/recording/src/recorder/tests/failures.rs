//! Where only failures are recorded.

use super::*;
use crate::episodes::Recorded;

impl Bench {
    /// One that records failures only.
    fn of_failures(test: &str) -> Self {
        let mut bench = Self::new(test);
        bench.config.recording.failures_only = true;
        bench.config.recording.depth_share = 0.0;
        bench
    }
}

#[test]
fn only_failures_are_kept_where_that_is_asked() {
    let bench = Bench::of_failures("failures");
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    // Environment 2 alone is in half 1. Its episodes 0 and 2 succeed, 1 fails, 3 does not end.
    for step in 0..=3 * u64::from(EPISODE_STEPS) + 2 {
        actor.send(1, 1, step, failing(&[1]));
    }
    let summary = recorder.finish().unwrap();
    assert_eq!((summary.steps, summary.episodes), (u64::from(EPISODE_STEPS) + 2, 1));
    let recorded = gather(&summary.files, Wanted::default()).unwrap();
    assert_eq!((kept(&recorded), recorded.headless, recorded.broken), (vec![(1, 5), (3, 2)], 0, 0));
}

fn failing(episodes: &[u32]) -> impl Fn(&mut Record) {
    |record| {
        if episodes.contains(&record.header().acted_episode) {
            record.reals("goal_success")[0] = 0.0;
        }
    }
}

/// Numbers and steps of the episodes.
fn kept(recorded: &Recorded) -> Vec<(u32, usize)> {
    recorded.episodes.iter().map(|episode| (episode.episode, episode.actions.len())).collect()
}

/// A learner that goes back leaves nothing of the episode in progress in the recording of the next failure.
#[test]
fn what_a_learner_abandoned_is_not_kept_with_the_next_failure() {
    let bench = Bench::of_failures("abandoned");
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    // From the middle of episode 2 back to step 2 of episode 1, which fails once more; 2 succeeds this time.
    for step in 0..=12 {
        actor.send(1, 1, step, failing(&[1, 3]));
    }
    for step in 7..=20 {
        actor.send(1, 2, step, failing(&[1, 3]));
    }
    let summary = recorder.finish().unwrap();
    let recorded = gather(&summary.files, Wanted::default()).unwrap();
    assert_eq!((kept(&recorded), &recorded.faults), (vec![(1, 5), (3, 5)], &vec![]));
    assert_eq!((recorded.headless, recorded.broken), (0, 0));

    // Within one episode its beginning stays.
    let bench = Bench::of_failures("within");
    let recorder = bench.start();
    let [actor, _] = bench.actors();
    for step in 0..=4 {
        actor.send(1, 1, step, failing(&[0]));
    }
    for step in 2..=5 {
        actor.send(1, 2, step, failing(&[0]));
    }
    let summary = recorder.finish().unwrap();
    assert_eq!((summary.steps, summary.episodes), (u64::from(EPISODE_STEPS), 1));
    let recorded = gather(&summary.files, Wanted::default()).unwrap();
    assert_eq!((kept(&recorded), recorded.faults), (vec![(0, 5)], vec![]));
}

/// An episode may begin in one start of a run and fail in the next.
#[test]
fn failures_are_whole_that_began_before_the_run_was_resumed() {
    let bench = Bench::of_failures("resumed");
    let mut files = Vec::new();
    // Episode 1 runs when the first start ends; the first actor's fails later, the other's succeeds.
    for (start, steps) in [(1, 0..=7), (2, 7..=15)] {
        let recorder = bench.start_as(start);
        let [first, second] = bench.actors();
        for step in steps {
            first.send(1, 1, step, failing(&[1]));
            second.send(1, 1, step, failing(&[2]));
        }
        files.extend(recorder.finish().unwrap().files);
    }
    let recorded = gather(&files, Wanted::default()).unwrap();
    assert_eq!((kept(&recorded), recorded.faults), (vec![(1, 5), (2, 5)], vec![]));
    assert_eq!((recorded.headless, recorded.broken), (0, 0));
}
