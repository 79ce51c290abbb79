//! A suite of real runs: killed and called again, with a run that fails, with a file that is wrong.

use serde_json::Value;
use std::path::Path;
use system_tests::{Run, TINY, Workshop, complete, finish, kill_child, signal, start, tell, wait_until};

/// Two seeds of the tiny configuration and one run more, each evaluated on 30 episodes.
fn suite(workshop: &Workshop, frames: u64, more: &str) {
    let text = format!(
        "seeds = [5, 6]\nframes = {frames}\n\
         [[evaluations]]\nsplit = \"test\"\nobjects = \"novel\"\nepisodes = 6\n\
         [[runs]]\npreset = \"demo\"\nname = \"tiny\"\n{more}\n[config.actors]\ncount = 1\nenvironments_per_actor = 2\n{}",
        TINY.replace("\n[", "\n[config.")
    );
    std::fs::write(workshop.path("suite.toml"), text).expect("a writable temporary folder");
}

fn state(workshop: &Workshop) -> Value {
    workshop.json("all/suite.json")
}

fn call(workshop: &Workshop) -> std::process::Command {
    // Absolute, so that processes can be told by their command lines.
    workshop.orchestrator(&["suite", "suite.toml", "--out", &workshop.path("all").display().to_string()])
}

/// Digest of the weights that a complete run ended with.
fn weights(run: &Path) -> String {
    let text = std::fs::read_to_string(run.join("summary.json")).expect("a complete run");
    let summary: Value = serde_json::from_str(&text).expect("JSON");
    summary["weights"].as_str().expect("a digest").to_owned()
}

fn killed_at(mut command: std::process::Command, point: &str) {
    command.env("STILLROOM_FAULT", point);
    let printed = complete(command);
    assert!(printed.killed, "the point {point} is never reached: {printed:#?}");
}

fn run(workshop: &Workshop, name: &str) -> Run {
    workshop.run(&format!("all/runs/{name}"))
}

/// By the commands that take a suite; the others say what to give them.
fn a_finished_suite_is_shown(workshop: &Workshop) {
    let listed = workshop.call(&["status", "all"]).good();
    assert!(listed.stdout.starts_with("suite all: 3 of 3 runs complete\n"), "{listed:#?}");
    assert!(listed.stdout.contains("\ntiny-5 ") && listed.stdout.contains("complete"), "{listed:#?}");
    assert!(listed.stdout.contains("\n  suite-test-novel-6  ") && listed.stdout.contains("all/runs\n"), "{listed:#?}");
    let compared = workshop.call(&["compare", "all", "--json"]).json();
    let columns = ["all/runs/tiny-5", "all/runs/tiny-6", "all/runs/after-5", "all/runs/tiny, mean of 2"];
    assert_eq!(compared["runs"], serde_json::json!(columns));
    assert_eq!(workshop.call(&["stop", "all"]).good().stderr, "all does not run\n");
    for command in ["replay", "eval", "resume", "logs", "play"] {
        let printed = workshop.call(&[command, "all"]);
        printed.refused("all is the folder of a suite: give one of its runs (such as all/runs/after-5; ");
        assert_eq!(printed.status, Some(2), "{command}");
    }
    // One of its runs would be shown.
    workshop.call(&["top", "all"]).refused("top needs a terminal");
}

#[test]
fn a_run_that_could_not_begin_is_refused_with_the_file() {
    let workshop = Workshop::new();
    for (run, problem) in [
        ("preset = \"gym\"", "gym-1: preset gym needs an environment of your own, which a suite cannot name"),
        ("preset = \"demo\"\nconfig.scenes = [\"gone.toml\"]", "demo-1: scene gone.toml cannot be used"),
    ] {
        std::fs::write(workshop.path("suite.toml"), format!("seeds = [1]\n[[runs]]\n{run}\n")).expect("a file");
        let printed = workshop.call(&["suite", "suite.toml", "--check"]);
        printed.refused(problem);
        assert_eq!((printed.status, printed.stdout.as_str()), (Some(2), ""), "{printed:#?}");
    }
}

