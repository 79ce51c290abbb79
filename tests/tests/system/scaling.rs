//! A run whose number of actors changes while it goes on, or that goes on with another number of hosts: environments keep
//! what they are, the budget is exact, and the same changes at the same rollouts give the same weights.

use super::hosts::Hosts;
use rustix::process::Signal;
use std::process::{Child, Command};
use system_tests::{
    Printed, Recording, Run, Workshop, complete, finish, is_held, kill_child, signal, start, wait_until,
};

const ACTORS: u32 = 3;
const ENVIRONMENTS: u32 = 2;
/// No multiple of anything.
const FRAMES: u64 = 1203;
/// The first learner among processes.
const LEARNER: &str = "--rank 0 ";
/// Every start's learner waits in its third update until it is let go: nothing depends on how fast the run is.
pub const HOLD: &str = "hold=learner.before_update:3@learner";
/// The first rollouts with other numbers of actors.
const CHANGES: [(u64, u32); 2] = [(5, 2), (11, 4)];

/// Asks for another number of actors and waits until the orchestrator has taken that.
pub fn ask(workshop: &Workshop, run: &Run, name: &str, (rollout, actors): (u64, u32)) -> Child {
    let mut command = workshop.orchestrator(&["scale", name]);
    command.args(["--actors", &actors.to_string(), "--at-rollout", &rollout.to_string()]);
    let asking = start(command);
    let taken = format!("asked for {actors} actors: the run is saved before rollout {rollout}");
    wait_until("the orchestrator has taken it", || {
        std::fs::read_to_string(run.folder.log("orchestrator")).is_ok_and(|log| log.contains(&taken))
    });
    asking
}

/// Changes the number, of a run whose learner is held and then gets a signal: it goes on, or is killed and started again.
fn change(workshop: &Workshop, run: &Run, name: &str, change: (u64, u32), end: Signal) {
    let learner = run.wait_until_held(LEARNER);
    let asking = ask(workshop, run, name, change);
    signal(learner, end);
    let printed = finish(asking);
    assert!(printed.success && printed.stdout.contains(&format!("from rollout: {} (", change.0)), "{printed:#?}");
}

fn up(workshop: &Workshop, name: &str, learners: u32) -> Command {
    let mut command = workshop.up(name, ACTORS, ENVIRONMENTS, FRAMES);
    command.args(["--learners", &learners.to_string()]).env("STILLROOM_FAULT", HOLD);
    command
}

/// A run with [`CHANGES`], otherwise left alone.
fn changed_twice(workshop: &Workshop, name: &str) -> Printed {
    let child = start(up(workshop, name, 1));
    let run = workshop.run(name);
    for to in CHANGES {
        change(workshop, &run, name, to, Signal::CONT);
    }
    signal(run.wait_until_held(LEARNER), Signal::CONT);
    finish(child)
}

/// Host 0 has all processes' ends and completes its recording; it hears no more words of this start.
#[test]
fn a_stop_that_reaches_another_host_between_two_starts_is_not_lost() {
    let mut hosts = Hosts::new(&["first", "second"]);
    // Host 0 is held for a moment, and lives.
    hosts.deadline_s = 180;
    let children: [Child; 2] = hosts.start_with(|host| {
        let between = if host == 0 { ",hold=orchestrator.before_recorder_finish@orchestrator" } else { "" };
        Some(format!("{HOLD}{between}"))
    });
    let run = hosts.run();
    let second = hosts.workshop.run("second");
    let held = |run: &Run, rank: &str| run.processes(rank).into_iter().find(|pid| is_held(*pid));
    let mut learners = vec![];
    for (run, rank) in [(&run, "--rank 0 "), (&second, "--rank 1 ")] {
        wait_until("all are held", || held(run, rank).map(|pid| learners.push(pid)).is_some());
    }
    let asking = ask(&hosts.workshop, &run, "first", (6, 3));
    for pid in learners {
        signal(pid, Signal::CONT);
    }
    wait_until("host 0 is between two starts", || is_held(children[0].id()));
    signal(children[1].id(), Signal::TERM);
    let log = second.folder.host(1).log("orchestrator");
    wait_until("host 1 has told it", || {
        std::fs::read_to_string(&log).is_ok_and(|log| log.contains("a stop is asked for here"))
    });
    signal(children[0].id(), Signal::CONT);
    let ends = children.map(finish);
    assert!(ends.iter().all(|end| end.status == Some(proto::exit::EXIT_REQUEUE)), "{ends:#?}");
    drop(finish(asking));
    assert_eq!(run.metrics().len(), 6, "saved where the number of actors changed");
    let [again, other] = hosts.complete();
    assert_eq!(again.result().1, hosts.frames);
    assert!(other.success, "{other:#?}");
    hosts.assert_nothing_left();
}

