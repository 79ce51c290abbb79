//! Another user of this machine who wants to see a run.

use rustix::process::{Gid, Uid, geteuid};
use rustix::thread::{set_thread_groups, set_thread_res_gid, set_thread_res_uid};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use system_tests::{Viewer, Workshop, wait_until};

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
        for path in ["/api/runs", "/api/opening", "/api/runs/a/live"] {
            let answer = ask(path);
            assert!(answer.starts_with("HTTP/1.1 401 ") && answer.contains("`stillroom view`"), "{path}: {answer}");
        }
    });
    assert_eq!(viewer.json("/api/runs"), serde_json::json!([]));
    assert!(viewer.stop());
    assert_eq!(in_home().count(), 0, "nothing is left of it");
}
