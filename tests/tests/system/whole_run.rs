//! A run from start to end: budget, summary, recording, replay, and nothing left behind.

use system_tests::{TINY, Workshop, complete};

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

    workshop.call(&["replay", "--check", "run"]).good();

    let images = workshop.path("images");
    let drawn = "replay run --images images --format png --environment 1/0 --episode 0";
    let replay = workshop.call(&drawn.split(' ').collect::<Vec<_>>()).good();
    assert!(walk(&images).iter().any(|path| path.extension().is_some_and(|end| end == "png")), "{replay:#?}");

    let stills = "kitchen-01-environment-0-episode-000000-";
    assert!(walk(&images).iter().all(|path| path.to_str().unwrap().contains(stills)), "{replay:#?}");

    let status = workshop.call(&["status", "run"]);
    assert!(status.stdout.contains("recordings: 1 file, "), "{status:#?}");
    assert!(!status.stdout.contains("\nstage I"), "it is in no stage any more: {status:#?}");

    let again = complete(workshop.resume("run"));
    assert_eq!(again.result(), printed.result(), "a complete run only prints its summary again");
}

/// Somebody who types `orchestrator up` on a CPU has a report with results and a picture.
#[test]
fn the_demonstration_ends_with_a_test_that_its_report_shows() {
    let workshop = Workshop::new();
    let shape = ["--frames", "60", "--actors", "2", "--envs-per-actor", "1", "--run", "demo"];
    let mut command = workshop.orchestrator(&[&["up"][..], &shape].concat());
    // Also on a machine with a GPU.
    command.env("CUDA_VISIBLE_DEVICES", "");
    let printed = complete(command);
    assert_eq!(printed.result().1, 60, "the last lines of standard output are the run's");
    assert!(printed.stderr.contains("30 episodes"), "{printed:#?}");
    let report = workshop.call(&["report", "demo"]);
    assert!(
        report.stdout.contains("in brackets, 95% intervals. SR, SRwoD: Wilson's over 30 episodes alone\n"),
        "{report:#?}"
    );
    assert!(!report.stdout.contains("1 group"), "one run is one group: {report:#?}");
    assert!(
        report.stdout.starts_with("demo  test, novel objects, drawn episodes  1 seed  30 episodes  SR "),
        "{report:#?}"
    );
    let status = workshop.call(&["status", "demo", "--json"]).json();
    assert_eq!(status["evaluations"][0]["state"], "complete", "{status:#}");
    let status = workshop.call(&["status", "demo"]).good().stdout;
    assert!(status.contains("\nevaluations, with the figures of their episodes:\ndemo/evaluations/"), "{status}");
    let page = std::fs::read_to_string(workshop.path("demo/report/report.html")).unwrap();
    assert!(page.contains("data:image/png;base64,"), "its best episode, in pictures");
}

/// A file of weights (here another run's checkpoint: our own names) makes a run that trains on from them.
#[test]
fn a_run_trains_on_from_imported_weights() {
    let workshop = Workshop::new();
    for (name, reward) in [("one", "r"), ("two", "r_prime")] {
        let stage = format!("{TINY}\n[[stages]]\nname = \"{name}\"\nreward = \"{reward}\"\nframes = 60\n");
        std::fs::write(workshop.path(&format!("{name}.toml")), stage).unwrap();
    }
    // Run folders whose names begin with a dash, which no process may take for a flag.
    let options = |run: &'static str, config: &'static str| {
        ["--preset", "demo", "--config", config, run, "--seed", "5", "--actors", "1", "--envs-per-actor", "2"]
    };
    let first = workshop.call(&[&["up"][..], &options("--run=-one", "one.toml")].concat()).result();
    let checkpoints = walk(&workshop.path("-one/checkpoints"));
    let newest = checkpoints.iter().filter(|path| path.extension().is_some_and(|end| end == "safetensors")).max();
    let newest = newest.expect("a complete run has a checkpoint").to_str().unwrap();

    let imported = workshop.call(&[&["import", newest][..], &options("--run=-two", "two.toml")].concat());
    assert!(imported.success && imported.stdout.ends_with(&format!("weights: {}\n", first.0)), "{imported:#?}");
    let second = complete(workshop.resume("./-two")).result();
    assert_eq!(second.1, 60);
    assert_ne!(second.0, first.0);
    workshop.run("-two").assert_nothing_left();

    let options = [&["import", "one.toml"][..], &options("--run=-three", "two.toml")].concat();
    workshop.call(&options).refused("one.toml");
    assert!(!workshop.path("-three").exists(), "nothing is left of a run that never began");
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
