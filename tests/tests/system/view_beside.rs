//! A viewer beside a run: started by the run itself and opened in a browser; and asked by a hundred clients of which many
//! mean no good, while the run trains as if nobody were there.

use proto::run_folder::RunFolder;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;
use system_tests::{Browser, Viewer, Workshop, complete, finish, start, wait_until};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 2;
const FRAMES: u64 = 600;
const CLIENTS: usize = 100;

#[test]
fn a_run_opens_its_page_in_a_browser_and_the_viewer_ends_with_it() {
    let workshop = Workshop::new();
    let mut command = workshop.up("runs/seen", ACTORS, ENVIRONMENTS, 1_000_000);
    let asked = workshop.with_desktop(command.arg("--view"));
    let child = start(command);
    wait_until("a browser is asked to open the page", || asked.exists());
    let page = std::fs::read_to_string(&asked).expect("a page that leads to the viewer's");
    let host =
        page.split_once("url=http://").and_then(|(_, place)| place.split_once("/#token=")).expect("an address").0;
    assert!(TcpStream::connect(host).is_ok(), "{page}");

    if let Some(mut browser) = Browser::start() {
        browser.open(&format!("file://{}", asked.display()));
        browser.wait_for("document.querySelector('h1')?.textContent === 'seen'");
        browser.wait_for("document.querySelector('.state.running')");
        let points = "Number(document.querySelector('[data-figure=\"time/frames_per_second\"]')?.dataset.points ?? 0)";
        browser.wait_for(&format!("{points} > 1"));
        let before = browser.value(points).as_u64().expect("a number");
        browser.wait_for(&format!("{points} > {before}"));
        for name in ["learner-0", "actor-00", "actor-01", "orchestrator"] {
            browser.wait_for(&format!("document.body.innerText.includes({name:?})"));
        }
        browser.wait_for("document.body.innerText.includes('waiting for simulation')");
        assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
    } else {
        eprintln!("no Chromium on the PATH: the page was not looked at");
    }
    let stopped = complete(workshop.orchestrator(&["stop", "runs/seen"]));
    assert!(stopped.success, "{}", stopped.stderr);
    assert!(finish(child).success, "the run was saved");
    wait_until("the viewer has ended with its run", || TcpStream::connect(host).is_err());
}

/// Requests that are asked again and again: honest ones, wrong ones, large ones, hostile ones.
fn requests(token: &str) -> Vec<String> {
    let long = "x".repeat(60_000);
    let mut paths: Vec<String> = [
        "/",
        "/main.js",
        "/api/runs",
        "/api/runs/watched",
        "/api/runs/watched/curves",
        "/api/runs/watched/curves?edition=18446744073709551615&known=18446744073709551615",
        "/api/runs/watched/episodes?limit=500&sort=length",
        "/api/runs/watched/episodes?offset=18446744073709551615&limit=18446744073709551615",
        "/api/runs/watched/episodes?range=length&least=NaN&most=inf",
        "/api/runs/watched/newest/1/0",
        "/api/runs/watched/newest/4294967295/4294967295",
        "/api/runs/watched/episodes/1-0-0",
        "/api/runs/watched/episodes/4294967295-4294967295-4294967295",
        "/api/runs/watched/episodes/1-0-0/picture?view=orbit&step=0&width=2048&height=2048&fine=true&radius=NaN",
        "/api/runs/watched/episodes/1-0-0/picture?view=depth&step=4294967295&width=4294967295",
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/%252e%252e%252fetc%252fpasswd",
        "/..%5c..%5cetc%5cpasswd",
        "/api/runs/%2e%2e%2f%2e%2e%2fetc",
        "/api/runs/watched%2f..%2f..%2f",
        "/api/runs/%ff%fe",
        "/api/runs/%00",
        "/api/runs/watched/episodes/..%2f..%2frun.toml",
    ]
    .map(str::to_owned)
    .into();
    paths.push(format!("/api/runs/watched/episodes?target={long}"));
    paths.push(format!("/{}", "a/".repeat(20_000)));
    let token = format!("Host: 127.0.0.1\r\nAuthorization: Bearer {token}\r\n");
    let get = |path: &String| format!("GET {path} HTTP/1.1\r\n{token}Connection: close\r\n\r\n");
    let mut all: Vec<String> = paths.iter().map(get).collect();
    all.push("GET /api/runs HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".to_owned());
    all.extend([
        "GET http://evil.example/api/runs HTTP/1.1\r\nHost: evil.example\r\n\r\n".to_owned(),
        format!("POST /api/runs HTTP/1.1\r\n{token}Content-Length: 999999999\r\n\r\n"),
        format!("POST / HTTP/1.1\r\n{token}Transfer-Encoding: chunked\r\n\r\nffffffff\r\n{long}"),
        "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_owned(),
        "\u{16}\u{3}\u{1} not a request".to_owned(),
    ]);
    all
}

