//! A run from start to end: budget, summary, recording, replay, and nothing left behind.

use system_tests::{Workshop, complete};

#[test]
fn a_run_ends_on_its_budget_and_its_recording_holds_every_step() {
    let workshop = Workshop::new();
    // 1,003 frames over 6 environments: neither stage is a multiple of a step or of a rollout.
    let printed = complete(workshop.up("run", 2, 3, 1003));
    let (_, frames) = printed.result();
    assert_eq!(frames, 1003);
    let run = workshop.run("run");
    run.assert_nothing_left();

    let recorded = run.recorded();
    assert_eq!(recorded["/step"], 1003, "{recorded:?}");
    assert_eq!(recorded["/learner/metrics"], run.metrics().len() as u64, "{recorded:?}");
    assert!(recorded["/episode/end"] > 0 && recorded["/episode/start"] >= recorded["/episode/end"], "{recorded:?}");
    assert!(recorded["/stage"] >= 2, "both stages begin: {recorded:?}");
    assert!(recorded.keys().any(|topic| topic.starts_with("/depth/")), "{recorded:?}");

    let stages: Vec<u64> = run.metrics().values().map(|line| line["stage"].as_u64().unwrap()).collect();
    assert!(stages.contains(&0) && stages.contains(&1) && stages.is_sorted());

    let replay = complete(workshop.orchestrator(&["replay", "run"]));
    assert!(replay.success, "{replay:#?}");

    let images = workshop.path("images");
    let replay = complete(workshop.orchestrator(&[
        "replay",
        "run",
        "--images",
        images.to_str().unwrap(),
        "--format",
        "png",
        "--limit",
        "1",
    ]));
    assert!(replay.success, "{replay:#?}");
    assert!(walk(&images).iter().any(|path| path.extension().is_some_and(|end| end == "png")), "{replay:#?}");

    let again = complete(workshop.resume("run"));
    assert_eq!(again.result(), printed.result(), "a complete run only prints its summary again");
}

fn walk(folder: &std::path::Path) -> Vec<std::path::PathBuf> {
    let mut found = vec![];
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.path().is_dir() {
            found.extend(walk(&entry.path()));
        } else {
            found.push(entry.path());
        }
    }
    found
}
