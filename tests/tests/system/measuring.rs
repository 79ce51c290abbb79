//! `learner bench`.

use serde_json::Value;
use std::process::{Command, Stdio};
use system_tests::{Workshop, binary, complete};

#[test]
fn the_learner_measures_itself() {
    let workshop = Workshop::new();
    let mut command = Command::new(binary("learner"));
    command.current_dir(workshop.path("")).args([
        "bench",
        "--preset",
        "demo",
        "--config",
        "tiny.toml",
        "--device",
        "cpu",
    ]);
    command.args(["--set", "actors.count=2", "--set", "actors.environments_per_actor=2", "--set", "machine.pin=true"]);
    command.args(["--batches", "3", "--steps", "4", "--rollout-frames", "16", "--seconds", "0.01"]);
    command.args(["--json"]).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let printed = complete(command);
    assert!(printed.success, "{printed:#?}");
    let report: Value = serde_json::from_str(&printed.stdout).unwrap_or_else(|error| panic!("{error}: {printed:#?}"));
    let positive = |value: &Value| assert!(value.as_f64().is_some_and(|value| value > 0.0), "{report:#}");
    let inference = &report["inference"][0];
    assert_eq!(inference["batch"], 3);
    for figure in ["p50_s", "p99_s", "copy_s"] {
        positive(&inference[figure]);
    }
    let update = &report["updates"][0];
    assert_eq!([&update["environments"], &update["frames"], &update["epochs"]], [4, 16, 2]);
    positive(&update["update_s"]);
}

/// Before anything is measured.
#[test]
fn a_profiler_is_shown_nothing_of_a_cpu() {
    let workshop = Workshop::new();
    let mut command = Command::new(binary("learner"));
    command.current_dir(workshop.path("")).args(["bench", "--device", "cpu", "--mark", "update"]);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let printed = complete(command);
    assert!(!printed.success && printed.stdout.is_empty(), "{printed:#?}");
    assert!(printed.stderr.contains("--mark shows a profiler what a GPU does, and this is a CPU"), "{printed:#?}");
}
