//! A policy in a file of its own: exported, evaluated without its run, and at work on the viewer's page, which leaves
//! nothing behind however it ends.

use rustix::process::Signal;
use serde_json::Value;
use std::path::{Path, PathBuf};
use system_tests::{Browser, Viewer, Workshop, complete, wait_for, wait_until};

const FILE: &str = "small.safetensors";
const FRAMES: u64 = 200;

/// A workshop with a policy file in it, whose run is gone.
fn with_policy() -> Workshop {
    let workshop = Workshop::new();
    complete(workshop.up("runs/small", 2, 2, FRAMES)).result();
    let export = ["export", "runs/small", "--format", "safetensors", "--half", "--out", FILE];
    let exported = workshop.call(&export);
    assert!(exported.success && exported.stdout.contains("after 200 frames"), "{exported:?}");
    std::fs::remove_dir_all(workshop.path("runs")).expect("a run of ours");
    workshop
}

fn play(workshop: &Workshop, options: &[&str]) -> Viewer {
    Viewer::of(workshop.orchestrator(&[&["play", FILE, "--no-open", "--port", "0"], options].concat()))
}

/// The temporary folder of a viewer that plays.
fn folder_of(viewer: &Viewer) -> PathBuf {
    let list = viewer.json("/api/runs");
    let folder = Path::new(list[0]["folder"].as_str().expect("a folder")).parent().expect("a temporary folder");
    assert!(folder.file_name().is_some_and(|name| name.to_string_lossy().starts_with("stillroom-play-")), "{list}");
    folder.to_owned()
}

/// Processes whose command line or whose parent's names this folder.
fn processes_in(folder: &Path) -> usize {
    let folder = folder.display().to_string();
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let lines = entries.filter_map(|entry| std::fs::read(entry.path().join("cmdline")).ok());
    lines.filter(|line| String::from_utf8_lossy(line).contains(&folder)).count()
}

/// The newest evaluation, once its environment has a step; and that step's episode.
fn watched(viewer: &Viewer, place: &str) -> (String, String) {
    wait_for("the policy plays", || {
        let run = viewer.json("/api/runs")[0]["id"].as_str().map(str::to_owned);
        let key = run.as_ref().map(|run| viewer.get(&format!("/api/runs/{run}/newest/{place}")));
        let key = key.filter(|answer| answer.status == 200).and_then(|key| key.json().as_str().map(str::to_owned));
        run.zip(key)
    })
}

#[test]
fn a_policy_file_is_evaluated_without_its_run() {
    let workshop = with_policy();
    let eval = ["eval", FILE, "--split", "test", "--episodes", "1", "--json", "--out", "result"];
    let printed = workshop.call(&eval);
    let result = printed.json();
    let subject = &result["subject"];
    assert_eq!((&subject["run"], subject["frames"].as_u64()), (&Value::Null, Some(FRAMES)));
    let file = workshop.path(FILE).display().to_string();
    assert!(subject["checkpoint"].as_str().is_some_and(|path| path.ends_with(&file)), "{subject}");
    assert_eq!(result["overall"]["episodes"], 5);
    let reported = workshop.call(&["report", "result", "--out", "report"]);
    let said = format!("small.safetensors ({}): a policy file does not say how", "result");
    assert!(reported.success && reported.stderr.contains(&said), "{reported:?}");
    // Exported again it is the same policy; as a model, too.
    for (options, name) in [(&["--half"][..], "again.safetensors"), (&[], "again.onnx")] {
        workshop.call(&[&["export", FILE, "--out", name], options].concat()).good();
    }
    let bytes = |name: &str| std::fs::read(workshop.path(name)).expect("a file");
    assert_eq!(bytes("again.safetensors"), bytes(FILE));
    workshop
        .call(&["export", FILE, "--out", "nowhere/again.onnx"])
        .refused("there is no folder nowhere: make it first");
    // It has weights alone: a run goes on from a checkpoint.
    workshop.call(&["up", "--preset", "demo", "--config", "tiny.toml", "--from", FILE]).refused("orchestrator import");
}

