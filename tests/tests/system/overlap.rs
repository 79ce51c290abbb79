//! `ppo.overlap`: updates run while the next rollout is collected. Whoever dies, and whenever, every run ends in the
//! weights of an undisturbed one, with one learner and with two.

use rustix::process::Signal;
use std::process::Command;
use system_tests::{TINY, Workshop, complete, finish, kill, kill_child, signal, start};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 3;
const FRAMES: u64 = 700;

fn workshop() -> Workshop {
    let workshop = Workshop::new();
    let overlapping = TINY.replace("[ppo]\n", "[ppo]\noverlap = true\n");
    assert_ne!(overlapping, TINY);
    std::fs::write(workshop.path("tiny.toml"), overlapping).expect("a writable temporary folder");
    workshop
}

fn up(workshop: &Workshop, name: &str, learners: u32) -> Command {
    let mut command = workshop.up(name, ACTORS, ENVIRONMENTS, FRAMES);
    command.args(["--learners", &learners.to_string()]);
    command
}

fn whoever_dies(learners: u32) {
    let workshop = workshop();
    let undisturbed = complete(up(&workshop, "undisturbed", learners)).result();
    assert_eq!(undisturbed.1, FRAMES);
    let run = workshop.run("undisturbed");
    assert_eq!(run.recorded()["/step"], FRAMES, "every frame is recorded once");
    run.assert_nothing_left();

    // A learner, an actor and the orchestrator.
    let child = start(up(&workshop, "killed", learners));
    let run = workshop.run("killed");
    run.wait_for_rollouts(3);
    kill(run.processes(&format!("--rank {} ", learners - 1))[0]);
    run.wait_for_rollouts(5);
    run.kill_one("--actor ");
    run.wait_for_rollouts(7);
    kill_child(child);
    assert_eq!(complete(workshop.resume("killed")).result(), undisturbed);
    run.assert_nothing_left();

    let child = start(up(&workshop, "stopped", learners));
    let run = workshop.run("stopped");
    run.wait_for_rollouts(4);
    signal(child.id(), Signal::INT);
    let printed = finish(child);
    assert!(printed.success && !printed.stderr.contains("ERROR"), "{printed:#?}");
    assert!(run.trained() < FRAMES, "the run was stopped in its middle");
    assert_eq!(complete(workshop.resume("stopped")).result(), undisturbed);
    run.assert_nothing_left();
}

#[test]
fn one_learner() {
    whoever_dies(1);
}

#[test]
fn two_learners() {
    whoever_dies(2);
}

#[test]
fn a_configuration_with_overlap_and_preemption_is_refused() {
    let workshop = workshop();
    let both = TINY.replace("[ppo]\n", "[ppo]\noverlap = true\npreemption_share = 0.6\n");
    std::fs::write(workshop.path("tiny.toml"), both).expect("a writable temporary folder");
    let printed = complete(up(&workshop, "refused", 2));
    assert!(!printed.success && printed.stderr.contains("ppo.overlap"), "{printed:#?}");
}
