//! Runs and evaluations with one learner.

use super::*;

#[test]
fn an_undisturbed_run_trains_both_stages_and_ends_complete() {
    for learners in 1..=3 {
        let mut world = World::with(learners);
        train(&mut world);
        assert_eq!(
            world.outcome,
            Some(Outcome { end: SessionEnd::Complete, saved: Some(Saved { frames: 833, weights: "0".repeat(64) }) })
        );
        let switches: Vec<_> = world.switches.iter().map(|switch| (switch.from, switch.to, switch.frames)).collect();
        assert_eq!(switches, [(None, 0, 0), (Some(0), 1, 500)]);
        assert!(world.spawned.values().all(|&starts| starts == 1));
        let said = |text: &str| world.reports.iter().filter(|report| report.contains(text)).count();
        assert_eq!(
            (said("all 3 actors connected"), said(" ready on cpu"), world.deaths().len()),
            (1, learners as usize, 0)
        );
    }
}

#[test]
fn a_second_interrupt_kills_everything_at_once() {
    let mut world = World::new();
    world.step(false);
    world.feed(Event::Interrupt);
    assert!(world.killed.is_empty());
    world.feed(Event::Interrupt);
    assert_eq!(world.killed.len(), 1 + ACTORS as usize);
    for _ in 0..=ACTORS {
        world.obey();
    }
    assert_eq!(world.outcome, Some(Outcome { end: SessionEnd::Interrupted, saved: None }));
}

#[test]
fn a_crash_loop_ends_the_run_in_order_and_names_the_culprit() {
    let slow = "\nIf an answer may take longer than 60 s, raise learner.actor_deadline_s in the run's config.toml, then \
                resume the run";
    for (exit, how, advice) in [
        (Exit::Signal(11), "last with signal 11 (SIGSEGV)", ""),
        (Exit::Killed, "last killed by the orchestrator", slow),
    ] {
        let mut world = World::after(4, 1);
        for _ in 0..20 {
            world.exit(Process::Actor(2), exit.clone());
            world.pass(Duration::from_secs(5));
        }
        assert_eq!(world.announced.directive, directive::STOP, "the learner is asked to save first");
        train(&mut world);
        let outcome = world.outcome.expect("it ended");
        assert!(outcome.saved.is_some(), "what was trained is kept");
        let SessionEnd::Failed(reason) = outcome.end else { panic!("{:?}", outcome.end) };
        let expected = format!(
            "actor-02 (kitchen 4) died 6 times while the run got no further, {how}; its last messages:\n    oh{advice}"
        );
        assert_eq!(reason, expected);
    }
}

#[test]
fn the_second_error_of_an_environment_at_the_same_step_ends_the_run() {
    let error = |step: u32| format!("2026-11-21T02:04:23.1Z ERROR actor 2: environment 4, episode 1, step {step}: oh");
    let mut world = World::after(4, 1);
    for (exit, step) in [(1, 7), (1, 8), (1, 7)].map(|(exit, step)| (Exit::Code(exit), step)).into_iter().chain([
        // Which is no error's.
        (Exit::Signal(9), 7),
        (Exit::Signal(9), 7),
    ]) {
        world.exit_with(Process::Actor(2), exit, &error(step));
        world.pass(Duration::from_secs(30));
        assert!(!world.supervisor.is_stopping());
    }
    assert!(world.deaths()[0].contains("exit status 1, environment 4, episode 1, step 7: oh; start number 2 follows"));
    world.exit_with(Process::Actor(1), Exit::Code(1), &error(9));
    world.exit_with(Process::Actor(2), Exit::Code(1), &error(9));
    assert!(!world.supervisor.is_stopping(), "two actors, each for the first time");
    world.pass(Duration::from_secs(30));
    world.exit_with(Process::Actor(2), Exit::Code(1), &error(9));
    train(&mut world);
    let outcome = world.outcome.expect("it ended");
    assert!(outcome.saved.is_some(), "what was trained is kept");
    let SessionEnd::Failed(reason) = outcome.end else { panic!("{:?}", outcome.end) };
    let expected = "actor-02 (kitchen 4) died twice of the same error: environment 4, episode 1, step 9: oh; mend the \
                    environment, then resume the run";
    assert_eq!(reason, expected);
}

#[test]
fn a_learner_that_cannot_save_is_not_started_again() {
    for learners in [1, 3] {
        let mut world = World::after(4, learners);
        for rank in 1..learners {
            world.exit(Process::Learner(rank), Exit::Code(EXIT_LOST_PEERS));
        }
        world.exit(LEARNER, Exit::Code(EXIT_UNSAVED));
        train(&mut world);
        let reason = world.failed();
        assert!(reason.starts_with("learner-0 could not save"), "{reason}");
        assert!(world.spawned.values().all(|&starts| starts == 1), "{:?}", world.spawned);
    }
}

#[test]
fn non_finite_numbers_are_forgiven_once_between_progress() {
    let mut world = World::after(4, 1);
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 2);
    for _ in 0..4 {
        world.step(true);
    }
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 3, "a rollout further the count begins anew");
    world.step(true);
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 3);
    assert!(world.supervisor.is_stopping());
}

