//! Evaluations of real weights by real processes: the same table whatever happens on the way.

use crate::figures::validating;
use proto::config::Config;
use proto::evaluation::read_table;
use proto::record::End;
use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant};
use system_tests::{DEADLINE, Printed, Workshop, complete, finish, start};

/// Episodes of each kitchen and object set: each category once.
const EPISODES: &str = "6";

/// `orchestrator eval` of the tiny configuration's fresh weights into the folder `out`.
fn eval_fresh(workshop: &Workshop, out: &str, further: &[&str]) -> Command {
    let mut command = workshop.orchestrator(&["eval", "--preset", "demo", "--config", "tiny.toml", "--seed", "5"]);
    command.args(["--split", "test", "--objects", "all", "--episodes", EPISODES, "--environments", "3", "--out", out]);
    command.args(further);
    command
}

fn table(workshop: &Workshop, out: &str) -> String {
    let path: PathBuf = workshop.path(out).join("episodes.csv");
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn result(workshop: &Workshop, out: &str) -> serde_json::Value {
    workshop.json(&format!("{out}/evaluation.json"))
}

#[test]
fn the_same_table_by_more_actors_and_with_processes_killed() {
    let workshop = Workshop::new();
    complete(eval_fresh(&workshop, "first", &[])).good();
    let undisturbed = table(&workshop, "first");
    assert_eq!(undisturbed.lines().count(), 1 + 5 * 12, "{undisturbed}");
    let records = read_table(Config::default().spec(), &undisturbed).unwrap();
    assert!(records.iter().all(|record| (1..=24).contains(&record.length)));

    complete(eval_fresh(&workshop, "again", &["--actors", "10"])).good();
    assert_eq!(table(&workshop, "again"), undisturbed);

    // Every actor dies once.
    let mut command = eval_fresh(&workshop, "actors", &[]);
    command.env("STILLROOM_FAULT", "actor.before_send:31");
    let printed = complete(command).good();
    assert!(printed.stderr.contains("actor-00 (kitchen 2) died"), "{printed:#?}");
    assert_eq!(table(&workshop, "actors"), undisturbed);

    // The learner dies once, in the middle, and begins again.
    let mut command = eval_fresh(&workshop, "learner", &[]);
    command.env("STILLROOM_FAULT", "learner.mid_evaluation:40");
    let printed = complete(command).good();
    assert!(printed.stderr.contains("it begins again"), "{printed:#?}");
    assert_eq!(table(&workshop, "learner"), undisturbed);
    for out in ["first", "actors", "learner"] {
        workshop.run(out).assert_nothing_left();
    }

    // Another seed is another table; the most probable action does not depend on the seed's noise.
    complete(eval_fresh(&workshop, "argmax", &["--deterministic"])).good();
    assert_ne!(table(&workshop, "argmax"), undisturbed);
}

#[test]
fn figures_are_those_of_the_table() {
    let workshop = Workshop::new();
    let printed = complete(eval_fresh(&workshop, "out", &["--record", "all"])).good();
    let spec = Config::default().spec();
    let records = read_table(spec, &table(&workshop, "out")).unwrap();
    let result = result(&workshop, "out");
    let steps: u64 = records.iter().map(|record| u64::from(record.length)).sum();
    assert_eq!(result["cost"]["steps"].as_u64(), Some(steps));
    assert_eq!(result["overall"]["episodes"].as_u64(), Some(60));
    assert_eq!(result["kitchens"].as_array().map(Vec::len), Some(5));
    assert_eq!(result["categories"].as_array().map(Vec::len), Some(12));
    assert_eq!(result["subject"]["checkpoint"], serde_json::Value::Null);
    let by_step = result["action_counts"]["by_step"].as_array().unwrap();
    let taken: u64 = by_step.iter().flat_map(|row| row.as_array().unwrap()).map(|count| count.as_u64().unwrap()).sum();
    assert_eq!((by_step.len(), taken), (24, steps));
    for (index, column) in spec.columns().iter().enumerate() {
        let numbers: Vec<f64> = records.iter().filter_map(|record| record.numbers[index]).collect();
        let mean = (!numbers.is_empty()).then(|| numbers.iter().sum::<f64>() / numbers.len() as f64);
        assert_eq!(result["overall"][&column.name].as_f64(), mean, "{}", column.name);
    }
    // The demo's policy predicts the label: every step but each episode's last is judged.
    let prediction = &result["overall"]["prediction"];
    let judged: u64 =
        ["hits", "misses", "false_alarms", "quiet"].iter().map(|name| prediction[*name].as_u64().unwrap()).sum();
    assert_eq!(judged, steps - 60);
    assert!(printed.stdout.contains("SRwoD"), "{printed:#?}");

    // What was recorded is what was played: simulated again, every state is the same.
    let recorded = workshop.run("out").recorded();
    assert_eq!((recorded["/step"], recorded["/episode/end"]), (steps, 60));
    workshop.assert_replays("out");

    // An episode is called for, and its film called, by its line in the table.
    let record = &records[3];
    let (kitchen, episode) = (record.kitchen.to_string(), record.episode.to_string());
    let film = |episode: &str| {
        let chosen = ["--kitchen", &kitchen, "--episode", episode];
        let drawn = ["--images", "films", "--format", "apng", "--side", "64"];
        workshop.call(&[&["replay", "out"][..], &chosen, &drawn].concat())
    };
    let filmed = film(&episode).good();
    assert!(filmed.stdout.contains(&format!("episodes: 1\nstates compared: {}", record.length + 1)), "{filmed:#?}");
    let films: Vec<_> =
        std::fs::read_dir(workshop.path("films")).unwrap().map(|file| file.unwrap().file_name()).collect();
    let is = |name: &str| record.has_all(&[spec.column(name).unwrap()]);
    let outcome = match (record.end, is("success"), is("success_without_disturbance")) {
        (End::Truncated, ..) => "time-limit",
        (End::Terminated, false, _) => "failure",
        (End::Terminated, true, true) => "success-without-disturbance",
        (End::Terminated, true, false) => "success",
    };
    let category = record.category.unwrap().name();
    let name = format!("kitchen-{:02}-episode-{:03}-{category}-{outcome}.png", record.kitchen.number(), record.episode);
    assert_eq!(films, [std::ffi::OsString::from(name)]);
    let last = records.iter().map(|record| record.episode).max().unwrap();
    film(&format!("{episode},{}", last + 1)).refused(&format!("the last is {last}"));
    let drawn = ["--images", "films of all", "--format", "apng", "--side", "16"];
    let all = workshop.call(&[&["replay", "out", "--episode", &episode][..], &drawn].concat()).good();
    let films = records.iter().filter(|other| other.episode == record.episode).count();
    let note = format!("makes {films} films: --environment chooses one environment");
    assert!(all.stderr.contains(&note), "{all:#?}");

    // Whoever chooses none gets the newest, of the kind that is asked for.
    let newest = |further: &[&str]| {
        let drawn = ["replay", "out", "--newest", "2", "--images", "newest", "--format", "apng", "--side", "64"];
        workshop.call(&[&drawn[..], further].concat())
    };
    newest(&[]).good();
    assert_eq!(std::fs::read_dir(workshop.path("newest")).unwrap().count(), 2);
    let failures = newest(&["--only", "failure"]).good();
    assert!(failures.stdout.contains("episodes: 2\n") && failures.stdout.contains("differences: 0"), "{failures:#?}");
    // Without a terminal there is a line every five seconds, also while the first film is drawn.
    let large = ["replay", "out", "--newest", "1", "--images", "large", "--format", "apng", "--side", "900"];
    let large = workshop.call(&large).good();
    assert!(large.stderr.contains("drawn 0 of 1 episodes, "), "{large:#?}");
}

/// `orchestrator eval --json` with these arguments: the result as it is printed, and all that was printed.
fn printed_result(workshop: &Workshop, arguments: &[&str]) -> (serde_json::Value, Printed) {
    let mut command = workshop.orchestrator(&["eval", "--json", "--seed", "5", "--episodes", "1"]);
    command.args(arguments);
    let printed = complete(command);
    (printed.json(), printed)
}

#[test]
fn which_episodes_are_played_follows_from_the_run_and_is_said() {
    let workshop = Workshop::new();
    let fresh = ["--preset", "demo", "--config", "tiny.toml"];
    let of = |further: &[&str]| printed_result(&workshop, &[&fresh[..], further].concat());
    // The tiny configuration begins within a metre of its targets.
    let (near, printed) = of(&["--out", "near"]);
    let conditions = &near["conditions"];
    assert_eq!((&conditions["distribution"], &conditions["split"]), (&"run".into(), &"test".into()));
    assert_eq!((&conditions["start_distance_max_m"], &conditions["goal_distance_max_m"]), (&1.0.into(), &1.0.into()));
    assert!(printed.stderr.contains("drawn episodes at short distances"), "{printed:#?}");
    assert!(table(&workshop, "near").lines().skip(1).all(|line| line.ends_with(",run")));
    assert!(near["overall"]["success_without_disturbance_per_axis"].is_number());

    let (fixed, printed) = of(&["--out", "fixed", "--distribution", "fixed"]);
    assert_eq!(fixed["conditions"]["distribution"], "fixed");
    assert!(printed.stderr.contains("fixed episodes at full distance, in the 5 test kitchens"), "{printed:#?}");
    // Where the run has no limits, the fixed ones need not be asked for, and the table is the same.
    let full = system_tests::TINY.replace("distance_max_m = 1.0", "distance_max_m = 0.0");
    std::fs::write(workshop.path("full.toml"), full).unwrap();
    let (full, _) = printed_result(&workshop, &["--preset", "demo", "--config", "full.toml", "--out", "full"]);
    assert_eq!(full["conditions"]["distribution"], "fixed");
    assert_eq!(table(&workshop, "full"), table(&workshop, "fixed"));
    assert!(!table(&workshop, "full").contains("distribution"));
}

#[test]
fn a_run_in_scenes_of_its_own_is_evaluated_there() {
    let workshop = Workshop::new();
    let scene = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/studio/scene.toml");
    let text = format!("scenes = [{:?}]\n{}", scene.to_str().unwrap(), system_tests::TINY);
    std::fs::write(workshop.path("tiny.toml"), text).unwrap();
    let (weights, _) = complete(workshop.up("run", 1, 2, 40)).result();
    let eval = |further: &[&str]| printed_result(&workshop, &[&["run"], further].concat());
    let (result, printed) = eval(&["--out", "there", "--record", "all"]);
    assert!(printed.stderr.contains("in 1 scene of the run's own (--split goes elsewhere)"), "{printed:#?}");
    let chosen = printed.stderr.lines().find(|line| line.starts_with("checkpoint rollout-"));
    assert!(chosen.is_some_and(|chosen| chosen.ends_with(".json of run")), "{printed:#?}");
    let conditions = &result["conditions"];
    assert_eq!((&conditions["scenes"][0], &conditions["objects"]), (&"scenes/000/scene.toml".into(), &"all".into()));
    assert_eq!((&result["kitchens"][0]["kitchen"], &result["overall"]["episodes"]), (&128.into(), &1.into()));
    assert_eq!(result["subject"]["weights"], *weights);
    // Of its own copies: simulated again, every state is the same.
    workshop.assert_replays("there");

    let report = workshop.call(&["report", "run", "there", "--out", "report"]).good();
    assert!(report.stderr.contains("figures of drawn episodes at short distances"), "{report:#?}");
    let numbers = workshop.json("report/report.json");
    assert_eq!(numbers["groups"][0]["results"][0]["field"], "scenes-seen");

    let (elsewhere, _) = eval(&["--out", "elsewhere", "--split", "test"]);
    assert_eq!(elsewhere["kitchens"].as_array().map(Vec::len), Some(5));
    assert!(!workshop.path("elsewhere/scenes").exists());
    let none = workshop.call(&["eval", "run", "--objects", "novel"]);
    assert!(!none.success && none.stderr.contains("no targets that are novel (they have: Apple"), "{none:#?}");
}

/// The lines of a run's validation.jsonl.
fn validated(workshop: &Workshop, run: &str) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(workshop.path(run).join("validation.jsonl")).unwrap_or_default();
    text.lines().map(|line| serde_json::from_str(line).expect("whole lines")).collect()
}

