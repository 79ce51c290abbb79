//! The server as clients meet it, friendly and not: over real connections, with runs that are made up and a simulator
//! that is a shell script.

use proptest::prelude::*;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::replay::{RecordedEpisode, ReplaySetup};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use view::data::{
    Card, Curves, EpisodeKey, EpisodePage, EpisodeQuery, Film, Live, Made, Pairs, Problem, Recorded, Runs, Source,
    SuiteRun,
};
use view::{Settings, serve};

/// What a request shows that has the server's token.
const TOKEN: &str = "Authorization: Bearer 0123abcd\r\n";

/// An edition of curves that are eight megabytes long: more than waits in a connection that nobody reads.
const LARGE: u64 = 99;

/// One run called `a`; and how many readings there were, at a time and in all.
#[derive(Default)]
struct One {
    reading: AtomicUsize,
    most: AtomicUsize,
    all: AtomicUsize,
}

impl One {
    fn read<T>(&self, run: &str, value: T) -> Result<T, Problem> {
        let now = self.reading.fetch_add(1, Ordering::SeqCst) + 1;
        self.most.fetch_max(now, Ordering::SeqCst);
        self.all.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(Duration::from_millis(5));
        self.reading.fetch_sub(1, Ordering::SeqCst);
        match run {
            "a" => Ok(value),
            "broken" => Err(Problem::Unreadable("run.toml is damaged".to_owned())),
            "long" => Err(Problem::NotYet("the recordings are still being read: 46%".to_owned())),
            _ => Err(Problem::NotThere(format!("there is no run called {run}"))),
        }
    }
}

impl Runs for One {
    fn list(&self) -> Vec<Card> {
        self.read("a", vec![Card { id: "a".to_owned(), ..Card::default() }]).unwrap_or_default()
    }
    fn live(&self, run: &str) -> Result<Live, Problem> {
        self.read(run, Live { rollouts: 7, ..Live::default() })
    }
    fn curves(&self, run: &str, edition: u64, known: usize) -> Result<Curves, Problem> {
        let frames = if edition == LARGE { vec![u64::MAX; 400_000] } else { Vec::new() };
        self.read(run, Curves { from: known, frames, ..Curves::default() })
    }
    fn episodes(&self, run: &str, query: &EpisodeQuery) -> Result<EpisodePage, Problem> {
        self.read(run, EpisodePage { total: query.offset, ..EpisodePage::default() })
    }
    fn pairs(&self, [run, _]: [&str; 2]) -> Result<Pairs, Problem> {
        self.read(run, Pairs::default())
    }
    fn recorded(&self, run: &str, key: EpisodeKey) -> Result<Recorded, Problem> {
        let kitchen = KitchenId::new(key.kitchen).map_err(|error| Problem::NotThere(error.to_string()))?;
        let episode = RecordedEpisode {
            environment: EnvironmentId { kitchen, number: key.environment },
            episode: key.episode,
            start_hash: None,
            actions: Vec::new(),
            hashes: Vec::new(),
            digests: Vec::new(),
            start: Vec::new(),
        };
        let setup = ReplaySetup { config: String::new(), folder: None, images: None };
        let made = Made { number: 7, reward: Some("r_prime".to_owned()), elsewhere: false, film: None, filmed: false };
        self.read(run, Recorded { source: Source::Actions { setup, episode: Box::new(episode) }, made })
    }
    fn newest(&self, run: &str, kitchen: u32, environment: u32) -> Result<Option<EpisodeKey>, Problem> {
        self.read(run, Some(EpisodeKey { kitchen, environment, episode: 1 }))
    }
    fn report(&self, run: &str) -> Result<String, Problem> {
        // Somebody has put a script into it.
        self.read(
            run,
            view::page::report("{\"seeds\":7}", "an older page").replace("<style>", "<script>alert(1)</script><style>"),
        )
    }
    fn suite(&self, run: &str) -> Result<Vec<SuiteRun>, Problem> {
        self.read(run, vec![SuiteRun { name: "b".to_owned(), state: "waiting", reason: None }])
    }
    fn film(&self, run: &str, key: EpisodeKey) -> Result<Film, Problem> {
        self.read(run, Film { kind: "video/mp4", bytes: key.to_string().into_bytes() })
    }
}

