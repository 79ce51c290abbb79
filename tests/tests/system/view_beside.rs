//! A viewer that a run starts itself, opened in a browser. `view/tests/http.rs` has clients that mean no good.

use std::net::TcpStream;
use system_tests::{Browser, Workshop, finish, start, wait_until};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 2;

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
        browser.wait_for("document.body.innerText.includes('simulate')");
        assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
    }
    workshop.call(&["stop", "runs/seen"]).good();
    assert!(finish(child).success, "the run was saved");
    wait_until("the viewer has ended with its run", || TcpStream::connect(host).is_err());
}
