//! `learner.shards`: one run whatever its number of learners, and also if that number changes.

use rustix::process::Signal;
use std::process::Command;
use system_tests::{TINY, Undisturbed, Workshop, complete, finish, kill, signal, start};

/// A power of two and one more: the first shard is larger.
const ACTORS: u32 = 5;
const ENVIRONMENTS: u32 = 3;
/// No multiple of anything: the last rollout of a stage leaves some learners without a step.
const FRAMES: u64 = 2503;
/// All that is summed over learners in doubles: advantages, and the disturbance that moves the multiplier.
const SETTINGS: &str = "
[[stages]]
name = \"I\"
reward = \"r\"
frames = 1000

[[stages]]
name = \"II\"
reward = \"lagrangian\"
frames = 1000
";

fn workshop() -> Workshop {
    let workshop = Workshop::new();
    let text = TINY.replace("[ppo]\n", "[ppo]\nnormalize_advantages = true\nminibatches = 2\n");
    let text = text.replace("[learner]\n", "[learner]\nshards = 4\n");
    std::fs::write(workshop.path("tiny.toml"), text + SETTINGS).expect("a writable temporary folder");
    workshop
}

fn up(workshop: &Workshop, name: &str, learners: usize) -> Command {
    let mut command = workshop.up(name, ACTORS, ENVIRONMENTS, FRAMES);
    command.args(["--learners", &learners.to_string()]);
    command
}

/// Four learners, of which one is killed; then one; then two.
#[test]
fn a_run_goes_on_with_other_numbers_of_learners_as_the_same_run() {
    let workshop = workshop();
    let child = start(up(&workshop, "run", 4));
    let run = workshop.run("run");
    run.wait_for_rollouts(3);
    kill(run.processes("--rank 2 ")[0]);
    run.wait_for_rollouts(6);
    signal(child.id(), Signal::INT);
    let printed = finish(child).good();
    assert!(matches!(printed.deaths()[..], [death] if death.contains("learner-2 died")), "{printed:#?}");

    let child = start(resume(&workshop, 1));
    run.wait_for_rollouts(run.metrics().len() + 3);
    signal(child.id(), Signal::INT);
    let printed = finish(child).good();
    assert!(run.trained() < FRAMES, "the run was stopped in its middle");
    assert!(printed.stderr.contains("1 learner instead of 4 from here on"), "{printed:#?}");
    assert!(!printed.stderr.contains("WARN"), "nothing changes: {printed:#?}");

    let printed = complete(resume(&workshop, 2));
    assert_eq!(printed.result(), Undisturbed::of(&workshop, up(&workshop, "undisturbed", 1)).result, "{printed:#?}");
    assert!(!printed.stderr.contains("WARN"), "nothing changes: {printed:#?}");
    run.assert_nothing_left();
}

fn resume(workshop: &Workshop, learners: usize) -> Command {
    let mut command = workshop.resume("run");
    command.args(["--learners", &learners.to_string()]);
    command
}

#[test]
fn what_shards_cannot_be_is_refused() {
    let workshop = workshop();
    for (learners, set, expected) in [
        (3, "learner.shards=4", "learner.count = 3: must be a power of two up to learner.shards"),
        (1, "learner.shards=8", "learner.shards = 8: must be 0, or a power of two up to actors.count"),
        (2, "ppo.preemption_share=0.6", "ppo.preemption_share = 0.6: must be 0 where learner.shards is not"),
    ] {
        let mut command = up(&workshop, "refused", learners);
        command.args(["--set", set]);
        complete(command).refused(expected);
    }
    let child = start(up(&workshop, "running", 2));
    workshop.run("running").wait_for_rollouts(1);
    workshop.call(&["scale", "running", "--actors", "3"]).refused("learner.shards = 4");
    signal(child.id(), Signal::INT);
    assert!(finish(child).success);
}