/// A simulator: opens the episode 1-0-99; others not until it is asked to, then draws `PNG!`; dies when step 13 is drawn, talks nonsense at
/// step 14, and never ends with step 15.
const SIMULATOR: &str = r#"#!/bin/sh
open=
while read -r line; do
  case "$line" in
    *'"step":13'*) exit 3 ;;
    *'"step":14'*) echo nonsense ;;
    *'"step":15'*) exec sleep 3600 ;;
    *'"open"'*'"a/1-0-99"'*) echo '{"opened":{"task":{"channels":[],"rewards":[],"weights":{},"metrics":[],"successes":[]},"target":null,"outcome":"failure","figures":{},"goal_tolerance_m":0.5,"orbit":{"centre_m":[0,0,0],"radius_m":1,"yaw_rad":0,"pitch_rad":0},"plan_centre_m":[0,0],"plan_half_m":[1,1],"black_m":1,"moments":[],"things":[],"compared":0,"first_difference":null}}' ;;
    *'"open"'*) open=yes; echo '{"picture":{"bytes":0}}' ;;
    *) if [ "$open" ]; then printf '{"picture":{"bytes":4}}\nPNG!'; else echo '"not_open"'; fi ;;
  esac
done
"#;

struct Server {
    address: SocketAddr,
    runs: Arc<One>,
    _runtime: tokio::runtime::Runtime,
    _folder: tempfile::TempDir,
}

impl Server {
    fn start() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let actor = folder.path().join("actor");
        std::fs::write(&actor, SIMULATOR).expect("a writable folder");
        std::fs::set_permissions(&actor, std::fs::Permissions::from_mode(0o755)).expect("a file of ours");
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().expect("a runtime");
        let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).expect("a free port");
        let address = listener.local_addr().expect("an address");
        let runs = Arc::new(One::default());
        let (token, open) = ("0123abcd".to_owned(), vec!["a".to_owned()]);
        let settings = Settings { play: None, speed: None, actor, token, open, compare: false, program: "stillroom" };
        runtime.spawn(serve(listener, Arc::clone(&runs) as Arc<dyn Runs>, settings, std::future::pending()));
        Self { address, runs, _runtime: runtime, _folder: folder }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).expect("the server listens");
        stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a timeout");
        stream
    }

    /// So many clients that have sent this.
    fn clients(&self, count: usize, request: &str) -> Vec<TcpStream> {
        let mut streams: Vec<_> = (0..count).map(|_| self.connect()).collect();
        for stream in &mut streams {
            stream.write_all(request.as_bytes()).expect("the server listens");
        }
        streams
    }

    /// Sends these bytes; everything that comes back until the server hangs up.
    fn send(&self, bytes: &[u8]) -> Vec<u8> {
        let mut stream = self.connect();
        // The server may hang up before it has read all.
        let _ = stream.write_all(bytes);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    /// Asks as one who shows nothing else than these headers.
    fn ask(&self, method: &str, path: &str, headers: &str) -> Answer {
        let request =
            format!("{method} {path} HTTP/1.1\r\nHost: {}\r\n{headers}Connection: close\r\n\r\n", self.address);
        Answer::of(&self.send(request.as_bytes()))
    }

    fn get(&self, path: &str) -> Answer {
        self.ask("GET", path, TOKEN)
    }
}

#[derive(Debug)]
struct Answer {
    status: u16,
    head: String,
    body: String,
}

impl Answer {
    fn of(bytes: &[u8]) -> Self {
        let text = String::from_utf8_lossy(bytes);
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        Self { status, head: head.to_ascii_lowercase(), body: body.to_owned() }
    }
}

