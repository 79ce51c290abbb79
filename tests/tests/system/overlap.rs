//! `ppo.overlap`: updates run while the next rollout is collected. Whoever dies or hangs, and whenever, every run ends in
//! the weights and figures of an undisturbed one. `kills.rs` has deaths of one learner.

use crate::figures::Figures;
use rustix::process::Signal;
use std::process::Command;
use system_tests::{TINY, Workshop, complete, finish, kill, kill_child, signal, start};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 3;
const FRAMES: u64 = 700;

/// A workshop whose runs overlap. `tables`: more of their configuration.
pub fn workshop(tables: &str) -> Workshop {
    let workshop = Workshop::new();
    let overlapping = TINY.replace("[ppo]\n", "[ppo]\noverlap = true\n");
    assert_ne!(overlapping, TINY);
    std::fs::write(workshop.path("tiny.toml"), overlapping + tables).expect("a writable temporary folder");
    workshop
}

fn up(workshop: &Workshop, name: &str, learners: u32) -> Command {
    let mut command = workshop.up(name, ACTORS, ENVIRONMENTS, FRAMES);
    command.args(["--learners", &learners.to_string()]);
    command
}

#[test]
fn whoever_dies_and_whoever_asks_it_to_stop_two_learners_end_in_the_same_weights() {
    let workshop = workshop("\n[validation]\nevery_frames = 300\nepisodes = 1\n");
    let undisturbed = complete(up(&workshop, "undisturbed", 2)).result();
    assert_eq!(undisturbed.1, FRAMES);
    let run = workshop.run("undisturbed");
    let figures = Figures::of(&run);
    assert_eq!(run.recorded()["/step"], FRAMES, "every frame is recorded once");
    run.assert_nothing_left();

    // A learner, an actor and the orchestrator.
    let child = start(up(&workshop, "killed", 2));
    let run = workshop.run("killed");
    run.wait_for_rollouts(3);
    kill(run.processes("--rank 1 ")[0]);
    run.wait_for_rollouts(5);
    run.kill_one("--actor ");
    run.wait_for_rollouts(7);
    kill_child(child);
    assert_eq!(complete(workshop.resume("killed")).result(), undisturbed);
    assert_eq!(Figures::of(&run), figures);
    run.assert_nothing_left();

    let child = start(up(&workshop, "stopped", 2));
    let run = workshop.run("stopped");
    run.wait_for_rollouts(4);
    signal(child.id(), Signal::INT);
    let printed = finish(child);
    assert!(printed.success && !printed.stderr.contains("ERROR"), "{printed:#?}");
    assert!(run.trained() < FRAMES, "the run was stopped in its middle");
    assert_eq!(complete(workshop.resume("stopped")).result(), undisturbed);
    assert_eq!(Figures::of(&run), figures);
    run.assert_nothing_left();
}

#[test]
fn a_learner_that_hangs_is_killed_and_one_that_updates_and_collects_is_not() {
    let workshop = workshop("");
    let text = std::fs::read_to_string(workshop.path("tiny.toml")).expect("the workshop's own file");
    let quick = text.replace("actor_deadline_s = 60.0", "actor_deadline_s = 60.0\nprogress_deadline_s = 3.0");
    // Or it might hang in a checkpoint, as it might at the end of a stage.
    let quick = quick.replace("interval_s = 0.0", "interval_s = 600.0");
    assert!(quick.contains("progress_deadline_s = 3.0") && quick.contains("interval_s = 600.0"), "{quick}");
    std::fs::write(workshop.path("tiny.toml"), quick).expect("a writable temporary folder");
    let undisturbed = complete(up(&workshop, "undisturbed", 1));
    assert_eq!(undisturbed.deaths(), Vec::<&str>::new());

    // In the middle of rollout 4, beside update 3.
    let mut command = up(&workshop, "hung", 1);
    command.env("STILLROOM_FAULT", "hold=learner.mid_rollout:45@learner");
    let child = start(command);
    let run = workshop.run("hung");
    let printed = finish(child);
    assert_eq!(printed.result(), undisturbed.result());
    for part in ["learner-0 has finished no rollout or update for", "learner-0 died: killed by the orchestrator"] {
        assert!(printed.stderr.contains(part), "{part}: {printed:#?}");
    }
    assert_eq!(printed.deaths().len(), 1, "{printed:#?}");
    run.assert_nothing_left();
}

#[test]
fn a_configuration_with_overlap_and_preemption_is_refused() {
    let workshop = workshop("");
    let both = TINY.replace("[ppo]\n", "[ppo]\noverlap = true\npreemption_share = 0.6\n");
    std::fs::write(workshop.path("tiny.toml"), both).expect("a writable temporary folder");
    let printed = complete(up(&workshop, "refused", 2));
    assert!(!printed.success && printed.stderr.contains("ppo.overlap"), "{printed:#?}");
}