#[test]
fn the_number_of_actors_changes_at_a_rollout_and_nothing_is_lost_or_played_twice() {
    let workshop = Workshop::new();
    let result = changed_twice(&workshop, "scaled").result();
    assert_eq!(result.1, FRAMES);
    let run = workshop.run("scaled");
    run.assert_nothing_left();
    let steps = Recording::of(&run);
    assert_eq!((steps.steps(), steps.messages()), (FRAMES, FRAMES), "each step once");
    assert_eq!(steps.holes(), Vec::<String>::new(), "each environment goes on where it was");
    workshop.assert_replays("scaled");

    // Rollouts have the frames of their actors, but for the last of each stage.
    let mut before = 0;
    let mut whole = 0;
    for (rollout, line) in run.metrics() {
        let frames = line["frames"].as_u64().expect("a number");
        let actors = CHANGES.iter().rev().find(|(from, _)| rollout >= *from).map_or(ACTORS, |(_, actors)| *actors);
        let expected = u64::from(actors * ENVIRONMENTS) * 10;
        assert!(frames - before <= expected, "rollout {rollout}: {} frames", frames - before);
        whole += usize::from(frames - before == expected);
        before = frames;
    }
    assert_eq!(whole, run.metrics().len() - 2, "{:#?}", run.metrics());
    let status = workshop.call(&["status", "scaled"]);
    for line in [
        "from rollout 5 on (300 frames): 1 host, 1 learner, 2 actors instead of 1 host, 1 learner, 3 actors",
        "from rollout 11 on (526 frames): 1 host, 1 learner, 4 actors instead of 1 host, 1 learner, 2 actors",
    ] {
        assert!(status.stdout.contains(line), "{status:#?}");
    }

    // The same changes, and a learner and an orchestrator that are killed.
    let child = start(up(&workshop, "disturbed", 1));
    let other = workshop.run("disturbed");
    change(&workshop, &other, "disturbed", CHANGES[0], Signal::KILL);
    change(&workshop, &other, "disturbed", CHANGES[1], Signal::CONT);
    other.wait_until_held(LEARNER);
    kill_child(child);
    // The held learner does not notice that its orchestrator is gone; the next start wakes it.
    assert_eq!(complete(workshop.resume("disturbed")).result(), result);
    other.assert_nothing_left();
    assert!(Recording::of(&other).holes().is_empty());
    workshop.assert_replays("disturbed");
}