#[test]
fn the_page_and_all_that_it_names_is_there_under_a_strict_policy() {
    let server = Server::start();
    let page = server.get("/");
    assert_eq!(page.status, 200);
    let (mut wanted, mut seen) = (vec!["/main.js".to_owned(), "/style.css".to_owned(), "/icon.svg".to_owned()], vec![]);
    for file in &wanted {
        assert!(page.body.contains(&format!("\"{file}\"")), "the page names {file}");
    }
    while let Some(path) = wanted.pop() {
        let file = server.get(&path);
        assert_eq!(file.status, 200, "{path}");
        assert!(file.head.contains("content-security-policy: default-src 'none'; script-src 'self';"), "{path}");
        assert!(file.head.contains("x-content-type-options: nosniff"), "{path}");
        assert!(!file.body.contains("innerHTML") && !file.body.contains("eval("), "{path} makes markup of text");
        assert!(!file.body.contains("https://"), "{path} names another server");
        seen.push(path);
        for import in file.body.lines().filter(|line| line.starts_with("import ")) {
            let name = import.split("\"./").nth(1).and_then(|rest| rest.split('"').next()).unwrap();
            let path = format!("/{name}");
            if !seen.contains(&path) && !wanted.contains(&path) {
                wanted.push(path);
            }
        }
    }
    assert!(seen.len() >= 10, "{seen:?}");
    assert!(server.get("/api/opening").body.contains("\"runs\":[\"a\"]"));
    assert!(server.get("/api/opening").body.contains("\"program\":\"stillroom\""));
}

#[test]
fn an_episode_comes_with_its_number_in_the_table_and_the_reward_of_its_stage() {
    let server = Server::start();
    let episode = server.get("/api/runs/a/episodes/1-0-99");
    assert_eq!(episode.status, 200, "{episode:?}");
    assert!(episode.body.contains("\"outcome\":\"failure\""), "{episode:?}");
    assert!(
        episode.body.ends_with("\"number\":7,\"reward\":\"r_prime\",\"elsewhere\":false,\"filmed\":false}"),
        "{episode:?}"
    );
    let film = server.get("/api/runs/a/episodes/1-0-99/film");
    assert!(film.head.contains("content-type: video/mp4") && film.body == "1-0-99", "{film:?}");
    assert_eq!(server.get("/api/runs/a/episodes/1-0/film").status, 404);
}

/// A report lies in a folder that can be anybody's: no script of theirs runs, and none is answered without the token.
#[test]
fn a_report_is_shown_under_a_policy_of_its_own() {
    let server = Server::start();
    let address = "/api/runs/a/report";
    assert_eq!(server.ask("GET", address, "").status, 401);
    let report = server.ask("GET", &format!("{address}?token=0123abcd"), "");
    assert_eq!(report.status, 200);
    assert!(report.body.contains(">{\"seeds\":7}</script>") && !report.body.contains("alert(1)"), "{report:?}");
    assert!(report.head.contains("content-type: text/html"), "{report:?}");
    let scripts = report.head.split("script-src ").nth(1).and_then(|rest| rest.split(';').next()).unwrap();
    assert!(scripts.split(' ').all(|source| source.starts_with("'sha256-")), "{scripts}");
    assert_eq!(report.head.matches("content-security-policy").count(), 1);
    assert_eq!(server.get("/api/runs/b/report").status, 404);
    assert_eq!(server.get("/api/runs/a/suite").body, "[{\"name\":\"b\",\"state\":\"waiting\",\"reason\":null}]");
}

#[test]
fn a_way_that_leads_nowhere_is_no_way_out() {
    let server = Server::start();
    let strange = [
        "/../../etc/passwd",
        "/..%2f..%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/api/runs/..%2f..%2fetc",
        "/api/runs/../../../etc/passwd",
        "/api/runs/%00",
        "/api/runs/a/episodes/../../../x",
        "/api",
        "/api/runs/",
        "/api/runs/b",
        "/api/runs/a%2f..%2fb",
        "/style.css/",
        "//etc/passwd",
        "/index.html",
        "/api/runs/a/newest/4294967296/0",
        "/api/runs/a/newest/1/x",
        "/api/runs/a/episodes/1-2",
        "/api/runs/a/episodes/x-y-z",
        "/\u{fffd}",
        "/api/runs/a/live/x",
        "/api/runs/a/episodes?limit=-1",
        "/api/runs/a/episodes?kitchen=4294967296",
        "/api/runs/a/episodes?nonsense=1",
        "/api/runs/a/curves?known=-1",
        "/api/runs/a/curves?edition=99999999999999999999999",
        "/api/runs/a/episodes/1-0-0/picture",
        "/api/runs/a/episodes/1-0-0/picture?view=back&step=0&width=64",
        "/api/runs/a/episodes/1-0-0/picture?view=depth&step=-1&width=64",
        "/api/runs/a/episodes/1-0-0/picture?view=orbit&step=1&width=64&radius=NaN",
        "/api/runs/a/episodes/1-0-0/picture?view=orbit&step=1&width=64&yaw=1e99",
    ];
    for path in strange {
        let answer = server.get(path);
        assert!((400..500).contains(&answer.status), "{path}: {answer:?}");
        assert!(!answer.body.contains("root:"), "{path}: {answer:?}");
    }
    assert_eq!(server.get("/api/runs/broken").status, 422, "a damaged run is said to be one");
    assert!(server.get("/api/runs/broken").body.contains("run.toml is damaged"));
    assert_eq!(server.get("/api/runs/broken/live").status, 422);
    let long = server.get("/api/runs/long");
    assert!(long.status == 503 && long.head.contains("\r\nretry-after: 1\r\n"), "{long:?}");
    assert_eq!(server.get("/api/runs/a").status, 200);
}