/// The best of these lines, and that `RUN/best` is a checkpoint of those weights.
fn assert_best(workshop: &Workshop, run: &str, lines: &[serde_json::Value]) {
    let key = |line: &serde_json::Value| {
        (line["success_without_disturbance"].as_f64(), line["success"].as_f64(), line["frames"].as_u64())
    };
    let better = |a, b| if key(a) > key(b) { a } else { b };
    let best = lines.iter().reduce(better).expect("at least one line");
    let rollout = best["rollout"].as_u64().expect("a number");
    let manifest = workshop.json(&format!("{run}/best/rollout-{rollout:08}.json"));
    assert_eq!(manifest["weights"], best["weights"]);
}

#[test]
fn validation_keeps_the_best_and_changes_nothing() {
    let workshop = validating();
    let mut plain = workshop.up("plain", 2, 3, 900);
    plain.args(["--set", "validation.every_frames=0"]);
    let plain = complete(plain).result();
    assert!(!workshop.path("plain/validation").exists());
    let printed = complete(workshop.up("run", 2, 3, 900));
    assert_eq!(printed.result(), plain);
    let lines = validated(&workshop, "run");
    let frames: Vec<_> = lines.iter().filter_map(|line| line["frames"].as_u64()).collect();
    assert_eq!(frames.len(), 3, "none is skipped: {frames:?}");
    assert_eq!(frames.last(), Some(&900));
    assert_best(&workshop, "run", &lines);
    let run = workshop.run("run");
    assert_eq!(run.recorded()["/evaluation"], lines.len() as u64);
    run.assert_nothing_left();
    workshop.call(&["eval", "run/best", "--episodes", "1", "--out", "of-best"]).good();
    assert_eq!(result(&workshop, "of-best")["subject"]["frames"], lines.last().unwrap()["frames"]);
}

