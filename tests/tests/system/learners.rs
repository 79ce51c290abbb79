//! A run of several learners whose straggler is preempted. `hosts.rs` and `shards.rs` kill learners and stop them.

use rustix::process::Signal;
use std::time::Duration;
use system_tests::{Workshop, finish, signal, start};

const LEARNERS: usize = 3;
const ACTORS: u32 = 4;
const ENVIRONMENTS: u32 = 3;
/// No multiple of anything, and enough to catch the straggler.
const HURRIED_FRAMES: u64 = 12_515;

/// DD-PPO's rule at its 60%: two of three have finished, so the third ends its rollout where it is. When that happens
/// is a matter of time, how many frames are trained on is not.
#[test]
fn a_straggler_is_preempted_and_stages_end_on_their_budget() {
    let workshop = Workshop::new();
    workshop.configure(("rollout_steps = 10\n", "rollout_steps = 40\npreemption_share = 0.6\n"), "");
    let mut command = workshop.up("hurried", ACTORS, ENVIRONMENTS, HURRIED_FRAMES);
    command.args(["--learners", &LEARNERS.to_string()]);
    let child = start(command);
    let run = workshop.run("hurried");
    run.wait_for_rollouts(1);
    // Actor 3 is the last learner's. It stands still, longer each time, until the others have finished a rollout
    // meanwhile and its learner, which is in the middle of that, notices. (On a busy machine the first learner may be
    // slower by itself: it has two actors.)
    let log = || run.log("learner-2");
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
    assert_eq!((stage_end, ends.last()), (Some(HURRIED_FRAMES * 170 / 420), Some(&HURRIED_FRAMES)), "{metrics:#?}");
    assert_eq!(run.recorded()["/step"], HURRIED_FRAMES);
    run.assert_nothing_left();
}
