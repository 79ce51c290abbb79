//! One run on three hosts with a network of their own: namespaces with cables to a switch. Cables are cut while a process
//! is held in the middle of what it does, hosts and processes are killed. Each time all hosts end in time and name the one
//! that is lost, and the same commands go on to the weights of as many learners on one host.

use super::hosts::{Hosts, as_many_on_one_host};
use std::io::Read;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use system_tests::{Network, Printed, Quality, Recording, finish, kill, kill_child, start, wait_until};

const HOSTS: usize = 3;
/// As `--host-deadline` has it where nobody says anything else.
const DEADLINE_S: u64 = 30;
/// No multiple of anything: the last rollout of a stage leaves some learners without a step.
const FRAMES: u64 = 1703;
const SLOW_FRAMES: u64 = 403;
const HOST_LOST: i32 = proto::exit::EXIT_HOST_LOST;

fn hosts(quality: Option<Quality>) -> Option<Hosts> {
    // One folder, as on a shared disk: all recordings are in it.
    let mut hosts = Hosts::within(&["shared"; HOSTS], Network::new(HOSTS as u32, quality)?);
    (hosts.frames, hosts.deadline_s) = (FRAMES, DEADLINE_S);
    Some(hosts)
}

fn on_one_host() -> (String, u64) {
    as_many_on_one_host(HOSTS as u32, FRAMES)
}

/// The same commands go on to the end, and all of it is recorded and can be replayed.
fn goes_on(hosts: &Hosts, expected: &(String, u64)) {
    assert!(hosts.run().trained() < expected.1, "the run was cut off in its middle");
    is_complete(hosts, &hosts.complete(), expected);
}

fn is_complete(hosts: &Hosts, printed: &[Printed; HOSTS], expected: &(String, u64)) {
    assert_eq!(&printed[0].result(), expected);
    for other in &printed[1..] {
        assert!(other.success && other.stderr.contains("the run is complete"), "{other:#?}");
    }
    let steps = Recording::of(&hosts.run());
    assert!(steps.steps() >= expected.1 && steps.holes().is_empty(), "{} steps, {:?}", steps.steps(), steps.holes());
    hosts.workshop.assert_replays("shared");
    hosts.assert_nothing_left();
}

/// All of them ended because this one of the hosts was lost. It took the rest of `--host-deadline` at most, and a moment
/// in which a busy machine ends processes.
fn assert_lost(began: Instant, printed: &[Printed], lost: usize) {
    let took = began.elapsed();
    assert!(took < Duration::from_secs(DEADLINE_S + 8), "{took:?}: {printed:#?}");
    let names = |line: &str| line.contains(&format!("host {lost} (")) && line.contains("was lost");
    for printed in printed {
        assert_eq!(printed.status, Some(HOST_LOST), "{printed:#?}");
        assert!(printed.stderr.lines().any(names), "host {lost}: {printed:#?}");
    }
}

/// A process of `held` stops at this point; then the cable of the last host is cut.
fn cut_at(point: &str, held: usize) {
    let Some(hosts) = hosts(None) else { return };
    let network = hosts.network();
    let children: [Child; HOSTS] = hosts.start_with(|host| (host == held).then(|| format!("hold={point}@learner")));
    network.wait_until_held(held, "--rank");
    let before = hosts.run().metrics().len();
    let began = Instant::now();
    network.cut(HOSTS - 1);
    let printed = children.map(finish);
    assert_lost(began, &printed[..HOSTS - 1], HOSTS - 1);
    assert_lost(began, &printed[HOSTS - 1..], 0);
    assert!(hosts.run().metrics().len() <= before + 1, "nobody trains alone");
    hosts.assert_nothing_left();
    network.mend(HOSTS - 1);
    goes_on(&hosts, &on_one_host());
}

#[test]
fn a_cable_is_cut_in_the_middle_of_a_rollout() {
    cut_at("learner.mid_rollout:35", 2);
}

/// The other two have begun to add up their gradients.
#[test]
fn a_cable_is_cut_in_the_middle_of_an_exchange() {
    cut_at("learner.before_exchange:6", 2);
}

/// The first learner has written the tensors, and not yet the manifest; the others wait for it.
#[test]
fn a_cable_is_cut_in_the_middle_of_a_checkpoint() {
    cut_at("learner.after_tensors:4", 0);
}

/// What a killed orchestrator leaves in shared memory is removed by its next start.
fn wait_until_none_runs(hosts: &Hosts) {
    let runs = |host| !hosts.network().processes(host, "").is_empty();
    wait_until("all processes have ended", || !(0..HOSTS).any(runs));
}

