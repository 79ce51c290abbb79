//! The orchestrator is killed while it makes the folder, and what depends on it goes on or ends. `kills.rs` has the points
//! of its protocol.

use system_tests::{Undisturbed, Workshop, complete, kill_child, start, wait_until};

const ACTORS: u32 = 1;
const ENVIRONMENTS: u32 = 3;
const FRAMES: u64 = 400;

#[test]
fn a_learner_whose_orchestrator_is_killed_saves_what_it_has_trained() {
    let workshop = Workshop::new();
    // The tests' configuration saves after every rollout.
    workshop.configure(("interval_s = 0.0", "interval_s = 300.0"), "");
    let child = start(workshop.up("killed", ACTORS, ENVIRONMENTS, 10 * FRAMES));
    let run = workshop.run("killed");
    run.wait_for_rollouts(3);
    kill_child(child);
    run.wait_for_end();
    assert!(run.trained() < 10 * FRAMES, "the run was killed in its middle");
    let checkpoints = std::fs::read_dir(run.folder.checkpoints()).expect("checkpoints");
    let newest = checkpoints.map(|entry| entry.expect("an entry").file_name()).max().expect("a checkpoint");
    assert!(*newest.to_string_lossy() > *"rollout-00000002", "the last is {newest:?}");
    complete(workshop.resume("killed")).result();
    run.assert_nothing_left();
}

/// Whoever is killed while it makes the folder leaves one that `resume` or `up` takes.
#[test]
fn killed_while_it_makes_the_folder() {
    let workshop = Workshop::new();
    let undisturbed = Undisturbed::of(&workshop, workshop.up("undisturbed", ACTORS, ENVIRONMENTS, FRAMES)).result;
    let points = [
        ("after_folder:1", false),
        ("after_folder:2", false),
        ("after_folder:4", false),
        ("after_lock", false),
        ("before_config", false),
        ("before_identity", false),
        ("after_identity", true),
    ];
    for (number, (point, is_run)) in points.into_iter().enumerate() {
        let name = format!("run-{number}");
        let mut command = workshop.up(&name, ACTORS, ENVIRONMENTS, FRAMES);
        command.env("STILLROOM_FAULT", format!("create.{point}"));
        assert!(complete(command).killed, "the point {point} is never reached");
        let resumed = complete(workshop.resume(&name));
        let again = complete(workshop.up(&name, ACTORS, ENVIRONMENTS, FRAMES));
        let (run, refused, why) = if is_run {
            (resumed, again, "it holds a run, and `orchestrator resume")
        } else {
            (again, resumed, if point == "after_folder:1" { "has no run.toml" } else { "is not a run yet" })
        };
        assert_eq!(run.result(), undisturbed, "killed at {point}");
        assert!(!refused.success && refused.stderr.contains(why), "killed at {point}: {refused:#?}");
        workshop.run(&name).assert_nothing_left();
    }
}

/// Kitchens take a minute to draw. Nobody waits for that any more.
#[test]
fn whoever_draws_ends_with_who_asked_for_it() {
    let workshop = Workshop::new();
    let child = start(workshop.orchestrator(&["kitchens", "--out", "all.png"]));
    let parent = child.id();
    wait_until("it has an actor", || {
        let children = std::fs::read_to_string(format!("/proc/{parent}/task/{parent}/children"));
        children.is_ok_and(|children| !children.is_empty())
    });
    // The actors have its standard error, too: their end is waited for.
    let printed = kill_child(child);
    assert!(printed.killed && !printed.stderr.contains("ERROR"), "{printed:#?}");
    assert!(!workshop.path("all.png").exists(), "it worked on to the end");
}