#[test]
fn killed_at_any_time_it_goes_on_and_ends_in_the_report() {
    let workshop = Workshop::new();
    suite(&workshop, 900, "[[runs]]\npreset = \"demo\"\nname = \"after\"\nfrom = \"tiny\"\nseeds = [5]");
    let checked = workshop.call(&["suite", "suite.toml", "--check", "--json"]).json();
    let names: Vec<_> = checked["runs"].as_array().expect("runs").iter().map(|run| &run["name"]).collect();
    assert_eq!(names, ["tiny-5", "tiny-6", "after-5"]);
    // Killed before its folder can be known for a suite's, just before it starts its first process, and just after.
    for point in ["suite.before_file", "suite.before_process", "suite.after_process"] {
        killed_at(call(&workshop), point);
    }
    // Killed while the first run trains: its processes save and leave by themselves.
    let child = start(call(&workshop));
    let first = run(&workshop, "tiny-5");
    first.wait_for_rollouts(4);
    complete(call(&workshop)).refused("already in use");
    kill_child(child);
    assert_eq!(state(&workshop)["runs"]["tiny-5"]["status"], "training");
    let standing = workshop.call(&["status", "all"]).good();
    assert!(standing.stdout.starts_with("suite all: 0 of 3 runs complete, 2 waiting, 1 cut off\n"), "{standing:#?}");
    workshop.call(&["resume", "all"]).refused("orchestrator suite all/suite.toml --out all` goes on with it");
    first.assert_nothing_left();
    assert!(!first.folder.summary().exists(), "the run was killed in its middle");

    // Killed while it evaluates.
    let child = start(call(&workshop));
    let evaluation = first.folder.root().join("evaluations/suite-test-novel-6");
    wait_until("the evaluation begins", || evaluation.join("run.toml").exists());
    kill_child(child);
    assert!(!evaluation.join("evaluation.json").exists(), "the evaluation was killed in its middle");

    // Something damages its file of states: the message says what to do, and that is right.
    let states = workshop.path("all/suite.json");
    std::fs::write(&states, "{").expect("a writable file");
    complete(call(&workshop)).refused("suite.json is damaged (delete it");
    std::fs::remove_file(&states).expect("a damaged file to delete");

    // Two signals at once would be one: somebody presses the keys until it is over.
    let mut child = start(call(&workshop));
    let second = run(&workshop, "tiny-6");
    second.wait_for_rollouts(2);
    let mut status = None;
    wait_until("the suite ends", || {
        signal(child.id(), rustix::process::Signal::INT);
        status = child.try_wait().expect("a status");
        status.is_some()
    });
    assert_eq!(status.and_then(|status| status.code()), Some(130));
    second.assert_nothing_left();

    // Stopped in an orderly way while the second trains: before the first is evaluated, if the processes of the killed
    // evaluation still leave, which holds up nobody; after it otherwise.
    let child = start(call(&workshop));
    second.wait_for_rollouts(4);
    let stopped = workshop.call(&["stop", "all"]).good();
    assert!(stopped.stdout.starts_with("suite all: ") && stopped.stdout.contains("1 stopped"), "{stopped:#?}");
    let printed = finish(child);
    assert!(printed.success && printed.stderr.contains("orchestrator suite suite.toml --out "), "{printed:#?}");
    assert!(!second.folder.summary().exists(), "the second run was stopped in its middle");
    second.assert_nothing_left();

    // Killed when all is done but the last file of the report.
    killed_at(call(&workshop), "report.before_page");
    assert!(!workshop.path("all/report/report.html").exists());
    let printed = complete(call(&workshop)).good();
    for name in ["tiny-5", "tiny-6", "after-5"] {
        let mut lines = printed.stdout.lines().skip_while(|line| !line.starts_with(name));
        assert!(lines.next().expect("a line for each run").contains("  complete  "), "{printed:#?}");
        let line = lines.next().expect("a line for its evaluation");
        assert!(line.starts_with("  suite-test-novel-6  complete") && line.contains("SRwoD "), "{line}");
    }
    assert!(printed.stdout.contains("\ncompare     ") && printed.stdout.contains(" compare "), "{printed:#?}");
    let done = state(&workshop);
    a_finished_suite_is_shown(&workshop);
    for name in ["tiny-5", "tiny-6", "after-5"] {
        assert_eq!(done["runs"][name]["status"], "done", "{done:#}");
    }
    assert!(evaluation.join("evaluation.json").exists());
    // No kill changed a bit.
    let undisturbed = complete(workshop.up("undisturbed", 1, 2, 900)).result().0;
    assert_eq!(weights(first.folder.root()), undisturbed);
    assert_ne!(weights(second.folder.root()), undisturbed, "another seed");
    let after = std::fs::read_to_string(run(&workshop, "after-5").folder.config()).expect("a configuration");
    assert!(after.contains("[from]") && after.contains(&undisturbed), "{after}");

    let page = std::fs::read_to_string(workshop.path("all/report/report.html")).expect("a page");
    assert!(page.contains("<td>test-novel"), "what was evaluated stands in the page without scripts, too");
    // Done is done: nothing is started again.
    let tries = |state: &Value| state["runs"]["tiny-5"]["tries"].clone();
    assert!(complete(call(&workshop)).success);
    assert_eq!(tries(&state(&workshop)), tries(&done));
}