/// One job, which loses a learner and an actor, then one host after the other.
#[test]
fn whoever_is_killed_is_started_again_or_named() {
    let Some(hosts) = hosts(None) else { return };
    let (network, run) = (hosts.network(), hosts.run());
    let kill_one = |host: usize, word: &str| {
        let found = network.processes(host, word);
        assert_eq!(found.len(), 1, "`{word}` of host {host}: {found:?}");
        kill(found[0]);
    };
    let go_on = || -> [Child; HOSTS] {
        let before = run.metrics().len();
        let children = hosts.start();
        run.wait_for_rollouts(before + 2);
        children
    };
    let [first, second, third] = go_on();
    kill_one(1, "--rank 1 ");
    run.wait_for_rollouts(run.metrics().len() + 2);
    kill_one(2, "--actor 3 ");
    run.wait_for_rollouts(run.metrics().len() + 2);

    // The orchestrator of host 0.
    let began = Instant::now();
    let printed = kill_child(first);
    let deaths = printed.deaths();
    assert!(deaths.iter().any(|death| death.contains("learner-1 died")), "{printed:#?}");
    assert!(deaths.iter().any(|death| death.contains("actor-03")), "{printed:#?}");
    assert_lost(began, &[finish(second), finish(third)], 0);
    wait_until_none_runs(&hosts);

    // The agent of host 2.
    let [first, second, third] = go_on();
    let began = Instant::now();
    kill_child(third);
    assert_lost(began, &[finish(first), finish(second)], 2);
    wait_until_none_runs(&hosts);

    // All of host 1, which sends no word of it.
    let [first, second, third] = go_on();
    let began = Instant::now();
    network.cut(1);
    network.processes(1, "").into_iter().for_each(kill);
    assert_lost(began, &[finish(first), finish(third)], 1);
    assert!(finish(second).killed);
    network.mend(1);
    wait_until_none_runs(&hosts);
    goes_on(&hosts, &on_one_host());
}

/// What came back of 400 words from host 1 to host 0, and the shortest time that took, ms.
const ECHO: &str = r#"
import os, socket, sys, time
port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
if sys.argv[1] == "answer":
    port.bind((sys.argv[2], 7000))
    print("ready", flush=True)
    while True:
        port.sendto(*port.recvfrom(64))
port.settimeout(0.2)
back, shortest = 0, 1000.0
for number in range(400):
    sent = time.monotonic()
    port.sendto(b"%d" % number, (sys.argv[2], 7000))
    try:
        while port.recv(64) != b"%d" % number:
            pass
    except TimeoutError:
        continue
    back, shortest = back + 1, min(shortest, 1000 * (time.monotonic() - sent))
print(back, shortest)
"#;

/// Whatever carries the packets, the kernel or a program: a test on a good network would prove nothing of a bad one.
#[test]
fn a_bad_network_is_as_bad_as_it_is_said_to_be() {
    let quality = Quality { delay_ms: 10.0, jitter_ms: 2.5, loss_percent: 30.0 };
    let Some(network) = Network::new(2, Some(quality)) else { return };
    let speaking = |host: usize, role: &str| {
        let mut command = network.on(host);
        command.args(["python3", "-c", ECHO, role, &Network::address(0)]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        start(command)
    };
    let mut answering = speaking(0, "answer");
    let mut ready = [0; 6];
    answering.stdout.take().expect("a pipe").read_exact(&mut ready).expect("it says that it is ready");
    let printed = finish(speaking(1, "ask"));
    drop(kill_child(answering));
    let words: Vec<f64> = printed.stdout.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let [back, shortest_ms] = words[..] else { panic!("{printed:#?}") };
    // 196 of 400 arrive both ways, more or less 10.
    assert!((140.0..250.0).contains(&back), "{back} of 400 came back");
    assert!(shortest_ms >= 15.0, "{shortest_ms} ms there and back");
}

/// 20 ms there and back, 5 ms more or less, and every hundredth packet is lost.
#[test]
fn a_slow_network_that_loses_packets_changes_no_bit() {
    let quality = Quality { delay_ms: 10.0, jitter_ms: 2.5, loss_percent: 1.0 };
    let Some(mut hosts) = hosts(Some(quality)) else { return };
    hosts.frames = SLOW_FRAMES;
    let printed = hosts.complete();
    is_complete(&hosts, &printed, &as_many_on_one_host(HOSTS as u32, SLOW_FRAMES));
}
