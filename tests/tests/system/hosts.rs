//! One run on two hosts: two orchestrators at two addresses of this machine, each with a run folder of its own. Every run
//! that keeps the number of its learners ends in the weights of the same learners on one host, whoever dies.

use rustix::process::Signal;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use system_tests::{
    Network, Printed, Recording, Run, Undisturbed, Workshop, complete, finish, kill_child, signal, start,
};

pub const ACTORS: u32 = 4;
pub const ENVIRONMENTS: u32 = 3;
/// No multiple of anything: the last rollout of a stage leaves some learners without a step.
const FRAMES: u64 = 2503;
/// From the loss of a host to the end of the job.
const DEADLINE_S: u64 = 9;
const HOST_LOST: i32 = proto::exit::EXIT_HOST_LOST;
const REQUEUE: i32 = proto::exit::EXIT_REQUEUE;

/// Hosts that are all this machine, each with a learner.
pub struct Hosts {
    pub workshop: Workshop,
    pub frames: u64,
    pub deadline_s: u64,
    rendezvous: String,
    folders: Vec<&'static str>,
    network: Option<Network>,
}

impl Hosts {
    pub fn new(folders: &[&'static str]) -> Self {
        let workshop = Workshop::new();
        workshop.secret("token", "0123456789abcdef0123456789abcdef\n");
        workshop.secret("wrong", "another token that is long enough\n");
        // Free a moment ago; nobody else asks for this very one.
        let port = TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a free port").port();
        let rendezvous = format!("127.0.0.1:{port}");
        let folders = folders.to_vec();
        Self { workshop, frames: FRAMES, deadline_s: DEADLINE_S, rendezvous, folders, network: None }
    }

    /// The same in a network of namespaces.
    pub fn within(folders: &[&'static str], network: Network) -> Self {
        let rendezvous = format!("{}:29400", Network::address(0));
        Self { rendezvous, network: Some(network), ..Self::new(folders) }
    }

    pub fn network(&self) -> &Network {
        self.network.as_ref().expect("these hosts have a network")
    }

    pub fn command(&self, host: usize, token: &str) -> Command {
        let count = self.folders.len().to_string();
        let mut command = self.command_of(host, self.folders.len(), token);
        command.args(["--learners", &count]);
        command
    }

    /// The command of a host among so many, without the number of learners.
    pub fn command_of(&self, host: usize, hosts: usize, token: &str) -> Command {
        let up = self.workshop.up(self.folders[host], ACTORS, ENVIRONMENTS, self.frames);
        let mut command = match &self.network {
            None => up,
            Some(network) => {
                let mut inside = network.on(host);
                inside.arg(up.get_program()).args(up.get_args()).current_dir(self.workshop.path(""));
                inside.env_remove("STILLROOM_LOG").env_remove("STILLROOM_FAULT").stdin(Stdio::null());
                inside.stdout(Stdio::piped()).stderr(Stdio::piped());
                inside
            }
        };
        command.args(["--hosts", &hosts.to_string(), "--host-rank", &host.to_string()]);
        command.args(["--rendezvous", &self.rendezvous, "--token-file", token]);
        command.args(["--join-deadline", "60", "--host-deadline", &self.deadline_s.to_string()]);
        if host > 0 && self.network.is_none() {
            command.args(["--interface", &format!("127.0.0.{}", host + 1)]);
        }
        command
    }

    pub fn start<const N: usize>(&self) -> [Child; N] {
        self.start_with(|_| None)
    }

    /// The same with faults in each host's processes.
    pub fn start_with<const N: usize>(&self, fault: impl Fn(usize) -> Option<String>) -> [Child; N] {
        assert_eq!(N, self.folders.len(), "all are started");
        std::array::from_fn(|host| {
            let mut command = self.command(host, "token");
            command.envs(fault(host).map(|fault| ("STILLROOM_FAULT", fault)));
            start(command)
        })
    }

    /// Starts all and waits until all have ended.
    pub fn complete<const N: usize>(&self) -> [Printed; N] {
        self.start().map(finish)
    }

    pub fn run(&self) -> Run {
        self.workshop.run(self.folders[0])
    }

    /// The part of the run that host 1 has.
    fn other(&self) -> Run {
        Run { folder: self.workshop.run(self.folders[1]).folder.host(1) }
    }

    pub fn assert_nothing_left(&self) {
        for folder in &self.folders[1..] {
            self.workshop.run(folder).wait_for_end();
        }
        self.run().assert_nothing_left();
    }
}

/// The same learners on one host.
fn on_one_host() -> (String, u64) {
    as_many_on_one_host(2, FRAMES)
}

pub fn as_many_on_one_host(learners: u32, frames: u64) -> (String, u64) {
    let workshop = Workshop::new();
    let mut command = workshop.up("undisturbed", ACTORS, ENVIRONMENTS, frames);
    command.args(["--learners", &learners.to_string()]);
    Undisturbed::of(&workshop, command).result
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
    let hosts = Hosts::new(&["shared", "shared"]);
    let [first, second] = hosts.complete();
    assert_eq!(first.result(), on_one_host());
    assert!(second.success && second.stderr.contains("the run is complete"), "{second:#?}");
    let run = hosts.run();
    assert_eq!(run.recordings().len(), 2, "one of each host");
    for line in run.metrics().values() {
        // A gradient of 32-bit floats in each of two epochs.
        let bytes = line["metrics"]["rollout/exchanged_bytes"].as_f64().unwrap_or(0.0);
        assert!(bytes > 100_000.0 && bytes % 8.0 == 0.0, "{line}");
        let [exchange, update] = ["exchange_s", "update_s"].map(|part| line["timing"][part].as_f64().unwrap_or(0.0));
        assert!(0.0 < exchange && exchange < update, "{line}");
    }
    let steps = Recording::of(&run);
    assert_eq!((steps.steps(), steps.messages()), (FRAMES, FRAMES), "each step once");
    let here = hosts.other().recordings();
    assert!(here.iter().all(|path| path.starts_with(run.folder.host(1).root())), "{here:?}");
    hosts.workshop.assert_replays("shared");
    let status = hosts.workshop.call(&["status", "shared"]);
    assert!(status.stdout.contains("recordings: 2 files"), "{status:#?}");
    assert!(run.folder.host(1).log("learner-1").exists() && !run.folder.log("learner-1").exists());
    hosts.assert_nothing_left();
    // A launcher that starts it again hears that there is nothing to do.
    let [first, second] = hosts.complete();
    assert_eq!(first.result(), on_one_host());
    assert!(second.success && second.stderr.contains("complete"), "{second:#?}");
}

#[test]
fn a_killed_learner_and_a_killed_actor_of_the_other_host_are_started_again() {
    let hosts = Hosts::new(&["first", "second"]);
    let [first, second] = hosts.start();
    let (run, other) = (hosts.run(), hosts.workshop.run("second"));
    run.wait_for_rollouts(3);
    other.kill_one("--actor 3 ");
    run.wait_for_rollouts(8);
    other.kill_one("--rank 1 ");
    let printed = finish(first);
    assert_eq!(printed.result(), on_one_host());
    let deaths = printed.deaths();
    assert!(
        matches!(deaths[..], [actor, learner] if actor.contains("actor-03") && learner.contains("learner-1")),
        "{deaths:?}"
    );
    assert!(finish(second).success);
    assert!(other.folder.checkpoints().read_dir().is_err(), "checkpoints are host 0's");
    hosts.assert_nothing_left();
}

#[test]
fn what_another_hosts_command_asks_for_otherwise_is_said_on_both_and_host_0_counts() {
    let mut hosts = Hosts::new(&["first", "second"]);
    hosts.frames = 311;
    let mut second = hosts.command(1, "token");
    hosts.frames = 303;
    second.args(["--set", "ppo.learning_rate=0.5"]);
    let (first, second) = (start(hosts.command(0, "token")), start(second));
    let [first, second] = [first, second].map(finish);
    assert_eq!(first.result(), as_many_on_one_host(2, 303));
    assert!(second.success, "{second:#?}");
    for (printed, sentence) in [(&first, "host 1 was started with"), (&second, "this host was started with")] {
        let told: Vec<_> = printed.stderr.lines().filter(|line| line.contains(sentence)).collect();
        assert_eq!(told.len(), 1, "{printed:#?}");
        for part in ["ppo.learning_rate = 0.5 instead of 0.0", "stages.0.frames = ", "count"] {
            assert!(told[0].contains(part), "{part}: {told:?}");
        }
        assert!(!told[0].contains("seed") && !told[0].contains("actors"), "only what differs: {told:?}");
    }
    hosts.assert_nothing_left();
}

/// Whoever reaches the rendezvous can connect there as often as he likes.
#[test]
fn a_stranger_who_knocks_writes_no_log() {
    let hosts = Hosts::new(&["first", "second"]);
    let first = start(hosts.command(0, "token"));
    let knock = |says: &[u8]| {
        let mut stranger = TcpStream::connect(&hosts.rendezvous).ok()?;
        stranger.set_read_timeout(Some(Duration::from_secs(1))).ok()?;
        stranger.write_all(says).ok()?;
        Some(stranger.read_to_end(&mut vec![]))
    };
    system_tests::wait_until("host 0 listens", || knock(b"GET / HTTP/1.1\r\n\r\n").is_some());
    let knocks = (0..300).filter(|_| knock(b"GET / HTTP/1.1\r\n\r\n").is_some()).count();
    let mute: Vec<_> = (0..200).filter_map(|_| TcpStream::connect(&hosts.rendezvous).ok()).collect();
    let second = finish(start(hosts.command(1, "token")));
    let first = finish(first);
    assert_eq!((first.result(), second.success), (on_one_host(), true), "{second:#?}");
    drop(mute);
    let log = hosts.run().log("orchestrator");
    for text in [&log, &first.stderr] {
        let lines: Vec<_> = text.lines().filter(|line| line.contains("refused") || line.contains("prove")).collect();
        assert!(knocks == 300 && (2..10).contains(&lines.len()), "{knocks} knocks: {lines:#?}");
        let count = |line: &&str| line.split_whitespace().filter_map(|word| word.parse::<usize>().ok()).max();
        assert!(lines.iter().filter_map(count).any(|count| count >= 290), "they are counted: {lines:#?}");
    }
}

#[test]
fn a_lost_host_ends_the_job_by_name_and_the_next_start_goes_on() {
    for killed in [0, 1] {
        let hosts = Hosts::new(&["first", "second"]);
        let [first, second] = hosts.start();
        let run = hosts.run();
        run.wait_for_rollouts(5);
        let (dies, lives, name) = if killed == 0 { (first, second, "host 0") } else { (second, first, "host 1") };
        let began = Instant::now();
        kill_child(dies);
        let printed = finish(lives);
        let goes_on = printed.stderr.contains("go on with  the same command again, on each of the 2 hosts");
        assert_eq!(goes_on, killed == 1, "host 0 says so: {printed:#?}");
        assert_lost(began, &[printed], name);
        assert!(run.trained() < FRAMES, "the run was cut off in its middle");
        let [first, second] = hosts.complete();
        assert_eq!(first.result(), on_one_host());
        assert!(second.success, "{second:#?}");
        let recorded = Recording::of(&run).steps() + Recording::of(&hosts.other()).steps();
        assert!(recorded >= FRAMES, "every step that counts is recorded: {recorded}");
        hosts.assert_nothing_left();
    }
}

#[test]
fn a_scheduler_has_it_saved_and_started_again_also_with_other_hosts() {
    let hosts = Hosts::new(&["first", "second"]);
    let run = hosts.run();
    for (host, asked) in [(0, Signal::TERM), (1, Signal::USR1)] {
        let children: [Child; 2] = hosts.start();
        run.wait_for_rollouts(run.metrics().len() + 3);
        signal(children[host].id(), asked);
        for printed in children.map(finish) {
            assert_eq!(printed.status, Some(REQUEUE), "{printed:#?}");
        }
    }
    assert!(run.trained() < FRAMES, "the run was stopped in its middle");
    hosts.workshop.copy("first", "alone");
    let [first, second] = hosts.complete();
    assert_eq!(first.result(), on_one_host());
    assert!(second.success, "{second:#?}");
    hosts.assert_nothing_left();

    let mut alone = hosts.workshop.up("alone", ACTORS, ENVIRONMENTS, FRAMES);
    alone.args(["--hosts", "1", "--host-rank", "0"]);
    let printed = complete(alone);
    assert_eq!(printed.result().1, FRAMES);
    assert!(printed.stderr.contains("1 learner instead of 2: floating-point sums have another order"), "{printed:#?}");
}

#[test]
fn strangers_stay_outside_and_whoever_does_not_come_is_named() {
    let hosts = Hosts::new(&["first", "second"]);
    let mut lonely = hosts.command(0, "token");
    lonely.args(["--set", "checkpoint.interval_s=60.0"]);
    let child = start(lonely);
    let mut stranger = hosts.command(1, "wrong");
    let arguments: Vec<_> = stranger.get_args().map(ToOwned::to_owned).collect();
    let at = arguments.iter().position(|argument| argument == "60").expect("the deadline");
    stranger = hosts.workshop.orchestrator(&[]);
    stranger.args(&arguments[..at]).arg("20").args(&arguments[at + 1..]);
    let refused = complete(stranger);
    assert_eq!(refused.status, Some(1), "{refused:#?}");
    refused.refused("does not have this run's token");
    signal(child.id(), Signal::TERM);
    let printed = finish(child);
    assert!(
        printed.stderr.contains("a connection from 127.0.0.2") && printed.stderr.contains("is refused"),
        "{printed:#?}"
    );

    for (words, why) in [
        ("--host-rank 0 --rendezvous 127.0.0.1:1 --run x", "2 hosts (the command line) cannot share 1 learner"),
        ("--host-rank 1", "--rendezvous is missing"),
    ] {
        let words: Vec<&str> = "up --hosts 2 --learners 1".split(' ').chain(words.split(' ')).collect();
        hosts.workshop.call(&words).refused(why);
    }
}
