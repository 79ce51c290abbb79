//! A host that is gone ends the run with what is on the disk.

use super::*;

#[test]
fn those_who_are_left_are_ended_at_once_and_nothing_is_started_again() {
    let mut world = learner_group();
    world.lose_last_host();
    assert_eq!(world.killed, [0, 1].map(Process::Learner).into(), "they can neither save nor go on");
    assert_eq!(world.told_to_go.len(), 2 + 2, "actors leave by themselves");
    while world.outcome.is_none() {
        world.obey();
        world.pass(Duration::from_secs(1));
    }
    assert!(world.now <= Duration::from_secs(10), "{:?}", world.now);
    let reason = "host 1 (n1) was lost: its cable".to_owned();
    assert_eq!(world.outcome, Some(Outcome { end: SessionEnd::HostLost(reason), saved: None }));
    assert!(world.spawned.values().all(|starts| *starts == 1), "{:?}", world.spawned);
}

#[test]
fn a_host_lost_while_learners_that_lost_it_end_is_the_reason_and_not_they() {
    let mut world = learner_group();
    world.exit(Process::Learner(0), Exit::Code(EXIT_LOST_PEERS));
    assert!(world.outcome.is_none() && world.spawned[&LEARNER] == 1, "who is the reason is given time to say so");
    world.lose_last_host();
    while world.outcome.is_none() {
        world.obey();
        world.pass(Duration::from_secs(1));
    }
    assert!(matches!(&world.outcome, Some(Outcome { end: SessionEnd::HostLost(_), .. })), "{:?}", world.outcome);
    assert_eq!(world.deaths(), Vec::<&str>::new());
}

#[test]
fn a_host_lost_after_all_is_saved_takes_nothing_away() {
    let mut world = learner_group();
    world.feed(Event::Stop);
    while !world.supervisor.learner_group.has_finished(0) {
        world.step(true);
    }
    world.lose_last_host();
    for _ in 0..100 {
        if world.outcome.is_none() {
            world.step(true);
            world.obey();
        }
    }
    let outcome = world.outcome.expect("it ended");
    assert_eq!(outcome.end, SessionEnd::Stopped);
    assert!(outcome.saved.is_some());
}