#[test]
fn requests_that_are_too_large_are_refused_and_do_no_harm() {
    let server = Server::start();
    let long = "x".repeat(200_000);
    for request in [
        format!("GET /{long} HTTP/1.1\r\n{TOKEN}Connection: close\r\n\r\n"),
        format!("GET /api/runs/a/episodes?target={long} HTTP/1.1\r\n{TOKEN}Connection: close\r\n\r\n"),
        format!("GET / HTTP/1.1\r\nX: {long}\r\nConnection: close\r\n\r\n"),
        long.clone(),
    ] {
        let answer = Answer::of(&server.send(request.as_bytes()));
        assert_ne!(answer.status, 200);
        assert!(answer.status == 0 || (400..500).contains(&answer.status), "{answer:?}");
    }
    let many = "a=b&".repeat(5_000);
    assert_eq!(server.get(&format!("/api/runs/a/episodes?{many}")).status, 400);
    assert_eq!(server.get("/api/runs").status, 200);
}

#[test]
fn nothing_of_a_run_is_answered_without_the_token() {
    let server = Server::start();
    let picture = "/api/runs/a/episodes/1-0-0/picture?view=depth&step=1&width=64";
    let routes = ["/api/opening", "/api/runs", "/api/runs/a", "/api/runs/a/live", "/api/runs/a/curves"];
    let routes = routes.into_iter().chain(["/api/runs/a/episodes", "/api/runs/a/episodes/1-0-0", picture]);
    let routes = routes.chain(["/api/runs/a/newest/1/0", "/index.html", "/nowhere", "//"]);
    for path in routes {
        for wrong in [
            "",
            "Authorization: Bearer\r\n",
            "Authorization: Bearer \r\n",
            "Authorization: Bearer 0123abc\r\n",
            "Authorization: Bearer 0123abce\r\n",
            "Authorization: Bearer 0123abcd x\r\n",
            "Authorization: Basic 0123abcd\r\n",
            "Authorization: 0123abcd\r\n",
            "Cookie: stillroom=0123abcd; token=0123abcd\r\n",
            "Referer: http://127.0.0.1/?token=0123abcd\r\n",
        ] {
            let answer = server.ask("GET", path, wrong);
            assert_eq!(answer.status, 401, "{path} {wrong}");
            assert!(answer.head.contains("www-authenticate: bearer") && answer.head.contains("no-referrer"));
            let says_what_to_do = answer.body.contains("run it again and open the one that it prints");
            assert!(says_what_to_do && !answer.body.contains("0123abcd"), "{answer:?}");
        }
        for query in ["token=", "token=0123abce", "token", "Token=0123abcd", "token=0123abcd%20", "x=token=0123abcd"] {
            let join = if path.contains('?') { '&' } else { '?' };
            assert_eq!(server.ask("GET", &format!("{path}{join}{query}"), "").status, 401, "{path} {query}");
        }
    }
    assert_eq!(server.ask("POST", "/api/runs", "").status, 401);
    assert_eq!(server.runs.all.load(Ordering::SeqCst), 0, "no run was read");
    // The page itself is the same for everybody; what it shows it asks for.
    for path in ["/", "/main.js", "/?token=0123abce"] {
        let answer = server.ask("GET", path, "");
        assert!(answer.status == 200 && !answer.head.contains("set-cookie"), "{path}: {answer:?}");
    }
}

