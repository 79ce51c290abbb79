//! The same seed ends in the same weights, whatever happens on the way.
//!
//! Every test here compares with one undisturbed run of the same configuration.

use rustix::process::Signal;
use std::sync::OnceLock;
use system_tests::{Run, Workshop, complete, finish, kill, signal, start};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 3;
const FRAMES: u64 = 1500;

/// The undisturbed run's result, made once per test process.
fn undisturbed() -> &'static (String, u64) {
    static RESULT: OnceLock<(String, u64)> = OnceLock::new();
    RESULT.get_or_init(|| {
        let workshop = Workshop::new();
        let result = complete(workshop.up("undisturbed", ACTORS, ENVIRONMENTS, FRAMES)).result();
        assert_eq!(result.1, FRAMES);
        result
    })
}

#[test]
fn two_runs_are_the_same_run() {
    let workshop = Workshop::new();
    let other = complete(workshop.up("other", ACTORS, ENVIRONMENTS, FRAMES)).result();
    assert_eq!(&other, undisturbed());
}

#[test]
fn another_seed_is_another_run() {
    let workshop = Workshop::new();
    let weights = |name, seed| complete(workshop.up_seeded(name, 1, 2, 300, seed)).result().0;
    assert_ne!(weights("five", 5), weights("six", 6));
}

#[test]
fn a_killed_actor_comes_back_and_changes_nothing() {
    let workshop = Workshop::new();
    let child = start(workshop.up("actor", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("actor");
    for rollouts in [1, 4, 9] {
        run.wait_for_rollouts(rollouts);
        if let Some(actor) = run.processes("--actor ").first() {
            kill(*actor);
        }
    }
    assert_eq!(&finish(child).result(), undisturbed());
    run.assert_nothing_left();
}

#[test]
fn a_killed_learner_goes_on_from_its_checkpoint() {
    let workshop = Workshop::new();
    let child = start(workshop.up("learner", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("learner");
    run.wait_for_rollouts(5);
    kill(run.learner());
    assert_eq!(&finish(child).result(), undisturbed());
    run.assert_nothing_left();
}

#[test]
fn a_killed_orchestrator_is_resumed() {
    let workshop = Workshop::new();
    let child = start(workshop.up("orchestrator", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("orchestrator");
    run.wait_for_rollouts(5);
    kill(child.id());
    assert!(!finish(child).success);
    assert_eq!(&complete(workshop.resume("orchestrator")).result(), undisturbed());
    run.assert_nothing_left();
}

#[test]
fn a_stopped_run_is_resumed() {
    let workshop = Workshop::new();
    let child = start(workshop.up("stopped", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("stopped");
    run.wait_for_rollouts(5);
    signal(child.id(), Signal::INT);
    let printed = finish(child);
    assert!(printed.success, "{printed:#?}");
    assert!(printed.stderr.contains("orchestrator resume stopped"), "{printed:#?}");
    run.assert_nothing_left();
    assert!(trained(&run) < FRAMES, "the run was stopped in its middle");

    let child = start(workshop.resume("stopped"));
    run.wait_for_rollouts(12);
    let stop = complete(workshop.orchestrator(&["stop", "stopped"]));
    assert!(stop.success, "{stop:#?}");
    finish(child);
    assert_eq!(&complete(workshop.resume("stopped")).result(), undisturbed());
    run.assert_nothing_left();
}

#[test]
fn everything_killed_at_once_is_resumed() {
    let workshop = Workshop::new();
    let child = start(workshop.up("all", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("all");
    run.wait_for_rollouts(6);
    let mut everyone = run.processes("--rank");
    everyone.extend(run.processes("--actor "));
    everyone.push(child.id());
    everyone.into_iter().for_each(kill);
    assert!(!finish(child).success);
    assert_eq!(&complete(workshop.resume("all")).result(), undisturbed());
    run.assert_nothing_left();
}

fn trained(run: &Run) -> u64 {
    run.metrics().values().filter_map(|line| line["frames"].as_u64()).max().unwrap_or(0)
}
