//! `orchestrator view` beside real runs: what it tells is what the files hold, and the run is the same with it.

use proto::run_folder::RunFolder;
use rustix::process::Signal;
use serde_json::Value;
use std::path::Path;
use system_tests::{Viewer, Workshop, complete, finish, signal, start, wait_until};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 2;
const FRAMES: u64 = 600;

fn recording(folder: &RunFolder) -> std::path::PathBuf {
    let mut files = std::fs::read_dir(folder.recordings()).expect("recordings").flatten().map(|entry| entry.path());
    files.next().expect("a recording")
}

fn is_png(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG\r\n\x1a\n") && bytes.len() > 500
}

#[test]
fn a_run_is_shown_while_it_trains_and_trains_as_if_nobody_looked() {
    let workshop = Workshop::new();
    let alone = complete(workshop.up("alone", ACTORS, ENVIRONMENTS, FRAMES)).result();
    std::fs::create_dir(workshop.path("runs")).expect("a folder");
    let viewer = Viewer::start(&workshop, &[]);
    assert_eq!(viewer.json("/api/runs"), serde_json::json!([]));

    let child = start(workshop.up("runs/watched", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("runs/watched");
    run.wait_for_rollouts(2);
    // On a busy machine the run would end, and its processes with it, before they are listed.
    let actor = run.processes("--actor 1 ")[0];
    signal(actor, Signal::STOP);
    wait_until("it is in the list", || viewer.json("/api/runs").as_array().is_some_and(|runs| !runs.is_empty()));
    let live = viewer.json("/api/runs/watched");
    assert_eq!(live["card"]["budget"], FRAMES);
    let names: Vec<&str> =
        live["workers"].as_array().expect("a list").iter().filter_map(|one| one["name"].as_str()).collect();
    for name in ["learner-0", "actor-00", "actor-01"] {
        assert!(names.contains(&name), "{names:?}");
    }
    signal(actor, Signal::CONT);
    assert_eq!(finish(child).result(), alone, "whoever looks, the weights are the same");

    wait_until("it is known to be complete", || viewer.json("/api/runs")[0]["state"] == "complete");
    let curves = viewer.json("/api/runs/watched/curves");
    let frames: Vec<u64> = run.metrics().values().filter_map(|line| line["frames"].as_u64()).collect();
    assert_eq!(curves["frames"], serde_json::json!(frames));
    let newer =
        viewer.json(&format!("/api/runs/watched/curves?edition={}&known={}", curves["edition"], frames.len() - 1));
    assert_eq!(
        (newer["from"].as_u64(), newer["frames"].as_array().map(Vec::len)),
        (Some(frames.len() as u64 - 1), Some(1))
    );
    assert_eq!(curves["series"]["episode/success"].as_array().map(Vec::len), Some(frames.len()));

    every_episode_is_in_the_table(&viewer, &workshop);
    let row = &viewer.json("/api/runs/watched/episodes?recorded=true&sort=length&descending=true")["rows"][0];
    let address = format!("/api/runs/watched/episodes/{}", row["key"].as_str().expect("a key"));
    let shown = viewer.json(&address);
    let moments = shown["moments"].as_array().expect("moments");
    assert_eq!(
        (moments.len() as u64, &shown["first_difference"]),
        (row["length"].as_u64().expect("a length") + 1, &Value::Null)
    );
    assert_eq!(shown["compared"].as_u64(), Some(moments.len() as u64), "the start and each step");
    assert_eq!(shown["outcome"], row["outcome"]);
    assert_eq!(shown["target"], row["target"]);
    let last = &moments[moments.len() - 1];
    assert_eq!(last["channels"]["disturbance_m"][0], row["figures"]["disturbance_m"]);
    let picture = |query: &str| viewer.get(&format!("{address}/picture?{query}"));
    let one = picture("view=depth&step=0&width=64");
    assert!(one.status == 200 && is_png(&one.body));
    let orbit =
        |yaw: &str| picture(&format!("view=orbit&step=1&width=120&height=90&y=0.8&radius=2&pitch=0.8&yaw={yaw}"));
    let (before, after) = (orbit("0"), orbit("1.5"));
    assert!(is_png(&before.body) && is_png(&after.body) && before.body != after.body, "the camera turns");
    assert_eq!(picture("view=depth&step=100000&width=64").status, 422);
    assert_eq!(picture("view=depth&step=0&width=100000").status, 422);
    let newest = viewer.json(&format!("/api/runs/watched/newest/{}/{}", row["kitchen"], row["environment"]));
    assert!(viewer.get(&format!("/api/runs/watched/episodes/{}", newest.as_str().expect("a key"))).status == 200);
    assert!(viewer.stop(), "an interrupt is an orderly end");
}

/// Each recorded end is a row; of training and of nothing else.
fn every_episode_is_in_the_table(viewer: &Viewer, workshop: &Workshop) {
    let summary = workshop.json("runs/watched/summary.json");
    let stages = summary["stages"].as_array().expect("stages");
    let episodes: u64 = stages.iter().filter_map(|stage| stage["whole"]["episodes"].as_u64()).sum();
    wait_until("all recordings are read", || {
        viewer.json("/api/runs/watched/episodes")["total"].as_u64() == Some(episodes)
    });
    let page = viewer.json("/api/runs/watched/episodes?limit=500&sort=kitchen");
    let rows = page["rows"].as_array().expect("rows");
    assert_eq!(rows.len() as u64, episodes.min(500));
    let keys: std::collections::BTreeSet<&str> = rows.iter().filter_map(|row| row["key"].as_str()).collect();
    assert_eq!(keys.len(), rows.len(), "each once, and each can be simulated");
    let one_kitchen = viewer.json(&format!("/api/runs/watched/episodes?kitchen={}&limit=500", rows[0]["kitchen"]));
    let matching = rows.iter().filter(|row| row["kitchen"] == rows[0]["kitchen"]).count();
    assert_eq!(one_kitchen["matching"].as_u64(), Some(matching as u64));
}

/// Changes a file's bytes.
fn damage(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = std::fs::read(path).expect("a file");
    change(&mut bytes);
    std::fs::write(path, bytes).expect("writable");
}

#[test]
fn a_damaged_run_is_shown_as_far_as_it_goes_and_harms_no_other() {
    let workshop = Workshop::new();
    complete(workshop.up("runs/sound", ACTORS, ENVIRONMENTS, 300)).result();
    let copy = |name: &str| workshop.copy("runs/sound", name).folder;
    damage(&copy("runs/identity").identity(), |bytes| bytes.truncate(20));
    damage(&copy("runs/configuration").config(), |bytes| bytes.extend_from_slice(b"\n[nonsense]\nx = 1\n"));
    damage(&copy("runs/figures").metrics(), |bytes| bytes[10..40].fill(b'#'));
    let bent = copy("runs/bent");
    let middle = |bytes: &mut Vec<u8>| {
        let middle = bytes.len() / 2;
        bytes[middle..middle + 64].fill(0xa5);
    };
    damage(&recording(&bent), middle);
    damage(&recording(&copy("runs/cut")), |bytes| bytes.truncate(bytes.len() * 2 / 3));
    damage(&recording(&copy("runs/empty")), Vec::clear);
    damage(&recording(&copy("runs/foreign")), |bytes| bytes[..8].fill(0));
    std::fs::remove_dir_all(copy("runs/bare").recordings()).expect("a folder");

    let viewer = Viewer::start(&workshop, &["runs"]);
    let list = viewer.json("/api/runs");
    let of =
        |name: &str| list.as_array().and_then(|all| all.iter().find(|run| run["id"] == name)).expect("listed").clone();
    assert_eq!(list.as_array().map(Vec::len), Some(9));
    assert!(
        of("identity")["problem"].as_str().is_some_and(|problem| problem.contains("run.toml")),
        "{}",
        of("identity")
    );
    assert!(of("configuration")["problem"].is_string());
    for name in ["identity", "configuration", "figures", "bent", "cut", "empty", "foreign", "bare", "sound"] {
        for path in ["", "/curves", "/episodes", "/episodes/1-0-0", "/newest/1/0", "/live"] {
            if path == "/live" && !matches!(name, "identity" | "configuration") {
                continue;
            }
            let status = viewer.get(&format!("/api/runs/{name}{path}")).status;
            assert!(matches!(status, 200 | 404 | 422), "{name}{path}: {status}");
        }
    }
    let whole = viewer.json("/api/runs/sound/episodes")["total"].as_u64().expect("a number");
    for name in ["bent", "cut"] {
        let page = viewer.json(&format!("/api/runs/{name}/episodes"));
        let total = page["total"].as_u64().expect("a number");
        assert!(total > 0 && total <= whole, "{name}: {total} of {whole}");
    }
    let notes = viewer.json("/api/runs/bent/episodes")["notes"].to_string();
    assert!(notes.contains("orchestrator recover"), "{notes}");
    assert!(viewer.json("/api/runs/figures")["notes"].to_string().contains("damaged line"));
    assert_eq!(viewer.json("/api/runs/sound")["notes"], serde_json::json!([]));
    assert!(viewer.stop());
}

#[test]
fn what_cannot_be_shown_is_an_error_that_says_what_to_do() {
    let workshop = Workshop::new();
    for (arguments, expected) in [
        (&["view"][..], "there is no folder runs/ here"),
        (&["view", "nowhere"], "nowhere is not a folder"),
        (&["view", "."], "there is no run in ."),
        (&["view", "--compare", ".", "."], "there is no run in ."),
    ] {
        let printed = workshop.call(arguments);
        assert!(!printed.success && printed.stderr.contains(expected), "{arguments:?}: {}", printed.stderr);
    }
    std::fs::create_dir(workshop.path("runs")).expect("a folder");
    let viewer = Viewer::start(&workshop, &[]);
    let port = viewer.address.rsplit_once(':').expect("a port").1;
    workshop.call(&["view", "--port", port]).refused("choose another port with --port");
}