#[test]
fn a_stop_while_the_last_validation_is_waited_for_leaves_it_to_resume() {
    let workshop = validating();
    let mut child = start(workshop.up("run", 2, 3, 300));
    let run = workshop.run("run");
    let begun = Instant::now();
    // Trained, the learner gone, and nothing left to wait for but the validation.
    while run.processes("--beside").is_empty() || !run.processes("--rank").is_empty() {
        assert!(begun.elapsed() < DEADLINE && child.try_wait().unwrap().is_none(), "the last validation is waited for");
        std::thread::sleep(Duration::from_millis(5));
    }
    let stopped = workshop.call(&["stop", "run"]);
    assert!(stopped.stdout.contains(" stopped"), "{stopped:#?}");
    let printed = finish(child);
    let (_, frames) = printed.result();
    assert_eq!(frames, 300);
    assert!(printed.stderr.contains("orchestrator resume run\n"), "{printed:#?}");
    assert!(!workshop.path("run/summary.json").exists() && validated(&workshop, "run").is_empty());
    assert_eq!(complete(workshop.resume("run")).result(), printed.result());
    let lines = validated(&workshop, "run");
    assert_eq!(lines.iter().map(|line| line["frames"].as_u64()).collect::<Vec<_>>(), [Some(300)]);
    assert!(workshop.path("run/summary.json").exists());
    run.assert_nothing_left();
}