/// Another command's answer is not taken for one's own, and nothing changes what is being carried out already.
#[test]
fn each_of_several_who_ask_hears_its_own_answer() {
    let workshop = Workshop::new();
    let mut command = up(&workshop, "asked", 1);
    // So that it saves for that alone.
    command.args(["--set", "checkpoint.interval_s=3600"]);
    command.env("STILLROOM_FAULT", format!("{HOLD},hold=learner.before_checkpoint:2@learner"));
    let child = start(command);
    let run = workshop.run("asked");
    let refused = |rollout: &str, answer: &str| {
        let words = ["scale", "asked", "--actors", "4", "--at-rollout", rollout];
        let printed = workshop.call(&words);
        assert!(printed.status == Some(1) && printed.stderr.contains(answer), "{printed:#?}");
    };
    let learner = run.wait_until_held(LEARNER);
    let mut asking = ask(&workshop, &run, "asked", CHANGES[0]);
    // Who looks first is a matter of chance.
    for _ in 0..6 {
        refused("1", "rollout 1 has begun already");
        assert!(asking.try_wait().is_ok_and(|end| end.is_none()), "it waits for what it has asked for");
    }
    signal(learner, Signal::CONT);
    wait_until("it trains", || !is_held(learner));
    assert_eq!(run.wait_until_held(LEARNER), learner, "it saves");
    refused("11", "it is being saved");
    signal(learner, Signal::CONT);
    let printed = finish(asking);
    assert!(printed.success && printed.stdout.contains("run ") && printed.stdout.contains("2 actors"), "{printed:#?}");
    let mut child = child;
    wait_until("the run is over", || {
        run.processes(LEARNER).into_iter().filter(|pid| is_held(*pid)).for_each(|pid| signal(pid, Signal::CONT));
        child.try_wait().is_ok_and(|end| end.is_some())
    });
    assert_eq!(finish(child).result().1, FRAMES);
    let status = workshop.call(&["status", "asked"]).stdout;
    assert!(status.contains("from rollout 5 on") && !status.contains("4 actors"), "{status}");
}

#[test]
fn what_cannot_be_is_one_clear_error_and_the_run_goes_on() {
    let workshop = Workshop::new();
    let child = start(up(&workshop, "kept", 2));
    let run = workshop.run("kept");
    let refused = |words: &[&str]| {
        let mut command = workshop.orchestrator(&["scale", "kept"]);
        command.args(words);
        let printed = complete(command);
        assert_eq!(printed.status, Some(1), "{printed:#?}");
        printed.stderr
    };
    let learner = run.wait_until_held(LEARNER);
    let message = refused(&["--actors", "1"]);
    assert!(
        message.contains("the run cannot have 1 actor") && message.contains("every learner has actors of its own"),
        "{message}"
    );
    let message = refused(&["--actors", "4", "--at-rollout", "1"]);
    assert!(message.contains("rollout 1 has begun already"), "{message}");
    assert!(!run.folder.scale_request().exists(), "nothing is left of it");
    let same = workshop.call(&["scale", "kept", "--actors", "3"]);
    assert!(same.success && same.stderr.contains("has 3 actors already"), "{same:#?}");
    for rank in ["--rank 0 ", "--rank 1 "] {
        wait_until("both are held", || run.processes(rank).iter().any(|pid| is_held(*pid)));
    }
    signal(learner, Signal::CONT);
    run.processes("--rank 1 ").into_iter().for_each(|pid| signal(pid, Signal::CONT));
    let (_, frames) = finish(child).result();
    assert_eq!(frames, FRAMES);
    let message = refused(&["--actors", "4"]);
    assert!(message.contains("kept is complete") && message.contains("resume kept --actors 4 --frames F"), "{message}");
    let mut resume = workshop.resume("kept");
    resume.args(["--actors", "4"]);
    complete(resume).refused("this run is complete");
}

#[test]
fn several_hosts_change_together_as_one_does() {
    let change_to = (6, 3);
    let release = |run: &Run| {
        for rank in ["--rank 0 ", "--rank 1 "] {
            wait_until("all are held", || run.processes(rank).iter().any(|pid| is_held(*pid)));
            run.processes(rank).into_iter().for_each(|pid| signal(pid, Signal::CONT));
        }
    };
    let scaled = |workshop: &Workshop, run: &Run, name: &str| {
        run.wait_until_held(LEARNER);
        let asking = ask(workshop, run, name, change_to);
        release(run);
        let printed = finish(asking);
        assert!(printed.success && printed.stdout.contains("from rollout: 6 ("), "{printed:#?}");
        release(run);
    };
    let hosts = Hosts::new(&["shared", "shared"]);
    let children: [Child; 2] = hosts.start_with(|_| Some(HOLD.to_owned()));
    scaled(&hosts.workshop, &hosts.run(), "shared");
    let [first, second] = children.map(finish);
    assert!(second.success, "{second:#?}");
    let steps = Recording::of(&hosts.run());
    assert_eq!((steps.steps(), steps.messages()), (hosts.frames, hosts.frames), "each step once");
    assert!(steps.holes().is_empty(), "{:?}", steps.holes());
    hosts.workshop.assert_replays("shared");
    hosts.assert_nothing_left();

    let mut alone = hosts.workshop.up("alone", 4, 3, hosts.frames);
    alone.args(["--learners", "2"]).env("STILLROOM_FAULT", HOLD);
    let child = start(alone);
    scaled(&hosts.workshop, &hosts.workshop.run("alone"), "alone");
    assert_eq!(finish(child).result(), first.result());
    // A launcher's command, which names the old number, is still that of this run.
    let again = complete(hosts.command_of(0, 1, "token"));
    assert!(again.success && again.stderr.contains("this run is complete"), "{again:#?}");
}