#[test]
fn a_policy_plays_on_the_page_and_leaves_nothing_behind() {
    let workshop = with_policy();
    let viewer = play(&workshop, &["--kitchen", "7", "--speed", "10"]);
    let (run, key) = watched(&viewer, "7/0");
    assert!(run == "small-1" && key.starts_with("7-0-"), "{run} {key}");
    let plays = viewer.json("/api/opening")["play"].as_str().expect("a policy").to_owned();
    assert!(plays.contains(&format!("{FILE}: preset demo, {FRAMES} frames, weights ")), "{plays}");
    let address = format!("/api/runs/{run}/episodes/{key}");
    let mut shown = Value::Null;
    wait_until("the episode has ended", || {
        shown = viewer.json(&address);
        shown["outcome"] != "unfinished"
    });
    assert!(shown["moments"].as_array().is_some_and(|moments| moments.len() > 1), "{shown}");
    assert_eq!(shown["first_difference"], Value::Null);
    // Figures of this episode, and no other.
    let steps = shown["moments"].as_array().map_or(0, Vec::len) - 1;
    let disturbed = &shown["moments"][steps]["channels"]["disturbance_m"][0];
    let (there, told) = (disturbed.as_f64(), shown["figures"]["disturbance_m"].as_f64());
    assert!(
        there.zip(told).is_some_and(|(there, told)| (there - told).abs() < 1e-6),
        "{disturbed}, {}",
        shown["figures"]
    );
    assert_eq!(
        shown["figures"]["success"].as_f64(),
        Some(f64::from(u8::from(shown["outcome"].as_str().is_some_and(|how| how.starts_with("success")))))
    );
    let frame = |step: u32| viewer.get(&format!("{address}/picture?view=depth&step={step}&width=224"));
    let (first, second) = (frame(0), frame(1));
    assert!([&first, &second].iter().all(|frame| frame.status == 200 && frame.body.starts_with(b"\x89PNG")));
    wait_until("episodes are counted", || viewer.json(&format!("/api/runs/{run}"))["card"]["done"] != 0);
    if let Some(mut browser) = Browser::start() {
        browser.open(&viewer.page());
        browser.wait_for("location.hash === '#/play' && document.querySelector('canvas.orbit')?.dataset.step > 1");
        browser.wait_for("document.querySelector('canvas.depth')?.dataset.step > 1");
        // Whatever is said above the room later, it stays in its place.
        let top = "document.querySelector('canvas.orbit').getBoundingClientRect().top";
        let before = browser.value(top);
        for terms in [&*plays, "sampled actions, novel and seen objects, "] {
            browser.wait_for(&format!("document.querySelector('main').innerText.includes({terms:?})"));
        }
        // Which episode is shown, and what those came to that were shown to their ends.
        browser.wait_for(
            "/Bring the [A-Z].* to its goal[^]*episode \\d+ in kitchen 7/.test(document.querySelector('main').innerText)",
        );
        browser.wait_for(
            "/\\d episodes? ended in kitchen 7, SR \\d.*; you watched \\d to the end, SR \\d/.test(document.querySelector('main').innerText)",
        );
        assert_eq!(browser.value(top), before);
        // The list of all that have ended is one click away.
        browser.wait_for("/^#.run.small-\\d+.episodes$/.test(document.querySelector('main a').hash)");
        if let Some(folder) = std::env::var_os("STILLROOM_SCREENSHOTS") {
            let picture = browser.screenshot();
            std::fs::write(Path::new(&folder).join("play.png"), picture).expect("a folder of pictures");
        }
        // It waits at the space bar, and goes on.
        let button = |word: &str| {
            format!("[...document.querySelectorAll('button')].some((one) => one.textContent === '{word}')")
        };
        browser.press(" ");
        browser.wait_for(&button("Play"));
        browser.wait_for("document.querySelector('main').innerText.includes('the policy plays on')");
        let step = "document.querySelector('[data-episode]').dataset.step";
        // A step that was being shown.
        std::thread::sleep(std::time::Duration::from_secs(1));
        let before = browser.value(step);
        std::thread::sleep(std::time::Duration::from_secs(2));
        assert_eq!(browser.value(step), before, "it is paused");
        browser.press(" ");
        browser.wait_for(&button("Pause"));
        let seen = browser.value("document.querySelector('[data-episode]').dataset.episode");
        let other = format!("document.querySelector('[data-episode]')?.dataset.episode !== {seen}");
        browser.wait_for(&other);
        assert_eq!(browser.complaints, Vec::<String>::new(), "the page's console has no error");
    }
    let folder = folder_of(&viewer);
    assert!(folder.exists() && processes_in(&folder) > 0);
    assert!(viewer.stop());
    assert_eq!((folder.exists(), processes_in(&folder)), (false, 0));
}