#[test]
fn the_token_is_shown_by_a_header_or_by_what_can_set_none_in_the_query() {
    let server = Server::start();
    for header in [TOKEN, "authorization: bearer 0123abcd\r\n"] {
        assert_eq!(server.ask("GET", "/api/runs", header).status, 200);
    }
    assert_eq!(server.ask("HEAD", "/api/runs?token=0123abcd", "").status, 200);
}

#[test]
fn slow_clients_cost_others_nothing_and_are_hung_up_on() {
    let server = Server::start();
    let begun = Instant::now();
    let mut slow = server.clients(60, "GET /api/runs HT");
    let mut silent = slow.pop().expect("sixty");
    let silent = std::thread::spawn(move || {
        let _ = silent.read_to_end(&mut Vec::new());
        begun.elapsed()
    });
    let mut dripping = server.connect();
    let answered = Instant::now();
    assert_eq!(server.get("/api/runs").status, 200);
    assert!(answered.elapsed() < Duration::from_secs(5), "it took {:?}", answered.elapsed());
    // Nor is a letter at a time a way to hold a connection.
    let held = (0..100).find_map(|_| {
        std::thread::sleep(Duration::from_millis(200));
        dripping.write_all(b"x").err().map(|_| begun.elapsed())
    });
    for took in [held.expect("it is hung up on"), silent.join().unwrap()] {
        assert!(took > Duration::from_secs(8) && took < Duration::from_secs(19), "{took:?}");
    }
}

#[test]
fn who_does_not_read_costs_others_nothing_and_is_hung_up_on() {
    let server = Server::start();
    let request = format!("GET /api/runs/a/curves?edition={LARGE} HTTP/1.1\r\n{TOKEN}\r\n");
    let begun = Instant::now();
    let mut deaf = server.clients(40, &request);
    assert_eq!(server.get("/api/runs").status, 200);
    assert!(begun.elapsed() < Duration::from_secs(10), "it took {:?}", begun.elapsed());
    std::thread::sleep(Duration::from_secs(20));
    for stream in &mut deaf {
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        assert!(answer.starts_with(b"HTTP/1.1 200") && answer.len() < 8_000_000, "it is cut off: {}", answer.len());
    }
    // One who reads gets all of it.
    assert!(server.get(&format!("/api/runs/a/curves?edition={LARGE}")).body.len() > 8_000_000);
}

