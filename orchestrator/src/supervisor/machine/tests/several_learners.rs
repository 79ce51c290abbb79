//! Learners that run, save and die together.

use super::*;

#[test]
fn whoever_of_the_learners_dies_takes_the_others_along_and_all_go_on_together() {
    for rank in 0..3 {
        let mut world = learner_group();
        world.exit(Process::Learner(rank), Exit::Signal(9));
        let others: Vec<Process> = (0..3).filter(|&other| other != rank).map(Process::Learner).collect();
        assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), others);
        assert_eq!(
            world.deaths(),
            [format!(
                "learner-{rank} died: signal 9 (SIGKILL: killed, perhaps by the kernel for want of memory); start number 2 \
                 follows; all 3 learners go on from the last checkpoint"
            )]
        );
        // One ends by itself before the kill reaches it, the last takes its time.
        world.exit(others[0], Exit::Code(1));
        world.pass(Duration::from_secs(5));
        assert_eq!(world.spawned[&LEARNER], 1, "one is still there");
        world.exit(others[1], Exit::Signal(9));
        assert!(
            world
                .ranks()
                .all(|rank| world.spawned[&Process::Learner(rank)] == 2
                    && !world.killed.contains(&Process::Learner(rank)))
        );
        assert_eq!(world.deaths().len(), 1, "what follows is no death of its own");
        train(&mut world);
        let outcome = world.outcome.as_ref().expect("it ended");
        assert_eq!(outcome.end, SessionEnd::Complete);
        assert!(
            world
                .spawned
                .iter()
                .all(|(process, &starts)| starts == 1 + u32::from(matches!(process, Process::Learner(_))))
        );
    }
}

#[test]
fn a_fall_is_one_death_in_the_count() {
    let mut world = learner_group();
    let falls = deadlines(3).restart.in_window as u32;
    for fall in 0..=falls {
        assert_eq!(world.outcome, None);
        assert!(!world.supervisor.is_stopping(), "fall {fall}");
        for rank in [fall % 3, (fall + 1) % 3, (fall + 2) % 3] {
            world.exit(Process::Learner(rank), Exit::Signal(11));
        }
        if fall < falls {
            world.pass(Duration::from_secs(4));
            assert_eq!(world.spawned[&LEARNER], fall + 2);
        }
    }
    for _ in 0..ACTORS {
        world.obey();
    }
    let reason = world.failed();
    let expected = "the learners died 6 times while the run got no further, last learner-2 with signal 11 (SIGSEGV)";
    assert!(reason.starts_with(expected), "{reason}");
}

#[test]
fn non_finite_numbers_of_all_learners_are_one_fall() {
    let mut world = learner_group();
    for (fall, exits) in [[EXIT_NON_FINITE; 3], [1, EXIT_NON_FINITE, EXIT_NON_FINITE]].iter().enumerate() {
        assert!(!world.supervisor.is_stopping(), "fall {fall}");
        for (rank, &code) in exits.iter().enumerate() {
            world.exit(Process::Learner(rank as u32), Exit::Code(code));
        }
    }
    assert_eq!(world.spawned[&LEARNER], 2);
    assert!(world.reports.last().is_some_and(|text| text.contains("learner-1 met non-finite numbers twice")));
    assert!(world.supervisor.is_stopping());
}

#[test]
fn who_lost_another_is_not_the_reason_and_the_reason_is_waited_for() {
    // At their first start, too: that is no refusal.
    for mut world in [learner_group(), World::with(3)] {
        world.exit(Process::Learner(2), Exit::Code(EXIT_LOST_PEERS));
        world.exit(Process::Learner(1), Exit::Code(EXIT_LOST_PEERS));
        assert!(world.deaths().is_empty() && world.killed.is_empty(), "the reason can still say what it has to");
        world.exit(Process::Learner(0), Exit::Signal(9));
        assert_eq!(world.deaths().len(), 1);
        assert!(world.deaths()[0].starts_with("learner-0 died: signal 9"), "{:?}", world.deaths());
        world.pass(Duration::from_secs(5));
        assert!(world.ranks().all(|rank| world.spawned[&Process::Learner(rank)] == 2));
    }
}

#[test]
fn where_nobody_is_the_reason_who_lost_another_falls_with_all() {
    // One hangs: it is ended with the rest. All lost one another: there is nobody to wait for.
    for everyone in [false, true] {
        let mut world = learner_group();
        world.exit(Process::Learner(1), Exit::Code(EXIT_LOST_PEERS));
        world.exit(Process::Learner(2), Exit::Code(EXIT_LOST_PEERS));
        if everyone {
            world.exit(Process::Learner(0), Exit::Code(EXIT_LOST_PEERS));
        } else {
            world.pass(deadlines(3).killed);
            assert!(world.killed.contains(&LEARNER));
            world.exit(LEARNER, Exit::Signal(9));
        }
        assert_eq!(world.deaths().len(), 1);
        assert!(world.deaths()[0].starts_with("learner-1 died: exit status 4"), "{:?}", world.deaths());
        world.pass(Duration::from_secs(5));
        assert!(world.ranks().all(|rank| world.spawned[&Process::Learner(rank)] == 2));
    }
}