/// Sends what a client of this number sends, in turns, until `over`: some read no answer, some are slow.
fn pester(viewer: &Viewer, number: usize, requests: &[String], over: &AtomicBool, answers: &AtomicU32) {
    for turn in 0.. {
        if over.load(Ordering::SeqCst) {
            return;
        }
        let request = &requests[(number + 7 * turn) % requests.len()];
        let Ok(mut stream) = TcpStream::connect(&viewer.address) else {
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        stream.set_read_timeout(Some(Duration::from_millis(500))).expect("a timeout");
        match number % 5 {
            // A letter at a time.
            0 => {
                for letter in request.as_bytes().iter().take(40) {
                    if stream.write_all(&[*letter]).is_err() || over.load(Ordering::SeqCst) {
                        break;
                    }
                    std::thread::sleep(Duration::from_millis(100));
                }
            }
            // Follows the run, reads nothing, and hangs up after a while.
            1 => {
                let follow = format!("GET /api/runs/watched/live?token={} HTTP/1.1\r\n\r\n", viewer.token);
                let _ = stream.write_all(follow.as_bytes());
                std::thread::sleep(Duration::from_millis(1500));
            }
            _ => {
                let _ = stream.write_all(request.as_bytes());
                let mut start = [0; 12];
                if stream.read_exact(&mut start).is_ok() {
                    assert!(!start.starts_with(b"HTTP/1.1 500"), "{}", &request[..request.len().min(120)]);
                    answers.fetch_add(1, Ordering::SeqCst);
                }
                std::thread::sleep(Duration::from_millis(50));
            }
        }
    }
}

#[test]
fn a_hundred_clients_that_mean_no_good_neither_end_a_run_nor_change_it() {
    let workshop = Workshop::new();
    let alone = complete(workshop.up("alone", ACTORS, ENVIRONMENTS, FRAMES)).result();
    std::fs::create_dir(workshop.path("runs")).expect("a folder");
    let viewer = Viewer::start(&workshop, &[]);
    let child = start(workshop.up("runs/watched", ACTORS, ENVIRONMENTS, FRAMES));
    let identity = RunFolder::new(workshop.path("runs/watched")).identity();
    wait_until("the run has a folder", || identity.exists());
    let (over, answers, requests) = (AtomicBool::new(false), AtomicU32::new(0), requests(&viewer.token));
    let printed = std::thread::scope(|scope| {
        for number in 0..CLIENTS {
            let (viewer, requests, over, answers) = (&viewer, &requests, &over, &answers);
            scope.spawn(move || pester(viewer, number, requests, over, answers));
        }
        let printed = finish(child);
        over.store(true, Ordering::SeqCst);
        printed
    });
    assert_eq!(printed.result(), alone, "whoever asks, the weights are the same");
    assert_eq!(printed.deaths(), [""; 0], "no process of the run died");
    assert!(answers.load(Ordering::SeqCst) as usize > CLIENTS, "the clients were answered: {answers:?}");
    wait_until("the viewer still answers", || viewer.json("/api/runs")[0]["state"] == "complete");
    let frames = viewer.json("/api/runs/watched/curves")["frames"].as_array().and_then(|all| all.last()?.as_u64());
    assert_eq!(frames, Some(FRAMES));
    assert!(viewer.stop());
}
