//! `learner bench` and `learner exchange`.

use serde_json::Value;
use system_tests::{Printed, Workshop, binary, complete};

/// `learner ARGS` on a CPU, complete.
fn learner(what: &str, arguments: &[&str]) -> Printed {
    let workshop = Workshop::new();
    let mut command = workshop.program(binary("learner"));
    command.args([what, "--device", "cpu"]).args(arguments);
    complete(command)
}

#[test]
fn the_learner_measures_itself() {
    let task = "--preset demo --config tiny.toml --set actors.count=2 --set actors.environments_per_actor=2";
    let sizes = "--set machine.pin=true --batches 3 --steps 4 --rollout-frames 16 --seconds 0.01 --json";
    let report = learner("bench", &[task, sizes].join(" ").split(' ').collect::<Vec<_>>()).json();
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
    let printed = learner("bench", &["--mark", "update"]);
    assert!(printed.stdout.is_empty(), "{printed:#?}");
    printed.refused("--mark shows a profiler what a GPU does, and this is a CPU");
}

#[test]
fn learners_measure_their_exchange() {
    let exchange = |arguments: &[&str]| learner("exchange", arguments);
    let report = exchange(&["--learners", "3", "--weights", "1000", "--pieces", "1,7", "--sums", "4", "--json"]).json();
    assert_eq!([&report["learners"], &report["bytes"], &report["sums"][1]["pieces"]], [3, 4000, 7]);
    for sums in report["sums"].as_array().expect("a list") {
        let [p50, p99, rate] = ["p50_s", "p99_s", "bus_bytes_per_s"].map(|figure| sums[figure].as_f64().unwrap_or(0.0));
        assert!(0.0 < p50 && p50 <= p99, "{report:#}");
        assert!((rate * p50 - 2.0 * 2.0 / 3.0 * 4000.0).abs() < 1e-6, "{report:#}");
    }
    exchange(&["--rank", "2", "--meet", "127.0.0.1:1", "--address", "127.0.0.1"])
        .refused("2 learners have ranks 0 to 1");
}
