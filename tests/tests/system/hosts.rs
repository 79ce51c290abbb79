//! One run on two hosts: two orchestrators at two addresses of this machine, each with a run folder of its own, or in two
//! network namespaces. Every run that keeps the number of its learners ends in the weights of the same learners on one
//! host, whoever dies.

use rustix::process::Signal;
use std::net::TcpListener;
use std::process::{Child, Command};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use system_tests::{Printed, RecordedSteps, Run, TINY, Workshop, complete, finish, kill_child, signal, start};

const ACTORS: u32 = 4;
const ENVIRONMENTS: u32 = 3;
/// No multiple of anything: the last rollout of a stage leaves some learners without a step.
const FRAMES: u64 = 2503;
/// From the loss of a host to the end of the job.
const DEADLINE_S: u64 = 9;
const HOST_LOST: i32 = proto::exit::EXIT_HOST_LOST;
const REQUEUE: i32 = proto::exit::EXIT_REQUEUE;

/// Two hosts that are both this machine.
struct Hosts {
    workshop: Workshop,
    rendezvous: String,
    folders: [&'static str; 2],
    /// Their network namespaces, where they have some.
    namespaces: Option<[String; 2]>,
}

impl Hosts {
    fn new(folders: [&'static str; 2]) -> Self {
        let workshop = Workshop::new();
        std::fs::write(workshop.path("token"), "0123456789abcdef0123456789abcdef\n").expect("a writable folder");
        std::fs::write(workshop.path("wrong"), "another token that is long enough\n").expect("a writable folder");
        // Free a moment ago; nobody else asks for this very one.
        let port = TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a free port").port();
        Self { workshop, rendezvous: format!("127.0.0.1:{port}"), folders, namespaces: None }
    }

    fn command(&self, host: usize, token: &str) -> Command {
        let up = self.workshop.up(self.folders[host], ACTORS, ENVIRONMENTS, FRAMES);
        let mut command = match &self.namespaces {
            None => up,
            Some(names) => {
                let mut inside = self.workshop.orchestrator(&[]);
                let outside = std::mem::replace(&mut inside, Command::new("ip"));
                inside.args(["netns", "exec", &names[host]]).arg(outside.get_program()).args(up.get_args());
                inside.current_dir(self.workshop.path(""));
                inside.stdin(std::process::Stdio::null());
                inside.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
                inside
            }
        };
        command.args(["--learners", "2", "--hosts", "2", "--host-rank", &host.to_string()]);
        command.args(["--rendezvous", &self.rendezvous, "--token-file", token]);
        command.args(["--join-deadline", "60", "--host-deadline", &DEADLINE_S.to_string()]);
        if host == 1 && self.namespaces.is_none() {
            command.args(["--interface", "127.0.0.2"]);
        }
        command
    }

    fn start(&self) -> [Child; 2] {
        [0, 1].map(|host| start(self.command(host, "token")))
    }

    /// Starts both and waits until both have ended.
    fn complete(&self) -> [Printed; 2] {
        self.start().map(finish)
    }

    fn run(&self) -> Run {
        self.workshop.run(self.folders[0])
    }

    /// The part of the run that host 1 has.
    fn other(&self) -> Run {
        Run { folder: self.workshop.run(self.folders[1]).folder.host(1) }
    }

    fn assert_nothing_left(&self) {
        self.workshop.run(self.folders[1]).wait_for_end();
        self.run().assert_nothing_left();
    }
}

/// The same learners on one host.
fn on_one_host() -> &'static (String, u64) {
    static RESULT: OnceLock<(String, u64)> = OnceLock::new();
    RESULT.get_or_init(|| {
        let workshop = Workshop::new();
        let mut command = workshop.up("one-host", ACTORS, ENVIRONMENTS, FRAMES);
        command.args(["--learners", "2"]);
        complete(command).result()
    })
}

/// Both ended because of the loss of a host, in time, and say which.
fn assert_lost(began: Instant, printed: &[Printed], lost: &str) {
    // A process needs a moment to end even on a busy machine.
    let took = began.elapsed();
    assert!(took < Duration::from_secs(DEADLINE_S + 8), "{took:?}: {printed:#?}");
    for printed in printed {
        assert_eq!(printed.status, Some(HOST_LOST), "{printed:#?}");
        let says = |line: &str| line.contains(lost) && line.contains("was lost");
        assert!(printed.stderr.lines().any(says), "{printed:#?}");
    }
}

#[test]
fn two_hosts_train_as_one_and_their_recordings_together_are_the_run() {
    let hosts = Hosts::new(["shared", "shared"]);
    let [first, second] = hosts.complete();
    assert_eq!(&first.result(), on_one_host());
    assert!(second.success && second.stderr.contains("the run is complete"), "{second:#?}");
    let run = hosts.run();
    assert_eq!(run.recordings().len(), 2, "one of each host");
    let steps = RecordedSteps::of(&run);
    assert_eq!((steps.count(), steps.messages), (FRAMES, FRAMES), "each step once");
    let here = hosts.other().recordings();
    assert!(here.iter().all(|path| path.starts_with(run.folder.host(1).root())), "{here:?}");
    let replayed = complete(hosts.workshop.orchestrator(&["replay", "shared"]));
    assert!(replayed.success && replayed.stdout.contains("differences: 0"), "{replayed:#?}");
    let status = complete(hosts.workshop.orchestrator(&["status", "shared"]));
    assert!(status.stdout.contains("recordings: 2 files"), "{status:#?}");
    assert!(run.folder.host(1).log("learner-1").exists() && !run.folder.log("learner-1").exists());
    hosts.assert_nothing_left();
    // A launcher that starts it again hears that there is nothing to do.
    let [first, second] = hosts.complete();
    assert_eq!(&first.result(), on_one_host());
    assert!(second.success && second.stderr.contains("complete"), "{second:#?}");
}

#[test]
fn a_killed_learner_and_a_killed_actor_of_the_other_host_are_started_again() {
    let hosts = Hosts::new(["first", "second"]);
    let [first, second] = hosts.start();
    let (run, other) = (hosts.run(), hosts.workshop.run("second"));
    run.wait_for_rollouts(3);
    other.kill_one("--actor 3 ");
    run.wait_for_rollouts(8);
    other.kill_one("--rank 1 ");
    let printed = finish(first);
    assert_eq!(&printed.result(), on_one_host());
    let deaths = printed.deaths();
    assert!(
        matches!(deaths[..], [actor, learner] if actor.contains("actor-03") && learner.contains("learner-1")),
        "{deaths:?}"
    );
    assert!(finish(second).success);
    assert!(other.folder.checkpoints().read_dir().is_err(), "checkpoints are host 0's");
    hosts.assert_nothing_left();
}

/// `ppo.overlap`: learners of both hosts speak to each other in updates and between them, in one order.
#[test]
fn beside_updates_two_hosts_collect_as_one_does() {
    let hosts = Hosts::new(["first-beside", "second-beside"]);
    let overlapping = TINY.replace("[ppo]\n", "[ppo]\noverlap = true\n");
    std::fs::write(hosts.workshop.path("tiny.toml"), overlapping).expect("a writable folder");
    let mut command = hosts.workshop.up("one-host", ACTORS, ENVIRONMENTS, FRAMES);
    command.args(["--learners", "2"]);
    let on_one_host_beside = complete(command).result();
    assert_ne!(&on_one_host_beside, on_one_host(), "rollouts are one update older");

    let [first, second] = hosts.start();
    let (run, other) = (hosts.run(), hosts.workshop.run("second-beside"));
    run.wait_for_rollouts(6);
    other.kill_one("--rank 1 ");
    assert_eq!(finish(first).result(), on_one_host_beside);
    assert!(finish(second).success);
    hosts.assert_nothing_left();
}

#[test]
fn a_lost_host_ends_the_job_by_name_and_the_next_start_goes_on() {
    for killed in [0, 1] {
        let hosts = Hosts::new(["first", "second"]);
        let [first, second] = hosts.start();
        let run = hosts.run();
        run.wait_for_rollouts(5);
        let (dies, lives, name) = if killed == 0 { (first, second, "host 0") } else { (second, first, "host 1") };
        let began = Instant::now();
        kill_child(dies);
        assert_lost(began, &[finish(lives)], name);
        assert!(run.trained() < FRAMES, "the run was cut off in its middle");
        let [first, second] = hosts.complete();
        assert_eq!(&first.result(), on_one_host());
        assert!(second.success, "{second:#?}");
        let recorded = RecordedSteps::of(&run).count() + RecordedSteps::of(&hosts.other()).count();
        assert!(recorded >= FRAMES, "every step that counts is recorded: {recorded}");
        hosts.assert_nothing_left();
    }
}

#[test]
fn a_scheduler_has_it_saved_and_started_again_also_with_other_hosts() {
    let hosts = Hosts::new(["first", "second"]);
    let run = hosts.run();
    for (host, asked) in [(0, Signal::TERM), (1, Signal::USR1)] {
        let children = hosts.start();
        run.wait_for_rollouts(run.metrics().len() + 3);
        signal(children[host].id(), asked);
        for printed in children.map(finish) {
            assert_eq!(printed.status, Some(REQUEUE), "{printed:#?}");
        }
    }
    assert!(run.trained() < FRAMES, "the run was stopped in its middle");
    let copied = Command::new("cp").arg("-r").arg(run.folder.root()).arg(hosts.workshop.path("alone")).status();
    assert!(copied.is_ok_and(|status| status.success()));
    let [first, second] = hosts.complete();
    assert_eq!(&first.result(), on_one_host());
    assert!(second.success, "{second:#?}");
    hosts.assert_nothing_left();

    let mut alone = hosts.workshop.up("alone", ACTORS, ENVIRONMENTS, FRAMES);
    alone.args(["--hosts", "1", "--host-rank", "0"]);
    let printed = complete(alone);
    assert_eq!(printed.result().1, FRAMES);
    assert!(printed.stderr.contains("1 learners instead of 2: floating-point sums have another order"), "{printed:#?}");
}

#[test]
fn strangers_stay_outside_and_whoever_does_not_come_is_named() {
    let hosts = Hosts::new(["first", "second"]);
    let mut lonely = hosts.command(0, "token");
    lonely.args(["--set", "checkpoint.interval_s=60.0"]);
    let child = start(lonely);
    let mut stranger = hosts.command(1, "wrong");
    let arguments: Vec<_> = stranger.get_args().map(ToOwned::to_owned).collect();
    let at = arguments.iter().position(|argument| argument == "60").expect("the deadline");
    stranger = hosts.workshop.orchestrator(&[]);
    stranger.args(&arguments[..at]).arg("2").args(&arguments[at + 1..]);
    let refused = complete(stranger);
    assert_eq!(refused.status, Some(1), "{refused:#?}");
    assert!(refused.stderr.contains("does not have this run's token"), "{refused:#?}");
    signal(child.id(), Signal::TERM);
    let printed = finish(child);
    assert!(
        printed.stderr.contains("a connection from 127.0.0.2") && printed.stderr.contains("is refused"),
        "{printed:#?}"
    );

    let short = |mut command: Command| {
        command.args(["--learners", "1"]);
        complete(command)
    };
    let refused = short(hosts.workshop.orchestrator(&[
        "up",
        "--hosts",
        "2",
        "--host-rank",
        "0",
        "--rendezvous",
        "127.0.0.1:1",
        "--run",
        "x",
    ]));
    assert!(refused.stderr.contains("2 hosts (the command line) cannot share 1 learner"), "{refused:#?}");
    let refused = short(hosts.workshop.orchestrator(&["up", "--hosts", "2", "--host-rank", "1"]));
    assert!(refused.stderr.contains("--rendezvous is missing"), "{refused:#?}");
}

/// Two network namespaces with a pair of ends between them; gone when dropped.
struct Namespaces([String; 2]);

impl Namespaces {
    /// None where this user or this container may not make them.
    fn new() -> Option<Self> {
        let names = [0, 1].map(|host| format!("stillroom-{}-{host}", std::process::id()));
        let made = Self(names);
        for name in &made.0 {
            if let Err(reason) = ip(&["netns", "add", name]) {
                eprintln!("skipped: network namespaces cannot be made here: {reason}");
                return None;
            }
        }
        let ends = ["vstill0", "vstill1"];
        let [first, second] = &made.0;
        let pair = ["link", "add", ends[0], "netns", first, "type", "veth", "peer", "name", ends[1], "netns", second];
        if let Err(reason) = ip(&pair) {
            eprintln!("skipped: pairs of network ends cannot be made here: {reason}");
            return None;
        }
        for (host, name) in made.0.iter().enumerate() {
            let address = format!("10.77.3.{}/24", host + 1);
            ip(&["-n", name, "addr", "add", &address, "dev", ends[host]]).expect("ip works");
            ip(&["-n", name, "link", "set", ends[host], "up"]).expect("ip works");
            ip(&["-n", name, "link", "set", "lo", "up"]).expect("ip works");
        }
        Some(made)
    }

