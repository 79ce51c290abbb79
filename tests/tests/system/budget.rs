//! A run gets another budget than it began with: `resume --frames`.

use proto::config::Config;
use serde_json::Value;
use system_tests::{Workshop, complete};

fn resume_to(workshop: &Workshop, name: &str, frames: u64) -> std::process::Command {
    workshop.orchestrator(&["resume", name, "--frames", &frames.to_string()])
}

fn stages(workshop: &Workshop, name: &str) -> Vec<u64> {
    let config = Config::of_run(&workshop.run(name).folder).expect("a run's configuration is valid at any time");
    config.stages.iter().map(|stage| stage.frames).collect()
}

#[test]
fn a_complete_run_trains_on_to_a_larger_budget() {
    let workshop = Workshop::new();
    let short = complete(workshop.up("run", 1, 3, 2000)).result();
    assert_eq!(stages(&workshop, "run"), [809, 1191]);

    complete(resume_to(&workshop, "run", 1999)).refused("the run has 2,000 frames already");
    assert_eq!(complete(resume_to(&workshop, "run", 2000)).result(), short, "it has that budget");
    assert_eq!(workshop.call(&["status", "run", "--json"]).json()["state"], "complete");

    let printed = complete(resume_to(&workshop, "run", 3100));
    let (weights, frames) = printed.result();
    assert_eq!(frames, 3100);
    assert_ne!(weights, short.0);
    assert!(printed.stderr.contains("the budget is 3,100 frames instead of 2,000"), "{printed:#?}");
    assert!(printed.stderr.contains("the learning rate falls"), "{printed:#?}");
    assert!(!printed.stderr.contains("has changed since checkpoint"), "it was asked for: {printed:#?}");
    assert_eq!(stages(&workshop, "run"), [809, 2291]);
    let run = workshop.run("run");
    let rollouts: Vec<u64> = run.metrics().keys().copied().collect();
    assert!(rollouts.iter().copied().eq(0..rollouts.len() as u64), "one run without a gap: {rollouts:?}");
    assert_eq!(run.metrics().values().next_back().expect("a rollout")["frames"], 3100);
    run.assert_nothing_left();
    assert!(workshop.call(&["replay", "--check", "run"]).success);

    // Both starts count, and what is said of them survives.
    let summary = workshop.json("run/summary.json");
    assert_eq!((&summary["complete"], &summary["budget"]), (&Value::Bool(true), &Value::from(3100)));
    let status = workshop.call(&["status", "run", "--json"]).json();
    for wall in [&summary["wall"], &status["wall"]] {
        let [all, last] = ["all_starts_s", "last_start_s"].map(|key| wall[key].as_f64().expect("seconds"));
        assert!(last > 0.0 && all > last, "{wall}");
    }
    assert!(printed.stdout.contains(" over 2 starts (the last "), "{printed:#?}");
    // What to do next, with the run's own path.
    for next in ["orchestrator replay run\n", "orchestrator eval run\n", "orchestrator report run\n"] {
        assert!(printed.stderr.contains(next), "{next}: {printed:#?}");
    }
}

/// With a learning rate that does not fall, and an old budget at the end of a whole rollout, nothing is different.
#[test]
fn where_nothing_depends_on_the_length_of_a_stage_the_larger_budget_is_exact() {
    let workshop = Workshop::new();
    let up = |name: &str, frames: u64| {
        let stages = format!("stages=[{{ name = \"I\", reward = \"r\", frames = {frames} }}]");
        let mut command = workshop.orchestrator(&["up", "--preset", "demo", "--config", "tiny.toml", "--run", name]);
        command.args(["--seed", "5", "--actors", "1", "--envs-per-actor", "3"]);
        command.args(["--set", "ppo.learning_rate_end=1", "--set", "ppo.entropy_coefficient_end=1", "--set", &stages]);
        command
    };
    let whole = complete(up("whole", 900)).result();
    assert_eq!(complete(up("part", 450)).result().1, 450);
    let printed = complete(resume_to(&workshop, "part", 900));
    assert_eq!(printed.result(), whole);
    assert!(!printed.stderr.contains("the learning rate falls"), "{printed:#?}");
}

#[test]
fn killed_while_the_budget_changes_it_has_the_old_one_or_the_new() {
    let workshop = Workshop::new();
    let short = complete(workshop.up("run", 1, 3, 600)).result();
    for point in ["resume.before_budget", "resume.amid_budget"] {
        let mut command = resume_to(&workshop, "run", 1000);
        command.env("STILLROOM_FAULT", point);
        assert!(complete(command).killed, "{point} is never reached");
        assert_eq!(complete(workshop.resume("run")).result(), short, "killed at {point}");
    }
    let mut command = resume_to(&workshop, "run", 1000);
    command.env("STILLROOM_FAULT", "resume.after_budget");
    assert!(complete(command).killed, "resume.after_budget is never reached");
    let long = complete(workshop.resume("run")).result();
    assert_eq!(long.1, 1000);
    // The same as without a kill.
    complete(workshop.up("undisturbed", 1, 3, 600)).result();
    assert_eq!(complete(resume_to(&workshop, "undisturbed", 1000)).result(), long);
    workshop.run("run").assert_nothing_left();
}
