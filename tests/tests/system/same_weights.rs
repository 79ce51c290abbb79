//! The same seed ends in the same weights, whatever happens on the way. `kills.rs` has deaths at named points.

use rustix::process::Signal;
use system_tests::{Undisturbed, Workshop, complete, finish, kill, kill_child, signal, start};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 3;
const FRAMES: u64 = 1500;

fn undisturbed(workshop: &Workshop) -> (String, u64) {
    Undisturbed::of(workshop, workshop.up("undisturbed", ACTORS, ENVIRONMENTS, FRAMES)).result
}

#[test]
fn whoever_is_killed_and_whoever_asks_it_to_stop_it_is_the_same_run() {
    let workshop = Workshop::new();
    let run = workshop.run("run");
    let is_amid = |before: u64| assert!((before + 1..FRAMES).contains(&run.trained()), "it ended in its middle");

    // An actor, then the learner; then Ctrl-C.
    let child = start(workshop.up("run", ACTORS, ENVIRONMENTS, FRAMES));
    run.wait_for_rollouts(1);
    run.kill_one("--actor ");
    run.wait_for_rollouts(4);
    kill(run.learner());
    run.wait_for_rollouts(7);
    signal(child.id(), Signal::INT);
    let printed = finish(child);
    assert!(printed.success && printed.stderr.contains("orchestrator resume run"), "{printed:#?}");
    assert!(
        matches!(printed.deaths()[..], [actor, learner] if actor.contains("actor-") && learner.contains("learner-"))
    );
    run.assert_nothing_left();
    is_amid(0);

    // `orchestrator stop`.
    let before = run.trained();
    let child = start(workshop.resume("run"));
    run.wait_for_rollouts(run.metrics().len() + 3);
    workshop.call(&["stop", "run"]).good();
    assert!(finish(child).success);
    is_amid(before);

    // All processes at once.
    let before = run.trained();
    let child = start(workshop.resume("run"));
    run.wait_for_rollouts(run.metrics().len() + 3);
    let mut everyone = run.processes("--rank");
    everyone.extend(run.processes("--actor "));
    assert_eq!(everyone.len(), 1 + ACTORS as usize, "the learner and all actors run");
    everyone.into_iter().for_each(kill);
    kill_child(child);
    is_amid(before);

    assert_eq!(complete(workshop.resume("run")).result(), undisturbed(&workshop));
    run.assert_nothing_left();
}
