//! Processes that are stopped (SIGSTOP), not dead: they are told of, killed and started again, and a stop ends.

use rustix::process::Signal;
use std::time::{Duration, Instant};
use system_tests::{
    Run, Undisturbed, Workshop, complete, finish, is_held, kill_child_and_adopt, signal, start, wait_until,
};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 3;
const FRAMES: u64 = 1500;

/// A workshop whose learners are taken to hang after three seconds.
fn workshop() -> Workshop {
    let workshop = Workshop::new();
    workshop.configure(("[learner]\n", "[learner]\nprogress_deadline_s = 3.0\n"), "");
    workshop
}

fn undisturbed() -> (String, u64) {
    let workshop = workshop();
    Undisturbed::of(&workshop, workshop.up("undisturbed", ACTORS, ENVIRONMENTS, FRAMES)).result
}

/// A run that is begun, and its learner, which hangs in the middle of a rollout: in a checkpoint it is given minutes.
fn hung(workshop: &Workshop, name: &str) -> (std::process::Child, Run, u32) {
    let mut command = workshop.up(name, ACTORS, ENVIRONMENTS, FRAMES);
    command.env("STILLROOM_FAULT", "hold=learner.mid_rollout:45@learner");
    let child = start(command);
    let run = workshop.run(name);
    let learner = run.wait_until_held("--rank 0 ");
    (child, run, learner)
}

#[test]
fn an_actor_that_hangs_is_told_of_and_started_again() {
    let workshop = workshop();
    let child = start(workshop.up("actor", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("actor");
    run.wait_for_rollouts(5);
    signal(run.processes("--actor 1 ")[0], Signal::STOP);
    let printed = finish(child);
    assert_eq!(printed.result(), undisturbed());
    for part in [
        "actor-01 (kitchen 3) has not answered for",
        "s and is killed",
        "actor-01 (kitchen 3) died: killed by the orchestrator",
    ] {
        assert!(printed.stderr.contains(part), "{part}: {printed:#?}");
    }
    assert_eq!(printed.deaths().len(), 1, "nobody else is killed for it: {printed:#?}");
    run.assert_nothing_left();
}

/// For sixteen seconds the recorder's thread stands still, as at a disk that hangs. Actors that cannot send to it do not
/// answer, and would be killed after five.
#[test]
fn a_recorder_that_stands_still_is_told_of_and_nobody_is_killed_for_it() {
    let workshop = Workshop::new();
    workshop.configure(("[learner]\n", "[learner]\nprogress_deadline_s = 10.0\n"), "");
    let mut command = workshop.up("disk", ACTORS, ENVIRONMENTS, FRAMES);
    command.env("STILLROOM_FAULT", "stall=16=recorder.after_receive:200@orchestrator");
    let printed = complete(command);
    assert_eq!(printed.result(), undisturbed());
    assert_eq!(printed.deaths(), Vec::<&str>::new(), "{printed:#?}");
    // After five seconds, and when that has doubled.
    assert_eq!(
        printed.stderr.matches("learner-0 waits for the recording, which has not got on for").count(),
        2,
        "{printed:#?}"
    );
    workshop.run("disk").assert_nothing_left();
}

#[test]
fn a_stop_of_a_learner_that_hangs_says_what_it_waits_for_and_ends() {
    let workshop = workshop();
    let (child, run, _) = hung(&workshop, "stop");
    let begun = Instant::now();
    let stop = workshop.call(&["stop", "stop"]);
    assert!(!stop.success && begun.elapsed() < Duration::from_mins(1), "{:?} {stop:#?}", begun.elapsed());
    for part in ["stopping: the learner saves", "the stop waits for learner-0", "learner-0 has not saved within"] {
        assert!(stop.stderr.contains(part), "{part}: {stop:#?}");
    }
    assert!(!stop.stderr.contains("::"), "no places in the program: {stop:#?}");
    assert!(!finish(child).success);
    run.assert_nothing_left();
    assert_eq!(complete(workshop.resume("stop")).result(), undisturbed());
}

#[test]
fn a_stopped_orchestrator_is_told_of_and_kills_nobody_when_it_goes_on() {
    let workshop = workshop();
    let child = start(workshop.up("asleep", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("asleep");
    run.wait_for_rollouts(5);
    signal(child.id(), Signal::STOP);
    // Longer than the silence after which `status` speaks of it.
    std::thread::sleep(Duration::from_secs(12));
    let status = workshop.call(&["status", "asleep"]).stdout;
    for part in [&format!("its orchestrator (pid {}) is stopped", child.id()), "no rollout for "] {
        assert!(status.contains(part), "{part}: {status}");
    }
    let stop = workshop.call(&["stop", "asleep"]);
    assert!(!stop.success && stop.stderr.contains("is itself stopped by a signal"), "{stop:#?}");
    signal(child.id(), Signal::CONT);
    let printed = finish(child);
    assert!(printed.success && printed.deaths().is_empty(), "{printed:#?}");
    assert!(printed.stderr.contains("this orchestrator stood still for "), "{printed:#?}");
    assert_eq!(complete(workshop.resume("asleep")).result(), undisturbed());
    run.assert_nothing_left();
}

/// A stopped learner that has outlived its orchestrator is woken, so that it saves.
#[test]
fn a_resume_wakes_a_stopped_learner_of_the_last_start() {
    let workshop = workshop();
    let child = start(workshop.up("late", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("late");
    run.wait_for_rollouts(5);
    let learner = run.learner();
    signal(learner, Signal::STOP);
    wait_until("it is stopped", || is_held(learner));
    kill_child_and_adopt(child);
    let printed = complete(workshop.resume("late"));
    assert_eq!(printed.result(), undisturbed());
    assert!(printed.stderr.contains("is stopped and is woken, so that it saves and leaves"), "{printed:#?}");
    run.assert_nothing_left();
}
