//! Runs that are to be saved because the number of actors changes.

use super::*;

/// Where a run is saved that is asked at this step, and how it ended.
fn saved_at(learners: u32, asked_after: u32, before: Option<u64>, killed: bool) -> (usize, Outcome) {
    end_of(World::with(learners), asked_after, before, killed)
}

fn end_of(mut world: World, asked_after: u32, before: Option<u64>, killed: bool) -> (usize, Outcome) {
    for step in 0..2000 {
        if step == asked_after {
            world.feed(Event::Scale { before });
        }
        if killed && step == asked_after + 1 && world.up.contains_key(&LEARNER) {
            world.exit(LEARNER, Exit::Signal(9));
            world.ready.clear();
            world.connected.clear();
        }
        world.step(true);
        world.obey();
        world.pass(Duration::from_secs(2));
        if world.outcome.is_some() {
            break;
        }
    }
    let outcome = world.outcome.expect("it ended");
    (world.trained, outcome)
}

#[test]
fn the_learners_save_exactly_before_the_rollout_that_is_asked_for() {
    for learners in [1, 3] {
        for asked_after in [0, 1, 2, 7, 12] {
            let (at, outcome) = saved_at(learners, asked_after, Some(9), false);
            assert_eq!((at, outcome.end), (9, SessionEnd::Stopped), "{learners} learners, asked after {asked_after}");
            assert!(outcome.saved.is_some_and(|saved| saved.frames > 0));
        }
    }
}

/// With `ppo.overlap` a learner reports an update only when it has heard what follows.
#[test]
fn learners_that_collect_beside_their_update_are_not_waited_for() {
    let mut world = World::new();
    world.supervisor.deadlines.overlap = true;
    world.feed(Event::Scale { before: Some(4) });
    while world.trained < 3 || !world.collected {
        world.step(true);
    }
    assert_eq!(world.announced.directive, directive::STOP, "before rollout 3 is trained");
    let (at, outcome) = end_of(world, u32::MAX, None, false);
    assert_eq!((at, outcome.end), (4, SessionEnd::Stopped));
}

#[test]
fn without_a_number_it_is_the_next_rollout_that_has_not_begun() {
    let (at, outcome) = saved_at(1, 0, None, false);
    assert_eq!((at, outcome.end), (0, SessionEnd::Stopped), "before the first");
    let (at, outcome) = saved_at(1, 8, None, false);
    let (later, _) = saved_at(1, 12, None, false);
    assert_eq!(outcome.end, SessionEnd::Stopped);
    assert!(at > 0 && later > at, "{at}, {later}");
}

#[test]
fn a_learner_that_dies_first_gets_there_all_the_same_and_a_run_that_is_over_is_complete() {
    let (at, outcome) = saved_at(1, 7, Some(9), true);
    assert_eq!((at, outcome.end), (9, SessionEnd::Stopped));
    let (_, outcome) = saved_at(1, 7, Some(1000), false);
    assert_eq!(outcome.end, SessionEnd::Complete);
}

/// Learners that are to save before rollout 4, and have not yet.
fn saving(learners: u32) -> World {
    let mut world = World::with(learners);
    world.feed(Event::Scale { before: Some(4) });
    while world.announced.directive != directive::STOP {
        world.step(false);
    }
    world
}

/// A death while they save is one like any other: all are started again, and save at the same rollout.
#[test]
fn learners_that_die_or_hang_while_they_save_for_it_save_once_more() {
    for learners in [1, 2] {
        let mut world = saving(learners);
        world.exit(Process::Actor(1), Exit::Signal(9));
        world.exit(Process::Learner(learners - 1), Exit::Signal(9));
        let (at, outcome) = end_of(world, u32::MAX, None, false);
        assert_eq!((at, outcome.end), (4, SessionEnd::Stopped), "{learners} learners");
        assert!(outcome.saved.is_some());
    }
    // Nobody does anything until they are killed for it.
    let mut world = saving(2);
    while world.killed.is_empty() {
        world.pass(Duration::from_secs(10));
    }
    assert!(world.outcome.is_none() && world.reports.iter().any(|text| text.contains("save once more")));
    let (at, outcome) = end_of(world, u32::MAX, None, false);
    assert_eq!((at, outcome.end), (4, SessionEnd::Stopped));
    // Nobody who dies each time is waited for.
    let mut world = saving(1);
    for _ in 0..200 {
        world.step(false);
        if world.announced.directive == directive::STOP && world.outcome.is_none() {
            world.exit(LEARNER, Exit::Signal(9));
        }
        world.pass(Duration::from_millis(500));
        world.obey();
    }
    let end = world.outcome.expect("it ended").end;
    assert!(matches!(&end, SessionEnd::Failed(reason) if reason.contains("while the run got no further")), "{end:?}");
}

/// A save that fails leads back to a run that goes on, which can be asked for another number again.
#[test]
fn after_a_save_that_failed_another_number_can_be_asked_for() {
    let mut world = saving(1);
    assert_eq!(world.supervisor.open_rollout(), None, "it is being saved");
    world.exit(LEARNER, Exit::Signal(9));
    assert_eq!(world.supervisor.open_rollout(), Some(4));
    world.feed(Event::Scale { before: Some(6) });
    let (at, outcome) = end_of(world, u32::MAX, None, false);
    assert_eq!((at, outcome.end), (6, SessionEnd::Stopped));
}

/// Who asks for a stop while the learners save for another number gets that, and no run that goes on.
#[test]
fn a_stop_while_they_save_for_it_is_a_stop() {
    for asked in [Event::Stop, Event::Interrupt] {
        let mut world = saving(1);
        world.feed(asked.clone());
        assert!(world.killed.is_empty(), "the first Ctrl-C saves");
        world.exit(LEARNER, Exit::Signal(9));
        let (_, outcome) = end_of(world, u32::MAX, None, false);
        assert!(matches!(outcome.end, SessionEnd::Failed(_)), "{asked:?}: {:?}", outcome.end);
    }
    let mut world = saving(1);
    world.feed(Event::CannotWrite("a full disk".into()));
    let (_, outcome) = end_of(world, u32::MAX, None, false);
    assert!(matches!(outcome.end, SessionEnd::Failed(_)), "{:?}", outcome.end);
}
