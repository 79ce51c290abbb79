//! A process is killed at each named point: the run ends in the weights and figures of one that was left alone, and each
//! step that was trained on is recorded.

use crate::overlap;
use system_tests::{Evidence, Undisturbed, Workshop, complete};

const FRAMES: u64 = 600;

/// What the orchestrator starts again by itself.
const LEARNER: [&str; 12] = [
    "before_checkpoint:1",
    "after_tensors:1",
    "mid_rollout:25",
    "before_update:3",
    "after_update:6",
    "before_checkpoint:5",
    "after_tensors:8",
    "after_sync:4",
    "after_figures:6",
    "after_manifest:6",
    "after_pin:9",
    // Of the last checkpoint: nothing is saved after it.
    "after_pin:12",
];

/// Of a learner that updates and collects at once: in both, and in the checkpoint between.
const OVERLAPPING: [&str; 5] =
    ["mid_rollout:25", "before_update:3", "after_update:5", "after_tensors:8", "after_manifest:6"];

/// After which the run is resumed.
const ORCHESTRATOR: [&str; 9] = [
    "after_lock:1",
    "after_wire:1",
    "before_spawn:1",
    "after_spawn:1",
    "before_announce:7",
    "after_announce:5",
    "stage_switch:2",
    "before_recorder_finish:1",
    "before_summary:1",
];

fn killed_at(workshop: &Workshop, program: &str, points: &[&str]) {
    let up = |name: &str| workshop.up(name, 2, 3, FRAMES);
    let undisturbed = Undisturbed::of(workshop, up("undisturbed"));
    let evidence = Evidence::read(&undisturbed.run).expect("a complete run");
    assert_eq!(evidence.violations(FRAMES), Vec::<String>::new());
    for (number, point) in points.iter().enumerate() {
        let name = format!("run-{number}");
        let mut command = up(&name);
        command.env("STILLROOM_FAULT", format!("{program}.{point}"));
        let mut printed = complete(command);
        let is_reached = if program == "learner" { printed.deaths().len() == 1 } else { printed.killed };
        assert!(is_reached, "the point {point} is never reached: {printed:#?}");
        if printed.killed {
            printed = complete(workshop.resume(&name));
        }
        assert_eq!(printed.result(), undisturbed.result, "killed at {point}");
        let run = workshop.run(&name);
        run.assert_same(&undisturbed, point);
        run.assert_nothing_left();
    }
}

#[test]
fn a_learner_killed_at_any_point_changes_nothing() {
    killed_at(&Workshop::new(), "learner", &LEARNER);
}

#[test]
fn an_orchestrator_killed_at_any_point_changes_nothing() {
    killed_at(&Workshop::new(), "orchestrator", &ORCHESTRATOR);
}

/// The multiplier is part of what must go on, too.
#[test]
fn a_learner_killed_beside_an_update_changes_nothing() {
    let stages = "[[stages]]\nname = \"I\"\nreward = \"r\"\nframes = 300\n\
                  [[stages]]\nname = \"II\"\nreward = \"lagrangian\"\nframes = 300\n";
    killed_at(&overlap::workshop(stages), "learner", &OVERLAPPING);
}