#[test]
fn an_evaluation_is_not_gone_on_with() {
    let workshop = Workshop::new();
    let mut command = eval_fresh(&workshop, "out", &[]);
    command.env("STILLROOM_FAULT", "orchestrator.after_wire");
    assert!(complete(command).killed);
    let status = workshop.call(&["status", "out"]).good();
    assert!(status.stdout.contains("cut off") && !status.stdout.contains("go on with"), "{status:#?}");
    complete(workshop.resume("out")).refused("`orchestrator eval`");
    assert!(!workshop.path("out/checkpoints").exists());
    complete(eval_fresh(&workshop, "out", &[])).refused("it holds an evaluation");
}

#[test]
fn a_run_begins_with_anothers_weights() {
    let workshop = Workshop::new();
    let (weights, _) = complete(workshop.up("one", 1, 2, 300)).result();
    // The first checkpoint is not pruned.
    workshop.configure(("[checkpoint]", "[checkpoint]\nkeep = 100"), "");
    let mut second = workshop.up("two", 1, 2, 20);
    second.args(["--from", "one"]);
    complete(second).result();
    let two = workshop.path("two");
    // Before its first rollout it has the other's weights, no optimiser's moments and no frames.
    let manifest = workshop.json("two/checkpoints/rollout-00000000.json");
    assert_eq!(manifest["weights"].as_str(), Some(weights.as_str()));
    assert_eq!((manifest["frames"].as_u64(), manifest["adam_steps"].as_u64()), (Some(0), Some(0)));
    let config: toml::Table = std::fs::read_to_string(two.join("config.toml")).unwrap().parse().unwrap();
    assert_eq!(config["from"]["weights"].as_str(), Some(weights.as_str()));
    assert_eq!(config["from"]["frames"].as_integer(), Some(300));

    let mut other = workshop.up("three", 1, 2, 20);
    workshop.configure(("hidden = 32", "hidden = 48"), "");
    other.args(["--from", "one"]);
    complete(other).refused("network.hidden is 48, there 32");
    assert!(!workshop.path("three").exists(), "nothing is left of a run that never began");
}
