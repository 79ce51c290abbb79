//! Several learners: one run that is stopped, and one whose straggler is preempted. `hosts.rs`, `overlap.rs` and
//! `recordings.rs` kill them.

use rustix::process::Signal;
use std::process::Command;
use std::time::Duration;
use system_tests::{TINY, Undisturbed, Workshop, complete, finish, signal, start};

const LEARNERS: usize = 3;
const ACTORS: u32 = 4;
const ENVIRONMENTS: u32 = 3;
/// No multiple of anything: the last rollout of a stage leaves some learners without a step.
const FRAMES: u64 = 2503;
/// Of the run whose straggler has to be caught.
const HURRIED_FRAMES: u64 = 5 * FRAMES;

fn up(workshop: &Workshop, name: &str) -> Command {
    let mut command = workshop.up(name, ACTORS, ENVIRONMENTS, FRAMES);
    command.args(["--learners", &LEARNERS.to_string()]);
    command
}

fn undisturbed() -> (String, u64) {
    let workshop = Workshop::new();
    let Undisturbed { result, run } = Undisturbed::of(&workshop, up(&workshop, "undisturbed"));
    assert_eq!((result.1, run.recorded()["/step"]), (FRAMES, FRAMES), "every learner's frames are recorded once");
    result
}

#[test]
fn a_stopped_run_goes_on_also_with_another_number_of_learners() {
    let workshop = Workshop::new();
    let child = start(up(&workshop, "stopped"));
    let run = workshop.run("stopped");
    run.wait_for_rollouts(4);
    signal(child.id(), Signal::INT);
    let printed = finish(child);
    assert!(printed.success && !printed.stderr.contains("ERROR"), "{printed:#?}");
    assert!(run.trained() < FRAMES, "the run was stopped in its middle");
    run.assert_nothing_left();

    // As many again: the same run.
    let child = start(workshop.resume("stopped"));
    run.wait_for_rollouts(run.metrics().len() + 3);
    signal(child.id(), Signal::TERM);
    assert!(finish(child).success);
    assert!(run.trained() < FRAMES, "the run was stopped in its middle again");
    let copy = workshop.path("copy");
    let copied = Command::new("cp").arg("-r").arg(run.folder.root()).arg(&copy).status();
    assert!(copied.is_ok_and(|status| status.success()));
    assert_eq!(complete(workshop.resume("stopped")).result(), undisturbed());

    // One for three: the same environments and beliefs, and sums in another order.
    let config = workshop.run("copy").folder.config();
    let text = std::fs::read_to_string(&config).unwrap();
    assert!(text.contains("[learner]\ncount = 3\n"), "{text}");
    std::fs::write(&config, text.replace("[learner]\ncount = 3\n", "[learner]\ncount = 1\n")).unwrap();
    let printed = complete(workshop.resume("copy"));
    assert_eq!(printed.result().1, FRAMES);
    assert!(printed.stderr.contains("learners 1 instead of 3"), "{printed:#?}");
}

/// DD-PPO's rule at its 60%: two of three have finished, so the third ends its rollout where it is. When that happens
/// is a matter of time, how many frames are trained on is not.
#[test]
fn a_straggler_is_preempted_and_stages_end_on_their_budget() {
    let workshop = Workshop::new();
    std::fs::write(
        workshop.path("tiny.toml"),
        TINY.replace("[ppo]\nrollout_steps = 10\n", "[ppo]\nrollout_steps = 40\npreemption_share = 0.6\n"),
    )
    .unwrap();
    let mut command = workshop.up("hurried", ACTORS, ENVIRONMENTS, HURRIED_FRAMES);
    command.args(["--learners", &LEARNERS.to_string()]);
    let child = start(command);
    let run = workshop.run("hurried");
    run.wait_for_rollouts(1);
    // Actor 3 is the last learner's. It stands still, longer each time, until the others have finished a rollout
    // meanwhile and its learner, which is in the middle of that, notices. (On a busy machine the first learner may be
    // slower by itself: it has two actors.)
    let log = || std::fs::read_to_string(run.folder.log("learner-2")).unwrap();
    let mut still = Duration::from_secs(1);
    while !log().contains("steps: the others wait") {
        let Some(&actor) = run.processes("--actor 3 ").first() else {
            panic!("the run is over, and nobody was hurried: {:#?}\n{:#?}\n{}", finish(child), run.metrics(), log());
        };
        signal(actor, Signal::STOP);
        std::thread::sleep(still);
        signal(actor, Signal::CONT);
        // Time to take the rest of a quarter of the steps, after which the rule holds.
        std::thread::sleep(Duration::from_secs(1));
        still = (still * 2).min(Duration::from_secs(20));
    }
    let printed = finish(child);
    assert_eq!(printed.result().1, HURRIED_FRAMES);
    let metrics = run.metrics();
    let hurried = |line: &serde_json::Value| line["metrics"]["rollout/preempted_learners"].as_f64();
    assert!(metrics.values().all(|line| hurried(line).is_some_and(|count| count < 2.0)), "{metrics:#?}");
    assert!(metrics.values().any(|line| hurried(line) == Some(1.0)), "{metrics:#?}");
    // Both stages end exactly where they should, whatever was cut.
    let ends = metrics.values().filter_map(|line| line["frames"].as_u64()).collect::<Vec<_>>();
    let stage_end = metrics.values().filter(|line| line["stage"] == 0).filter_map(|line| line["frames"].as_u64()).max();
    assert_eq!((stage_end, ends.last()), (Some(HURRIED_FRAMES * 260 / 440), Some(&HURRIED_FRAMES)), "{metrics:#?}");
    assert_eq!(run.recorded()["/step"], HURRIED_FRAMES);
    run.assert_nothing_left();
}