#[test]
fn more_connections_than_there_is_room_for_are_closed_and_make_room_again() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).expect("a limit of one's own can be raised");
    let server = Server::start();
    let idle: Vec<TcpStream> = (0..512).map(|_| server.connect()).collect();
    let refused = server.get("/api/runs");
    assert_eq!(refused.status, 0, "closed without an answer: {refused:?}");
    drop(idle);
    let begun = Instant::now();
    while server.get("/api/runs").status != 200 {
        assert!(begun.elapsed() < Duration::from_secs(10), "there is no room again");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn what_is_no_request_for_a_page_is_no_request() {
    let server = Server::start();
    let ask = |text: &str| Answer::of(&server.send(text.as_bytes())).status;
    for (request, expected) in [
        ("POST /api/runs HTTP/1.1\r\nContent-Length: 99999999999\r\n", 405),
        ("PUT /api/runs HTTP/1.1\r\n", 405),
        ("DELETE / HTTP/1.1\r\n", 405),
        ("CONNECT localhost:80 HTTP/1.1\r\n", 404),
        ("GET /%252e%252e%252fetc%252fpasswd HTTP/1.1\r\n", 404),
    ] {
        assert_eq!(ask(&format!("{request}{TOKEN}Connection: close\r\n\r\n")), expected, "{request}");
    }
    // What is not HTTP/1 is refused or hung up on.
    for request in [
        "GET /api/runs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\n",
        "GET /api/runs HTTP/9.9\r\nHost: localhost\r\n\r\n",
        "GET /api/runs HTTP/1.1\r\nHost: localhost\r\nX: a\u{0}b\r\n\r\n",
        "GET /api/runs/%ff%fe HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n",
        "GET /..\\..\\etc\\passwd HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n",
        "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        "\u{16}\u{3}\u{1}\u{2}\u{0}\u{1}\r\n\r\n",
    ] {
        let status = ask(request);
        assert!(status == 0 || (400..500).contains(&status), "{status}: {request}");
    }
    assert_eq!(server.get("/api/runs").status, 200);
}

#[test]
fn a_hundred_who_watch_cost_one_reader() {
    let server = Server::start();
    let request = format!("GET /api/runs/a/live HTTP/1.1\r\n{TOKEN}\r\n");
    let mut watching = server.clients(100, &request);
    for stream in &mut watching {
        let (mut text, mut block) = (String::new(), [0; 4096]);
        while !text.contains("\"rollouts\":7") {
            let count = stream.read(&mut block).unwrap();
            assert!(count > 0, "hung up on after {text}");
            text.push_str(&String::from_utf8_lossy(&block[..count]));
        }
        assert!(text.to_ascii_lowercase().contains("content-type: text/event-stream"), "{text}");
    }
    let before = server.runs.all.load(Ordering::SeqCst);
    std::thread::sleep(Duration::from_millis(2500));
    let readings = server.runs.all.load(Ordering::SeqCst) - before;
    assert!((1..=4).contains(&readings), "{readings} readings in two and a half seconds");
    assert!(server.runs.most.load(Ordering::SeqCst) <= 9, "readings at a time");
    drop(watching);
    std::thread::sleep(Duration::from_millis(2500));
    let before = server.runs.all.load(Ordering::SeqCst);
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(server.runs.all.load(Ordering::SeqCst), before, "nobody watches: nothing is read");
}

#[test]
fn a_simulator_that_dies_or_talks_nonsense_is_started_again() {
    let server = Server::start();
    let picture =
        |step: u32| server.get(&format!("/api/runs/a/episodes/1-0-0/picture?view=depth&step={step}&width=64"));
    let drawn = picture(1);
    assert_eq!((drawn.status, drawn.body.as_str()), (200, "PNG!"));
    assert!(drawn.head.contains("content-type: image/png"));
    for bad in [13, 14] {
        let failed = picture(bad);
        assert_eq!(failed.status, 500, "step {bad}: {failed:?}");
        assert!(failed.body.contains("the simulator cannot be used"));
        assert_eq!(picture(2).body, "PNG!", "after step {bad}");
    }
    let unknown = server.get("/api/runs/b/episodes/1-0-0");
    assert_eq!(unknown.status, 404);
    assert_eq!(server.get("/api/runs/a/episodes/77-0-0").status, 404, "no such kitchen");
    assert_eq!(server.get("/api/runs/long/episodes/1-0-0").status, 503, "a page asks again, with a bound");
}

#[test]
fn what_may_come_later_holds_up_nothing_that_is_looked_at() {
    let server = Server::start();
    let mut thumbnail = server.connect();
    let path = "/api/runs/a/episodes/1-0-0/picture?view=depth&step=15&width=64&later=true";
    write!(thumbnail, "GET {path} HTTP/1.1\r\nHost: {}\r\n{TOKEN}\r\n", server.address).expect("the server reads");
    thumbnail.set_read_timeout(Some(Duration::from_millis(500))).expect("a timeout");
    assert!(thumbnail.read(&mut [0]).is_err(), "it is still drawn");
    assert_eq!(server.get("/api/runs/a/episodes/1-0-0/picture?view=depth&step=1&width=64").body, "PNG!");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]
    #[test]
    fn whatever_is_sent_the_next_is_answered(
        bytes in prop::collection::vec(any::<u8>(), 0..400),
        path in "[ -~]{0,80}",
    ) {
        use std::sync::OnceLock;
        static SERVER: OnceLock<Server> = OnceLock::new();
        let server = SERVER.get_or_init(Server::start);
        let mut stream = server.connect();
        let _ = stream.write_all(&bytes);
        drop(stream);
        let mut stream = server.connect();
        let _ = stream.write_all(format!("GET /{path} HTTP/1.1\r\n{TOKEN}Connection: close\r\n\r\n").as_bytes());
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        prop_assert!(!(500..600).contains(&Answer::of(&answer).status), "{}", String::from_utf8_lossy(&answer));
        prop_assert_eq!(server.get("/api/opening").status, 200);
    }
}