#[test]
fn a_run_that_fails_is_said_and_tried_again_and_holds_up_nobody() {
    let workshop = Workshop::new();
    // No test machine has this; where one does, the run is like any other and the test says so.
    let gpu = "[[runs]]\npreset = \"demo\"\nname = \"gpu\"\nseeds = [5]\nconfig.learner.device = \"cuda\"";
    let after = "[[runs]]\npreset = \"demo\"\nname = \"after\"\nseeds = [5]\nfrom = \"gpu\"";
    suite(&workshop, 300, &format!("{gpu}\n{after}"));
    let printed = complete(call(&workshop));
    if state(&workshop)["runs"]["gpu-5"]["status"] == "done" {
        tell("skipped: this machine has a CUDA device");
        return;
    }
    printed.refused("gpu-5 failed: learner.device = \"cuda\"");
    let after = state(&workshop);
    assert_eq!(after["runs"]["gpu-5"]["status"], "failed");
    let reason = after["runs"]["after-5"]["reason"].as_str().expect("a reason");
    assert!(reason.contains("gpu-5 is not trained"), "{reason}");
    assert!(!workshop.path("all/runs/after-5").exists());
    assert_eq!(
        (&after["runs"]["tiny-5"]["status"], &after["runs"]["tiny-6"]["status"]),
        (&"done".into(), &"done".into())
    );
    assert!(workshop.path("all/report/report.json").exists(), "what there is is reported");
    complete(call(&workshop)).refused("gpu-5 failed");
    assert_eq!(state(&workshop)["runs"]["gpu-5"]["tries"], 2);
}

#[test]
fn a_report_of_two_seeds_has_numbers_and_says_what_is_missing() {
    let workshop = Workshop::new();
    for seed in [5, 6] {
        complete(workshop.up_seeded(&format!("seed-{seed}"), 1, 2, 300, seed)).result();
    }
    // One seed evaluated, as a folder of its own; the other not.
    let eval = ["eval", "seed-5", "--split", "test", "--objects", "all", "--episodes", "6", "--out", "elsewhere"];
    workshop.call(&eval).good();
    let printed = workshop.call(&["report", "seed-5", "seed-6", "elsewhere", "--out", "both"]);
    assert!(printed.success && printed.stderr.contains("not in its means: seed-6"), "{printed:#?}");
    let numbers = workshop.json("both/report.json");
    let result = &numbers["groups"][0]["results"][0];
    assert_eq!((&result["field"], &result["metrics"]["success"]["seeds"]), (&"test-novel-drawn".into(), &1.into()));
    assert_eq!(result["pooled"]["episodes"], 30);

    workshop.call(&["report", "seed-5", "--out", "seed-5"]).refused("no report");
    workshop.call(&["report", "nowhere"]).refused("nowhere");
    // The same seed twice is no second seed.
    workshop.copy("seed-5", "copy");
    workshop.call(&["report", "seed-5", "copy", "--out", "twice"]).refused("same seed 5");
    let below = workshop.call(&["report", ".", "--out", "below"]).good();
    assert!(below.stderr.contains(" is the same experiment with the same seed 5. Of such runs"), "{below:#?}");
    assert!(below.stdout.contains("2 runs in 1 group; groups evaluated: 1\n"), "{below:#?}");
    workshop
        .call(&["eval", "seed-5", "--out", "seed-6"])
        .refused("--out seed-6 holds a run: give a new or empty folder");
    let status = workshop.call(&["status", "seed-5", "--json"]).json();
    assert_eq!((&status["folder"], &status["evaluations"]), (&"seed-5".into(), &serde_json::json!([])));
}
