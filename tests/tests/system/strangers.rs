//! Another program of this machine that does not leave a run alone, and another user who wants to see it.

use rustix::process::{Gid, Signal, Uid, geteuid};
use rustix::thread::{set_thread_groups, set_thread_res_gid, set_thread_res_uid};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::Duration;
use system_tests::{Viewer, Workshop, complete, finish, signal, start, wait_until};

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

/// What another user gets; where these tests may not become one, it is this one without the token.
fn as_another_user<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    const NOBODY: u32 = 65_534;
    let become_one = || {
        let (user, group) = (Uid::from_raw(NOBODY), Gid::from_raw(NOBODY));
        // Of this thread alone.
        set_thread_groups(&[])?;
        set_thread_res_gid(group, group, group)?;
        set_thread_res_uid(user, user, user)
    };
    let work = move || {
        if geteuid().is_root() {
            become_one().expect("root becomes who it wants");
        }
        work()
    };
    std::thread::scope(|scope| scope.spawn(work).join().expect("no panic"))
}

#[test]
fn another_user_sees_nothing_of_a_run_on_a_page_that_was_opened_in_a_browser() {
    let workshop = Workshop::new();
    std::fs::create_dir(workshop.path("runs")).expect("a folder");
    // Of the file that the browser is given its own rights alone protect it.
    std::fs::set_permissions(workshop.path(""), std::fs::Permissions::from_mode(0o755)).expect("a folder of ours");
    let mut command = workshop.orchestrator(&["view", "--open", "--port", "0"]);
    let opened = workshop.with_desktop(&mut command);
    let viewer = Viewer::of(command);
    wait_until("a browser is asked to open the page", || opened.exists());
    let in_home = || std::fs::read_dir(workshop.path("home")).expect("a folder").flatten().map(|entry| entry.path());
    let page = in_home().next().expect("the browser still has it");
    assert!(std::fs::read_to_string(&page).expect("a file of ours").contains(&viewer.page()));
    assert_eq!(std::fs::metadata(&page).expect("a file of ours").permissions().mode() & 0o777, 0o600);

    let processes = std::fs::read_dir("/proc").expect("/proc").flatten();
    let commands = processes.filter_map(|process| std::fs::read(process.path().join("cmdline")).ok());
    let commands: Vec<_> = commands.map(|command| String::from_utf8_lossy(&command).into_owned()).collect();
    assert!(commands.iter().any(|command| command.contains(&*page.to_string_lossy())), "a browser is open");
    assert!(!commands.iter().any(|command| command.contains(&viewer.token)), "a command line is there for everybody");

    let ask = |path: &str| {
        let mut stream = TcpStream::connect(&viewer.address).expect("the viewer listens");
        write!(stream, "GET {path} HTTP/1.1\r\nConnection: close\r\n\r\n").expect("it reads");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        answer
    };
    as_another_user(|| {
        assert!(std::fs::read(&page).is_err() || !geteuid().is_root(), "the file is for its user alone");
        for path in ["/api/runs", "/api/opening", "/metrics", "/foxglove", "/api/runs/a/live"] {
            let answer = ask(path);
            assert!(answer.starts_with("HTTP/1.1 401 ") && answer.contains("`orchestrator view`"), "{path}: {answer}");
        }
    });
    assert_eq!(viewer.json("/api/runs"), serde_json::json!([]));
    assert!(viewer.stop());
    assert_eq!(in_home().count(), 0, "nothing is left of it");
}