#[test]
fn when_all_episodes_are_played_it_begins_again() {
    let workshop = with_policy();
    let viewer = play(&workshop, &["--kitchen", "7", "--speed", "100"]);
    let (first, _) = watched(&viewer, "7/0");
    wait_until("the next round has begun", || {
        let list = viewer.json("/api/runs");
        list[0]["id"].as_str().is_some_and(|id| id.starts_with("small-") && id != first)
    });
    let (next, _) = watched(&viewer, "7/0");
    assert_ne!(next, first);
    assert!(viewer.stop());
}

#[test]
fn whoever_ends_a_viewer_or_its_policy_leaves_nothing_behind() {
    let workshop = with_policy();
    for by in [Signal::TERM, Signal::KILL] {
        let viewer = play(&workshop, &["--kitchen", "8"]);
        watched(&viewer, "8/0");
        let folder = folder_of(&viewer);
        let printed = viewer.end(by);
        assert_eq!(printed.success, by == Signal::TERM, "{printed:?}");
        wait_until("all processes have ended", || processes_in(&folder) == 0);
        wait_until("nothing is left", || !folder.exists());
    }
    // Without its file the next round cannot begin, and the viewer says so.
    let viewer = play(&workshop, &["--kitchen", "8", "--speed", "100"]);
    watched(&viewer, "8/0");
    let folder = folder_of(&viewer);
    std::fs::remove_file(workshop.path(FILE)).expect("a file of ours");
    let printed = viewer.wait();
    printed.refused("the policy does not play");
    assert!(printed.stderr.contains("does not exist"), "{printed:?}");
    assert!(!folder.exists());
}

#[test]
fn what_is_no_policy_is_refused_before_anything_is_started() {
    let workshop = with_policy();
    let whole = std::fs::read(workshop.path(FILE)).expect("a file");
    std::fs::write(workshop.path("cut.safetensors"), &whole[..whole.len() / 2]).expect("a file");
    let mut changed = whole;
    *changed.last_mut().expect("not empty") ^= 0x40;
    std::fs::write(workshop.path("changed.safetensors"), changed).expect("a file");
    std::fs::write(workshop.path("notes.txt"), "fetch").expect("a file");
    for (options, expected) in [
        (&["nowhere.safetensors"][..], "nowhere.safetensors does not exist"),
        (&["cut.safetensors"], "is no safetensors file"),
        (&["changed.safetensors"], "is damaged"),
        (&["notes.txt"], "no policy file (.safetensors)"),
        (&["."], "there is no checkpoint in"),
        (&[FILE, "--kitchen", "28"], "there is no kitchen 28"),
        (&[FILE, "--kitchen", "7", "--split", "test"], "cannot be used with"),
    ] {
        let printed = workshop.call(&[&["play", "--no-open"], options].concat());
        assert!(!printed.success && printed.stderr.contains(expected), "{options:?}: {}", printed.stderr);
    }
}
