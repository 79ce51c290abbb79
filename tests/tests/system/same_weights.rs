//! The same seed ends in the same weights, whatever happens on the way.
//!
//! Every test here compares with one undisturbed run of the same configuration.

use rustix::process::Signal;
use std::sync::OnceLock;
use system_tests::{Workshop, complete, finish, kill, kill_child, signal, start};

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
        run.kill_one("--actor ");
    }
    let printed = finish(child);
    assert_eq!(&printed.result(), undisturbed());
    assert_eq!(printed.deaths().len(), 3, "every kill is told: {printed:#?}");
    assert!(printed.deaths().iter().all(|line| line.contains("actor-")), "{printed:#?}");
    run.assert_nothing_left();
}

#[test]
fn a_killed_learner_goes_on_from_its_checkpoint() {
    let workshop = Workshop::new();
    let child = start(workshop.up("learner", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("learner");
    run.wait_for_rollouts(5);
    kill(run.learner());
    let printed = finish(child);
    assert_eq!(&printed.result(), undisturbed());
    assert_eq!(printed.deaths().len(), 1, "the kill is told: {printed:#?}");
    assert!(printed.deaths()[0].contains("learner"), "{printed:#?}");
    run.assert_nothing_left();
}

#[test]
fn a_killed_orchestrator_is_resumed() {
    let workshop = Workshop::new();
    let child = start(workshop.up("orchestrator", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("orchestrator");
    run.wait_for_rollouts(5);
    kill_child(child);
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
    let first = run.trained();
    assert!(first < FRAMES, "the run was stopped in its middle");

    let child = start(workshop.resume("stopped"));
    run.wait_for_rollouts(run.metrics().len() + 3);
    let stop = complete(workshop.orchestrator(&["stop", "stopped"]));
    assert!(stop.success, "{stop:#?}");
    assert!(finish(child).success);
    assert!((first + 1..FRAMES).contains(&run.trained()), "the run went on, and was stopped in its middle again");
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
    assert_eq!(everyone.len(), 1 + ACTORS as usize, "the learner and all actors run");
    everyone.into_iter().for_each(kill);
    kill_child(child);
    assert_eq!(&complete(workshop.resume("all")).result(), undisturbed());
    run.assert_nothing_left();
}