#[test]
fn a_hanging_actor_is_killed_and_started_again() {
    let mut world = World::new();
    world.step(false);
    world.pass(Duration::from_secs(100));
    let waiting = |waited_s| LearnerEvent::WaitingForActor { rank: 0, actor: 1, waited_s };
    world.learner(waiting(10.0));
    assert!(world.killed.is_empty() && !world.reports.iter().any(|text| text.contains("answered")));
    world.learner(waiting(22.0));
    let warning = "actor-01 (kitchen 3) has not answered for 22 s; it is killed after 60 s";
    assert_eq!((world.killed.len(), world.reports.last().map(String::as_str)), (0, Some(warning)));
    world.learner(waiting(61.0));
    assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), [Process::Actor(1)]);
    world.learner(waiting(62.0));
    world.obey();
    assert_eq!(world.spawned[&Process::Actor(1)], 2);
    world.learner(waiting(63.0));
    assert!(world.killed.is_empty(), "the new one is given its time");
}

/// Its disk hangs: whoever were killed for it, the next would wait, too.
#[test]
fn a_recorder_that_stands_still_is_told_of_and_nobody_is_killed() {
    let mut world = World::new();
    world.step(false);
    world.step(false);
    let warnings = |world: &World| world.reports.iter().filter(|text| text.contains("waits for the recording")).count();
    for second in 3..590 {
        world.pass(Duration::from_secs(1));
        world.learner(LearnerEvent::WaitingForRecorder { rank: 0, waited_s: f64::from(second) });
    }
    assert!(world.killed.is_empty() && !world.supervisor.is_stopping(), "{:#?}", world.reports);
    // After 5, 10, 20, ..., 320 seconds.
    assert_eq!(warnings(&world), 7, "{:#?}", world.reports);
    for waited_s in [1.8, 3.0, 6.0, 7.9, 1.8, 6.0] {
        world.learner(LearnerEvent::WaitingForRecorder { rank: 0, waited_s });
    }
    assert_eq!(warnings(&world), 9, "each further standstill is told of anew");
}

/// Seconds that pass, a tick each, until someone is killed or the run stops.
fn seconds_until_a_kill(world: &mut World) -> u64 {
    let begin = world.now;
    while world.killed.is_empty() && !world.supervisor.is_stopping() {
        world.pass(Duration::from_secs(1));
        assert!(world.now < begin + Duration::from_hours(1), "nobody is killed");
    }
    world.now.checked_sub(begin).unwrap().as_secs()
}

#[test]
fn a_silent_learner_is_killed_and_a_dead_ones_words_are_ignored() {
    let mut world = World::new();
    world.step(false);
    world.step(false);
    // Nobody knows yet how long a rollout takes.
    assert_eq!(seconds_until_a_kill(&mut world), deadlines(1).silence.as_secs() + 1);
    assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), [LEARNER]);
    world.obey();
    assert_eq!(world.spawned[&LEARNER], 2);
    let version = world.announced.version;
    world.feed(Event::Learner {
        incarnation: 1,
        event: LearnerEvent::RolloutCollected { rank: 0, rollout: 0, frames: 48, here: 48 },
    });
    assert_eq!(world.announced.version, version);
}

#[test]
fn the_end_of_a_process_that_is_not_there_changes_nothing() {
    let mut supervisor = Supervisor::new(deadlines(1), Vec::new());
    supervisor.start(Duration::ZERO);
    for (process, incarnation) in [(Process::Actor(ACTORS + 7), 1), (Process::Actor(0), 2)] {
        let exit = Exit::Signal(9);
        let ended = Event::Exited { process, incarnation, exit, last_words: vec![] };
        assert_eq!(supervisor.on_event(Duration::ZERO, ended), [], "{process:?}");
    }
}

/// A learner whose rollouts and updates take two seconds each hangs: in a rollout, and in an update.
#[test]
fn a_hang_is_told_of_early_and_ended_by_what_was_measured() {
    for steps in [14, 15] {
        let mut world = World::quick(steps);
        world.reports.clear();
        let work = if world.collected { "update" } else { "rollout" };
        assert_eq!(world.collected, steps == 15);
        assert_eq!(seconds_until_a_kill(&mut world), 61);
        assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), [LEARNER]);
        let warned = |silent_s| {
            format!(
                "learner-0 has shown no progress for {silent_s} s: no {work} is finished (the longest of the last took \
                 2.0 s); learner-0 is killed after 60 s"
            )
        };
        let killed =
            format!("learner-0 has finished no {work} for 61 s (the longest of the last took 2.0 s) and is killed");
        assert_eq!(world.reports, [warned(11), warned(23), warned(47), killed]);
        world.obey();
        train(&mut world);
        assert_eq!(world.outcome.map(|outcome| outcome.end), Some(SessionEnd::Complete));
    }
}