#[test]
fn a_learner_that_refuses_to_begin_ends_the_run_for_all() {
    let mut world = World::with(3);
    world.learner_step(0, true);
    world.exit(Process::Learner(2), Exit::Code(1));
    assert_eq!(world.killed.len(), 2, "the others cannot save without it");
    train(&mut world);
    let reason = world.failed();
    assert!(reason.starts_with("learner-2 could not begin: exit status 1"), "{reason}");
    assert!(world.spawned.values().all(|&starts| starts == 1), "nobody is asked again: {:?}", world.spawned);
}

#[test]
fn learners_may_leave_in_any_order() {
    // At the budget, and at a stop.
    for stopped in [false, true] {
        for order in [[0, 1, 2], [2, 1, 0], [1, 0, 2]] {
            let mut world = learner_group();
            if stopped {
                world.feed(Event::Stop);
            }
            while world.agreed.is_none() {
                world.step(true);
            }
            for rank in order {
                world.finishes(rank, !stopped);
                world.exit(Process::Learner(rank), Exit::Code(0));
                let left = world.ranks().filter(|&rank| world.up.contains_key(&Process::Learner(rank)));
                assert!(left.into_iter().all(|rank| !world.killed.contains(&Process::Learner(rank))));
            }
            for _ in 0..ACTORS {
                world.obey();
            }
            let end = if stopped { SessionEnd::Stopped } else { SessionEnd::Complete };
            let outcome = world.outcome.as_ref().expect("it ended");
            assert_eq!((&outcome.end, outcome.saved.is_some()), (&end, true), "{order:?}");
            assert!(world.deaths().is_empty() && world.spawned.values().all(|&starts| starts == 1));
        }
    }
}

#[test]
fn a_learner_that_dies_while_they_save_is_named() {
    for rank in 0..3 {
        let mut world = learner_group();
        world.feed(Event::Stop);
        world.exit(Process::Learner(rank), Exit::Signal(11));
        // What the others do then is their own affair.
        world.exit(Process::Learner((rank + 1) % 3), Exit::Code(1));
        assert_eq!(world.killed.len(), 1);
        for _ in 0..=ACTORS {
            world.obey();
        }
        let reason = world.failed();
        assert!(reason.starts_with(&format!("learner-{rank} died while it saved (signal 11 (SIGSEGV))")), "{reason}");
        assert_eq!(world.deaths().len(), 1);
        assert!(world.spawned.values().all(|&starts| starts == 1));
    }
}

#[test]
fn silent_learners_are_killed_together() {
    let mut world = learner_group();
    for _ in 0..3000 {
        if world.killed.is_empty() {
            world.pass(Duration::from_secs(1));
        }
    }
    assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), [0, 1, 2].map(Process::Learner));
    for _ in 0..3 {
        world.obey();
    }
    assert_eq!(
        world.deaths(),
        [
            "learner-0 died: killed by the orchestrator; start number 2 follows; all 3 learners go on from the last checkpoint"
        ]
    );
    let killed = world.reports.iter().find(|text| text.contains("killed") && !text.contains("after"));
    assert!(killed.is_some_and(|text| text.starts_with("the 3 learners have finished no ")), "{:#?}", world.reports);
    assert!(world.ranks().all(|rank| world.spawned[&Process::Learner(rank)] == 2));
}

#[test]
fn a_learner_that_is_never_ready_or_connected_is_named() {
    let mut world = World::with(2);
    for _ in 0..400 {
        if world.outcome.is_none() {
            world.learner_step(0, true);
            world.pass(Duration::from_secs(1));
            world.obey();
        }
    }
    let Some(Outcome { end: SessionEnd::Failed(reason), .. }) = world.outcome else { panic!("{:?}", world.outcome) };
    assert!(reason.starts_with("learner-1 was not ready after 120 s"), "{reason}");
    let all = |text: &String| text.ends_with("All 2 learners are killed: they start together");
    assert_eq!(world.reports.iter().filter(|text| all(text)).count(), 1, "{:#?}", world.reports);

    let mut world = World::with(2);
    for rank in [1, 0, 0] {
        world.learner_step(rank, true);
    }
    while !world.supervisor.is_stopping() {
        world.pass(Duration::from_secs(1));
    }
    assert!(world.reports.last().is_some_and(|text| text.starts_with("not all of its actors had answered learner-1 ")));
    train(&mut world);
    assert!(world.outcome.is_some_and(|outcome| outcome.saved.is_some()), "all are there, so they save");
}