    fn set_link(&self, state: &str) {
        ip(&["-n", &self.0[1], "link", "set", "vstill1", state]).expect("ip works");
    }
}

impl Drop for Namespaces {
    fn drop(&mut self) {
        for name in &self.0 {
            let _ = ip(&["netns", "del", name]);
        }
    }
}

fn ip(arguments: &[&str]) -> Result<(), String> {
    let output = Command::new("ip").args(arguments).output().map_err(|error| format!("ip: {error}"))?;
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).trim().to_owned()) }
}

#[test]
fn a_cut_cable_ends_both_sides_in_time_and_a_mended_one_lets_them_go_on() {
    let Some(namespaces) = Namespaces::new() else { return };
    let mut hosts = Hosts::new(["first", "second"]);
    hosts.rendezvous = "10.77.3.1:29400".into();
    hosts.namespaces = Some(namespaces.0.clone());
    let children = hosts.start();
    let run = hosts.run();
    run.wait_for_rollouts(4);
    let before = run.metrics().len();
    let began = Instant::now();
    namespaces.set_link("down");
    let printed = children.map(finish);
    assert_lost(began, &printed[..1], "host 1 (10.77.3.2)");
    assert_lost(began, &printed[1..], "host 0");
    assert!(run.metrics().len() <= before + 2, "nobody trains alone");
    hosts.assert_nothing_left();
    namespaces.set_link("up");
    let [first, second] = hosts.complete();
    assert_eq!(&first.result(), on_one_host());
    assert!(second.success, "{second:#?}");
    hosts.assert_nothing_left();
}