#[test]
fn a_learner_that_waits_for_an_actor_does_not_hang() {
    let mut world = World::quick(14);
    // It waits longer than a rollout may take, for one that is started again and again.
    for second in 1..=100 {
        world.pass(Duration::from_secs(1));
        if second % 10 == 0 {
            world.learner(LearnerEvent::WaitingForActor { rank: 0, actor: 1, waited_s: f64::from(second) });
            world.obey();
        }
    }
    assert_eq!((world.spawned[&LEARNER], world.spawned[&Process::Actor(1)]), (1, 3), "{:#?}", world.reports);
    assert_eq!(seconds_until_a_kill(&mut world), 61, "what says nothing more hangs");
    assert!(world.killed.contains(&LEARNER));
}

/// A stop waits for what was measured, and says what for.
#[test]
fn a_stop_of_a_hanging_learner_ends_in_bounded_time() {
    let mut world = World::quick(15);
    world.feed(Event::Stop);
    world.reports.clear();
    let begin = world.now;
    while world.killed.is_empty() {
        world.pass(Duration::from_secs(1));
    }
    // An update of at most a minute, and a checkpoint whose time is not known.
    assert_eq!(world.now.checked_sub(begin).unwrap().as_secs(), 60 + 180);
    let first = "the stop waits for learner-0: learner-0 has not saved after 11 s and is given 229 s more";
    assert_eq!(world.reports[0], first);
    let told = |text: &String| text.contains("the stop waits for");
    assert_eq!(world.reports.iter().filter(|text| told(text)).count(), 5, "{:#?}", world.reports);
    for _ in 0..=ACTORS {
        world.obey();
    }
    let reason = world.failed();
    assert_eq!(reason, "learner-0 has not saved within 240 s");
}

/// A checkpoint waits for the disk of the recordings, and whoever were killed for it, the next would wait, too.
#[test]
fn a_disk_that_hangs_in_a_checkpoint_is_waited_for_as_long_as_one_that_hangs_the_recorder() {
    let mut world = World::quick(14);
    world.learner(LearnerEvent::CheckpointBegun { rank: 0 });
    // One that fails is followed by a rollout without a word.
    assert_eq!(seconds_until_a_kill(&mut world), 600 + 60 + 1);
    let warned = |text: &String| text.contains("no checkpoint is finished");
    assert!(world.reports.iter().any(warned), "{:#?}", world.reports);

    let mut world = World::quick(14);
    world.feed(Event::Stop);
    world.pass(Duration::from_secs(50));
    world.learner(LearnerEvent::CheckpointBegun { rank: 0 });
    world.pass(Duration::from_secs(599));
    assert!(world.killed.is_empty(), "{:#?}", world.reports);
    world.pass(Duration::from_secs(1));
    assert_eq!(world.killed.len(), 1, "{:#?}", world.reports);
}

/// What an evaluation's learner says of an episode that ended.
fn played(episode: u32) -> LearnerEvent {
    let record = crate::evaluation::testing::played(KitchenId::new(2).unwrap(), episode, &[]);
    LearnerEvent::EpisodePlayed { record, actions: vec![20] }
}

#[test]
fn an_evaluation_is_complete_without_a_frame_and_playing_again_is_no_progress() {
    let ready = || crate::evaluation::testing::ready(0, 7, 700);
    let mut supervisor = Supervisor::new(deadlines(1), Vec::new());
    let mut now = Duration::ZERO;
    supervisor.start(now);
    let mut incarnation = 1;
    // Each learner plays one episode and dies: the same one, so it is given up.
    let failed = loop {
        let speaks = |event| Event::Learner { incarnation, event };
        let actions = supervisor.on_event(now, speaks(ready()));
        assert!(!actions.iter().any(|action| matches!(action, Action::Announce(_))), "there is nothing to train on");
        supervisor.on_event(now, speaks(played(0)));
        let exit = Exit::Signal(11);
        let actions =
            supervisor.on_event(now, Event::Exited { process: LEARNER, incarnation, exit, last_words: vec![] });
        if actions.iter().any(|action| matches!(action, Action::Report(Level::Error, _))) {
            break actions;
        }
        now += Duration::from_secs(10);
        let actions = supervisor.on_event(now, Event::Tick);
        incarnation += 1;
        let spawned = Action::Spawn { process: LEARNER, incarnation };
        assert!(actions.contains(&spawned) || !supervisor.learner_group.is_ready(0), "{actions:?}");
        assert!(incarnation < 100, "a learner that gets no further is given up");
    };
    assert!(failed.iter().any(|action| matches!(action, Action::CloseLifeline(_))));

    let mut supervisor = Supervisor::new(deadlines(1), Vec::new());
    supervisor.start(now);
    let finished = LearnerEvent::Finished { rank: 0, frames: 0, weights: "w".into(), complete: true };
    for event in [ready(), played(0), played(1), finished] {
        supervisor.on_event(now, Event::Learner { incarnation: 1, event });
    }
    let mut last = vec![];
    for process in std::iter::once(LEARNER).chain((0..ACTORS).map(Process::Actor)) {
        let exit = Exit::Code(0);
        last = supervisor.on_event(now, Event::Exited { process, incarnation: 1, exit, last_words: vec![] });
    }
    let saved = Some(Saved { frames: 0, weights: "w".into() });
    assert_eq!(last, [Action::Finish(Outcome { end: SessionEnd::Complete, saved })]);
}