/// The command of a host that brings two actors and so many learners along, for the run of this name.
fn with_its_own(hosts: &Hosts, name: &str, host: usize, count: usize, learners: &str) -> Command {
    let whole = hosts.command_of(host, count, "token");
    let mut words = whole.get_args();
    let mut command = hosts.workshop.orchestrator(&[]);
    while let Some(word) = words.next() {
        match word.to_str() {
            // That of all hosts.
            Some("--actors") => drop(words.next()),
            Some("--run") => {
                words.next();
                command.args(["--run", name]);
            }
            _ => drop(command.arg(word)),
        }
    }
    command.args(["--actors-per-host", "2", "--learners-per-host", learners]);
    command
}

#[test]
fn a_run_goes_on_with_fewer_hosts_and_with_more() {
    let hosts = Hosts::new(&["shared", "shared"]);
    let run = hosts.run();
    let copy = |from: &str, to: &str| hosts.workshop.copy(from, to);
    let by_hand = |name: &str, actors: &str, learners: &str| {
        let mut command = hosts.workshop.resume(name);
        command.args(["--actors", actors, "--learners", learners]);
        complete(command).result()
    };
    let saved = |children: Vec<Child>| {
        run.wait_for_rollouts(run.metrics().len() + 3);
        signal(children[0].id(), Signal::TERM);
        for printed in children.into_iter().map(finish) {
            assert_eq!(printed.status, Some(proto::exit::EXIT_REQUEUE), "{printed:#?}");
        }
        assert!(run.trained() < hosts.frames, "the run was stopped in its middle");
    };
    let up = |name: &str, host: usize, count: usize| start(with_its_own(&hosts, name, host, count, "1"));
    saved(vec![up("shared", 0, 2), up("shared", 1, 2)]);
    copy("shared", "fewer");
    copy("shared", "fewer-by-hand");

    // One host is left: two of the four actors rest.
    saved(vec![up("shared", 0, 1)]);
    copy("shared", "more-by-hand");

    // The other comes again, and the actors that rested go on.
    let [first, second] = [0, 1].map(|host| up("shared", host, 2)).map(finish);
    assert!(second.success, "{second:#?}");
    assert_eq!(first.result(), by_hand("more-by-hand", "4", "2"), "hosts do not matter");
    assert_eq!(first.result().1, hosts.frames);
    assert!(Recording::of(&run).steps() >= hosts.frames, "every step that counts is recorded");
    hosts.workshop.assert_replays("shared");
    let status = hosts.workshop.call(&["status", "shared"]);
    for change in ["1 host, 1 learner, 2 actors instead of 2 hosts", "2 hosts, 2 learners, 4 actors instead of 1 host"]
    {
        assert!(status.stdout.contains(change), "{status:#?}");
    }
    hosts.assert_nothing_left();

    // With one host to the end.
    assert_eq!(finish(up("fewer", 0, 1)).result(), by_hand("fewer-by-hand", "2", "1"));

    complete(with_its_own(&hosts, "new", 0, 1, "3")).refused("every learner has actors of its own");
}
