//! Whoever is killed, whenever: the recordings hold each step that was trained on.

use rustix::process::Signal;
use std::time::Duration;
use system_tests::{RecordedSteps, Run, Workshop, complete, finish, kill_child, recorded_depth, signal, start};

/// Asserts that each of `frames` steps is recorded, and that replay finds the same states.
fn assert_all_recorded(workshop: &Workshop, run: &Run, frames: u64) -> RecordedSteps {
    let recorded = RecordedSteps::of(run);
    assert_eq!((recorded.count(), recorded.holes()), (frames, vec![]), "{run:?}");
    let name = run.folder.root().file_name().and_then(|name| name.to_str()).expect("a run has a name");
    let replay = complete(workshop.orchestrator(&["replay", "--check", name]));
    assert!(replay.success, "{replay:#?}");
    recorded
}

/// A killed actor's successor sends before the recorder knows it, while the recorder is held: what does not fit into
/// its queue then was dropped, and the learner's actions were taken for its receipt, too.
#[test]
fn an_actor_killed_while_the_recorder_is_held_leaves_no_hole() {
    const FRAMES: u64 = 2400;
    let workshop = Workshop::new();
    let child = start(workshop.up("held", 2, 3, FRAMES));
    let run = workshop.run("held");
    for kill in 0..6 {
        run.wait_for_rollouts(1 + 5 * kill);
        let before = run.processes("--actor ");
        run.kill_one("--actor ");
        while !run.processes("--actor ").iter().any(|pid| !before.contains(pid)) {
            std::thread::sleep(Duration::from_millis(1));
        }
        signal(child.id(), Signal::STOP);
        std::thread::sleep(Duration::from_millis(1000 + 100 * kill as u64));
        signal(child.id(), Signal::CONT);
    }
    let printed = finish(child);
    assert_eq!(printed.result().1, FRAMES);
    assert_eq!(printed.deaths().len(), 6, "every kill is told: {printed:#?}");
    let recorded = assert_all_recorded(&workshop, &run, FRAMES);
    assert_eq!(recorded.messages, FRAMES, "and none twice, as the learner never went back");
    run.assert_nothing_left();
}

/// Kills the orchestrator after every few rollouts, and resumes; the last start comes to the end. With it die an actor
/// or a learner now and then.
#[test]
fn an_orchestrator_of_two_learners_killed_again_and_again_takes_no_step_along() {
    const FRAMES: u64 = 3000;
    const KILLS: usize = 4;
    let workshop = Workshop::new();
    let command = |name| {
        let mut command = workshop.up(name, 2, 3, FRAMES);
        command.args(["--set", "learner.count=2"]);
        command
    };
    let undisturbed = complete(command("undisturbed")).result();
    let run = workshop.run("killed");
    let mut child = start(command("killed"));
    for kill in 0..KILLS {
        run.wait_for_rollouts(run.metrics().len() + 2);
        // At another moment of a rollout each time.
        std::thread::sleep(Duration::from_millis(13 * kill as u64));
        match kill % 4 {
            1 => run.kill_one("--actor "),
            3 => run.kill_one("--rank"),
            _ => {}
        }
        kill_child(child);
        run.wait_for_end();
        child = start(workshop.resume("killed"));
    }
    assert_eq!(finish(child).result(), undisturbed);
    assert_eq!(run.recordings().len(), KILLS + 1, "every start recorded");
    assert_all_recorded(&workshop, &run, FRAMES);
    run.assert_nothing_left();
}

/// Where the network averages over 2 × 2 pixels, actors write the sums of those alone, but of what is recorded.
#[test]
fn what_is_recorded_of_the_frames_changes_nothing_that_is_trained_on() {
    let workshop = Workshop::new();
    let runs = [("none", 0.0), ("some", 0.4), ("all", 1.0)].map(|(name, share)| {
        let mut command = workshop.up(name, 2, 3, 600);
        let share = format!("recording.depth_share={share:?}");
        command.args(["--set", "network.input_pool=2", "--set", &share]);
        (complete(command).result(), recorded_depth(&workshop.run(name)))
    });
    let [(none, no_frames), (some, some_frames), (all, all_frames)] = runs;
    assert_eq!((&some, &all), (&none, &none));
    let count = |frames: &std::collections::BTreeMap<_, Vec<_>>| frames.values().map(Vec::len).sum::<usize>();
    // Each observation of an episode: one more than its steps.
    assert!(count(&no_frames) == 0 && count(&all_frames) > 600, "{} and {}", count(&no_frames), count(&all_frames));
    assert!((60..400).contains(&count(&some_frames)), "{}", count(&some_frames));
    for (topic, frames) in &some_frames {
        // Beside frames of which the sums alone were written: each is whole, and in its place.
        let mut rest = all_frames[topic].iter();
        assert!(frames.iter().all(|frame| rest.any(|other| other == frame)), "{topic}");
        assert!(frames.iter().all(|frame| frame.len() == 224 * 224 * 2), "{topic}");
    }
}
