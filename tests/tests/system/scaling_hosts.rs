//! Hosts that are lost, or have no room, while a run changes the number of its actors: nobody waits for long, nothing is
//! lost, and the same commands go on.

use super::hosts::{Hosts, as_many_on_one_host};
use super::scaling::{HOLD, ask};
use rustix::process::Signal;
use std::process::Child;
use std::time::{Duration, Instant};
use system_tests::{Printed, Recording, Run, finish, is_held, kill_child, signal, start, wait_until};

const HOST_LOST: i32 = proto::exit::EXIT_HOST_LOST;
/// The first rollout with another number.
const ROLLOUT: u64 = 6;
/// From the last word of a host to the end of the job, seconds.
const DEADLINE_S: u64 = 9;

/// All hosts at work, each learner held in its third update. Host 0 is to be held at `point`.
fn at_work<const N: usize>(hosts: &Hosts, point: &str) -> [Child; N] {
    let children = hosts.start_with(|host| {
        let between = if host == 0 { format!(",hold={point}@orchestrator") } else { String::new() };
        Some(format!("{HOLD}{between}"))
    });
    wait_until_learners_are_held(&hosts.run(), N);
    children
}

fn learners(run: &Run, count: usize) -> Vec<u32> {
    (0..count).flat_map(|rank| run.processes(&format!("--rank {rank} "))).filter(|pid| is_held(*pid)).collect()
}

fn wait_until_learners_are_held(run: &Run, count: usize) {
    wait_until("all learners are held", || learners(run, count).len() == count);
}

/// Asks for so many actors, and lets the learners get there.
fn change(hosts: &Hosts, count: usize, actors: u32) -> Child {
    let asking = ask(&hosts.workshop, &hosts.run(), "shared", (ROLLOUT, actors));
    for pid in learners(&hosts.run(), count) {
        signal(pid, Signal::CONT);
    }
    asking
}

fn assert_lost(printed: &Printed, who: &str) {
    assert_eq!(printed.status, Some(HOST_LOST), "{printed:#?}");
    assert!(printed.stderr.contains(who), "{printed:#?}");
}

/// Every host's `up` from the last checkpoint to the end, as one that was never disturbed and kept its number.
fn goes_on<const N: usize>(hosts: &Hosts) {
    assert_eq!(hosts.run().metrics().len(), ROLLOUT as usize, "saved where the number was to change");
    let [first, others @ ..] = &hosts.complete::<N>()[..] else { panic!("there is a host 0") };
    assert!(others.iter().all(|other| other.success), "{others:#?}");
    assert_eq!(first.result(), as_many_on_one_host(N as u32, hosts.frames));
    let steps = Recording::of(&hosts.run());
    assert!(steps.steps() >= hosts.frames && steps.holes().is_empty(), "{} steps, {:?}", steps.steps(), steps.holes());
    hosts.workshop.assert_replays("shared");
    hosts.assert_nothing_left();
}

/// All is saved, and the host dies before it has said that its recording is complete.
#[test]
fn a_host_that_dies_between_two_starts_is_lost_and_the_run_goes_on() {
    let hosts = Hosts::new(&["shared", "shared"]);
    let [first, second] = at_work(&hosts, "orchestrator.before_recorder_finish");
    let asking = change(&hosts, 2, 3);
    wait_until("host 0 is between two starts", || is_held(first.id()));
    drop(kill_child(second));
    signal(first.id(), Signal::CONT);
    assert_lost(&finish(first), "host 1 (");
    finish(asking).refused("has ended before its number");
    goes_on::<2>(&hosts);
}

/// A host 0 that has nothing to say any more, while another host waits to be invited to the next start.
#[test]
fn a_host_that_waits_for_the_next_start_does_not_wait_for_long() {
    let hosts = Hosts::new(&["shared", "shared", "shared"]);
    // Its second start.
    let [first, second, third] = at_work(&hosts, "orchestrator.after_lock:2");
    let asking = change(&hosts, 3, 3);
    wait_until("host 0 is between two starts", || is_held(first.id()));
    signal(third.id(), Signal::STOP);
    signal(first.id(), Signal::CONT);
    let log = hosts.run().folder.log("orchestrator");
    wait_until("host 1 has come again", || {
        std::fs::read_to_string(&log).is_ok_and(|log| log.matches("host 1 is here").count() == 2)
    });
    signal(first.id(), Signal::STOP);
    let began = Instant::now();
    assert_lost(&finish(second), "host 0 did not begin");
    assert!(began.elapsed() < Duration::from_secs(2 * DEADLINE_S), "{:?}", began.elapsed());
    for child in [first, third] {
        drop(kill_child(child));
    }
    drop(finish(asking));
}

/// Started again, the run must not meet the same refusal for ever.
#[test]
fn a_number_of_actors_for_which_another_host_has_no_room_is_taken_back() {
    let hosts = Hosts::new(&["shared", "shared"]);
    let [first, second] = std::array::from_fn(|host| {
        let mut command = hosts.command(host, "token");
        if host == 1 {
            // Enough for two actors and a learner, not for six.
            command = hosts.workshop.limited("ulimit -n 150", &command);
        }
        command.env("STILLROOM_FAULT", HOLD);
        start(command)
    });
    wait_until_learners_are_held(&hosts.run(), 2);
    let asking = change(&hosts, 2, 12);
    let printed = finish(first);
    assert_lost(&printed, "host 1 cannot take part: more actors than open files allow");
    assert!(printed.stderr.contains("it will go on with 4 actors, not with 12"), "{printed:#?}");
    assert!(!finish(second).success);
    assert!(!finish(asking).success);
    goes_on::<2>(&hosts);
}
