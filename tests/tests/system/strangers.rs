//! Another program of this machine that does not leave a run alone.

use rustix::process::Signal;
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::PathBuf;
use std::time::Duration;
use system_tests::{Workshop, complete, finish, signal, start};

const FRAMES: u64 = 700;
/// How many files a learner may have open, and how many connections come: more.
const OPEN_FILES: usize = 1024;
const CONNECTIONS: usize = 1100;

/// What a process has open.
fn open_files(pid: u32) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(format!("/proc/{pid}/fd")).expect("the process lives");
    entries.filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok()).collect()
}

/// Where a process listens at TCP.
fn doors(pid: u32) -> Vec<SocketAddr> {
    let own = open_files(pid);
    let table = std::fs::read_to_string(format!("/proc/{pid}/net/tcp")).expect("the process lives");
    let door = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let ours = own.contains(&PathBuf::from(format!("socket:[{}]", words.get(9)?)));
        let port = u16::from_str_radix(words[1].split_once(':')?.1, 16).ok()?;
        (ours && words[3] == "0A").then(|| SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
    };
    table.lines().filter_map(door).collect()
}

/// Knocks at `doors` by turns, [`CONNECTIONS`] times in all. Returns the connections that came about.
fn besiege(doors: &[SocketAddr]) -> Vec<TcpStream> {
    const THREADS: usize = 64;
    // One that is let in is so at once: the other end is this machine.
    let knock = |turn: usize| TcpStream::connect_timeout(&doors[turn % doors.len()], Duration::from_millis(100)).ok();
    let knocks = |first: usize| (first..CONNECTIONS).step_by(THREADS).filter_map(knock).collect::<Vec<_>>();
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS).map(|first| scope.spawn(move || knocks(first))).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("no panic")).collect()
    })
}

/// Gloo takes in whoever comes to its socket, and ends the learner when that has no descriptors left.
#[test]
fn more_connections_than_a_learner_may_have_change_nothing_in_a_run() {
    let workshop = Workshop::new();
    let up = |name: &str| {
        let mut command = workshop.up(name, 2, 3, FRAMES);
        command.args(["--learners", "2"]);
        workshop.limited(&format!("ulimit -n {OPEN_FILES}"), &command)
    };
    let undisturbed = complete(up("undisturbed")).result();
    let child = start(up("besieged"));
    let run = workshop.run("besieged");
    run.wait_for_rollouts(1);
    let learners = run.processes("--rank");
    let doors: Vec<SocketAddr> = learners.iter().flat_map(|&learner| doors(learner)).collect();
    assert_eq!((learners.len(), doors.len()), (2, 2), "each learner has one socket, which is Gloo's: {doors:?}");
    let count = || learners.iter().map(|&learner| open_files(learner).len()).collect::<Vec<_>>();
    let before = count();
    // The run does not come to its end meanwhile.
    let actors = run.processes("--actor ");
    for &actor in &actors {
        signal(actor, Signal::STOP);
    }
    let let_in = besiege(&doors);
    assert_eq!(run.processes("--rank"), learners, "the same learners after {} were let in", let_in.len());
    let during = count();
    for &actor in &actors {
        signal(actor, Signal::CONT);
    }
    assert!(let_in.is_empty(), "{} of {CONNECTIONS} were let in", let_in.len());
    // A checkpoint that is being written, a few more.
    assert!(before.iter().zip(&during).all(|(before, during)| *during < before + 16), "{before:?} {during:?}");
    let printed = finish(child);
    assert_eq!(printed.result(), undisturbed);
    assert!(printed.deaths().iter().all(|death| !death.contains("learner-")), "{printed:#?}");
    run.assert_nothing_left();
}
