//! The figures of a run (`metrics.jsonl`, `validation.jsonl`, `summary.json`, `best`) are those of the undisturbed run,
//! whoever was killed and whichever file was damaged on the way. Only times, and what starts and recordings are called,
//! differ.

use rustix::process::Signal;
use serde_json::Value;
use std::path::PathBuf;
use std::process::Child;
use std::time::Duration;
use system_tests::{
    Run, TINY, Undisturbed, Workshop, board, complete, finish, kill, kill_child, signal, start, wait_until,
};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 3;
const FRAMES: u64 = 600;

/// A workshop whose runs are validated after each 300 frames, an episode in each kitchen.
pub fn validating() -> Workshop {
    let workshop = Workshop::new();
    let text = format!("{TINY}\n[validation]\nevery_frames = 300\nepisodes = 1\n");
    std::fs::write(workshop.path("tiny.toml"), text).expect("a writable temporary folder");
    workshop
}

#[derive(Debug, PartialEq)]
pub struct Figures {
    metrics: Vec<Value>,
    validation: Vec<Value>,
    summary: Value,
    best: Option<u64>,
}

impl Figures {
    /// Those of a run.
    pub fn of(run: &Run) -> Self {
        let summary = std::fs::read_to_string(run.folder.summary()).expect("a summary");
        let mut summary: Value = serde_json::from_str(&summary).expect("JSON");
        // Absent without a recording.
        let recorded = summary.as_object_mut().expect("an object").remove("recording_complete");
        assert_ne!(recorded, Some(Value::Bool(false)));
        shown_by_tensorboard(run);
        let others = ["id", "training_s", "frames_per_s", "wall", "incarnations", "recordings"];
        Self {
            metrics: lines(run.folder.metrics(), &["at_unix_s", "incarnation", "wall_s", "timing"]),
            validation: lines(run.folder.validation_log(), &["at_unix_s", "wall_s"]),
            summary: without(summary, &others),
            best: run.folder.best_rollout(),
        }
    }
}

/// What TensorBoard shows is what the lines of the run say, each step once.
fn shown_by_tensorboard(run: &Run) {
    let shown = |of_stages: bool, tag: &str| {
        let curves = board::curves(&run.folder, of_stages);
        curves.into_iter().map(|(step, figures)| (step, figures.get(tag).copied())).collect::<Vec<_>>()
    };
    let said = |path: PathBuf, figure: fn(&Value) -> &Value| {
        let lines = lines(path, &[]);
        let mut said: Vec<(u64, Option<f32>)> = lines
            .iter()
            .map(|line| (line["frames"].as_u64().expect("frames"), figure(line).as_f64().map(|figure| figure as f32)))
            .collect();
        said.sort_by_key(|(step, _)| *step);
        said
    };
    assert_eq!(
        shown(true, "charts/episodic_return"),
        said(run.folder.metrics(), |line| &line["metrics"]["episode/return"])
    );
    assert_eq!(shown(true, "losses/value_loss"), said(run.folder.metrics(), |line| &line["metrics"]["loss/value"]));
    assert_eq!(shown(true, "time/update_s"), said(run.folder.metrics(), |line| &line["timing"]["update_s"]));
    assert_eq!(shown(false, "charts/success_rate"), said(run.folder.validation_log(), |line| &line["success"]));
}

/// Every line of a file, without these keys.
fn lines(path: PathBuf, keys: &[&str]) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    text.lines().map(|line| without(serde_json::from_str(line).expect("whole lines"), keys)).collect()
}

fn without(mut value: Value, keys: &[&str]) -> Value {
    let object = value.as_object_mut().expect("an object");
    for key in keys {
        let is_there = object.remove(*key).is_some();
        // A line that was taken from a checkpoint has no time of the orchestrator's.
        assert!(is_there || *key == "wall_s", "{key} is there");
    }
    value
}

/// Those of the undisturbed run in such a workshop, with validations or without.
fn undisturbed(workshop: &Workshop) -> Figures {
    let run = Undisturbed::of(workshop, workshop.up("undisturbed", ACTORS, ENVIRONMENTS, FRAMES)).run;
    let figures = Figures::of(&run);
    let rollouts: Vec<u64> = figures.metrics.iter().filter_map(|line| line["rollout"].as_u64()).collect();
    assert_eq!(rollouts, (0..rollouts.len() as u64).collect::<Vec<_>>(), "each rollout once, in order");
    let validated = run.folder.validations().exists();
    assert_eq!((figures.validation.len(), figures.best.is_some()), (if validated { 2 } else { 0 }, validated));
    assert_eq!(figures.summary["stages"].as_array().map(Vec::len), Some(2));
    figures
}

/// Resumes a run until it is complete; its figures are the undisturbed ones.
fn assert_resumes(workshop: &Workshop, name: &str, what: &str) {
    complete(workshop.resume(name)).result();
    let run = workshop.run(name);
    assert_eq!(Figures::of(&run), undisturbed(workshop), "{what}");
    run.assert_nothing_left();
}

#[test]
fn an_orchestrator_that_hears_nothing_before_it_is_killed_loses_no_figures() {
    let workshop = Workshop::new();
    for (number, rollouts) in [1, 5].into_iter().enumerate() {
        let name = format!("deaf-{number}");
        let mut command = workshop.up(&name, ACTORS, ENVIRONMENTS, FRAMES);
        // A recorder that is stopped would stop the actors, too.
        command.args(["--set", "recording.enabled=false"]);
        let child = start(command);
        let run = workshop.run(&name);
        run.wait_for_rollouts(rollouts);
        // What its learner tells now lies in a pipe that nobody reads.
        signal(child.id(), Signal::STOP);
        let known = run.metrics().len();
        let checkpoint = |rollout: usize| run.folder.checkpoint_manifest(rollout as u64).exists();
        wait_until("a checkpoint that nobody hears of", || checkpoint(known + 1) || checkpoint(known + 2));
        kill_child(child);
        run.wait_for_end();
        let status = complete(workshop.orchestrator(&["status", &name]));
        let note = "not in metrics.jsonl and are taken from the checkpoint";
        assert!(status.stdout.contains(note), "{status:#?}");
        assert_resumes(&workshop, &name, &format!("killed after {rollouts} rollouts"));
    }
}

#[test]
fn a_killed_validation_is_made_again() {
    let workshop = validating();
    let child = start(workshop.up("killed", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("killed");
    wait_until("a validation begins", || !run.processes("--beside").is_empty());
    run.kill_one("--beside");
    let printed = finish(child);
    printed.result();
    assert!(printed.stderr.contains("failed and is made again"), "{printed:#?}");
    assert_eq!(Figures::of(&run), undisturbed(&workshop));
    run.assert_nothing_left();
}

/// It was lost: the run ended as complete, with status 0, and `resume` only printed the summary.
#[test]
fn a_validation_that_is_killed_in_every_try_is_missed_and_made_up_by_resume() {
    let workshop = validating();
    let last = format!("rollout-{:08}", undisturbed(&workshop).validation.last().unwrap()["rollout"].as_u64().unwrap());
    let child = start(workshop.up("killed", ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run("killed");
    let is_last =
        |pid: &u32| std::fs::read_to_string(format!("/proc/{pid}/cmdline")).is_ok_and(|line| line.contains(&last));
    for _ in 0..3 {
        let mut found = None;
        wait_until("a try of the last validation", || {
            found = run.processes("--beside").into_iter().find(is_last);
            found.is_some()
        });
        kill(found.expect("just found"));
        wait_until("it is gone", || !run.processes("--beside").contains(&found.expect("just found")));
    }
    let printed = finish(child);
    assert_eq!(printed.status, Some(1), "{printed:#?}");
    assert!(printed.stdout.contains(" complete: ") && printed.stdout.contains(" is missing: `"), "{printed:#?}");
    let text = std::fs::read_to_string(run.folder.summary()).unwrap();
    assert!(text.contains("\"missing\"") && text.contains("\"validation\""), "{text}");
    let status = complete(workshop.orchestrator(&["status", "killed"]));
    assert!(status.stdout.contains("note: the validation after rollout "), "{status:#?}");
    complete(workshop.resume("killed")).result();
    assert_eq!(Figures::of(&run), undisturbed(&workshop));
    run.assert_nothing_left();
    // Now there is nothing to make up, and nothing is started for it.
    let starts =
        |run: &Run| std::fs::read_to_string(run.folder.identity()).unwrap().matches("[[incarnations]]").count();
    let before = starts(&run);
    assert_eq!(complete(workshop.resume("killed")).status, Some(0));
    assert_eq!([before, starts(&run)], [2, 2]);
}

fn stopped_in_its_middle(workshop: &Workshop, name: &str) -> Run {
    let child: Child = start(workshop.up(name, ACTORS, ENVIRONMENTS, FRAMES));
    let run = workshop.run(name);
    wait_until("a validation", || std::fs::metadata(run.folder.validation_log()).is_ok_and(|file| file.len() > 0));
    run.wait_for_rollouts(5);
    signal(child.id(), Signal::INT);
    assert!(finish(child).success);
    assert!(!run.folder.summary().exists(), "the run was stopped in its middle");
    run
}

#[test]
fn damaged_and_deleted_files_are_told_of_and_mended() {
    let workshop = validating();
    for (name, damage) in [("deleted", None), ("garbled", Some(3))] {
        let run = stopped_in_its_middle(&workshop, name);
        for path in [run.folder.metrics(), run.folder.validation_log()] {
            let text = std::fs::read_to_string(&path).unwrap();
            let lines: Vec<&str> = text.lines().collect();
            match damage {
                None => std::fs::remove_file(&path).unwrap(),
                Some(every) => {
                    let line = |(number, line)| if number % every == 0 { "{\"rollout\": 7, !" } else { line };
                    let lines: Vec<&str> = lines.into_iter().enumerate().map(line).collect();
                    std::fs::write(&path, lines.join("\n") + "\n").unwrap();
                }
            }
        }
        let status = complete(workshop.orchestrator(&["status", name])).stdout;
        let notes = match damage {
            None => ["metrics.jsonl is missing", "validation.jsonl is missing"],
            Some(_) => ["note: metrics.jsonl has ", "note: validation.jsonl has 1 damaged line"],
        };
        for note in notes {
            assert!(status.contains(note), "{note}: {status}");
        }
        assert_resumes(&workshop, name, name);
    }
}

#[test]
fn a_complete_run_whose_figures_were_deleted_is_reported_on_with_a_word() {
    let workshop = Workshop::new();
    complete(workshop.up("run", ACTORS, ENVIRONMENTS, FRAMES)).result();
    let run = workshop.run("run");
    let report = || complete(workshop.orchestrator(&["report", "run", "--out", "report"]));
    let rollouts = || {
        let text = std::fs::read_to_string(workshop.path("report/report.json")).unwrap();
        text.matches("\"frames\"").count()
    };
    assert!(!report().stderr.contains("metrics.jsonl"));
    let before = rollouts();
    std::fs::remove_file(run.folder.metrics()).unwrap();
    std::fs::remove_dir_all(workshop.path("report")).unwrap();
    let printed = report();
    assert!(printed.success, "{printed:#?}");
    assert!((printed.stdout.clone() + &printed.stderr).contains("run: metrics.jsonl is missing"), "{printed:#?}");
    assert_eq!(rollouts(), before, "nothing is left out");
    let status = complete(workshop.orchestrator(&["status", "run"])).stdout;
    assert!(status.contains("metrics.jsonl is missing") && status.contains("\nI "), "{status}");
}

/// The folder of a run is removed and another run begins in a new one of that name. A learner of the first wakes late.
#[test]
fn a_late_learner_writes_nothing_into_the_folder_of_another_run() {
    let workshop = Workshop::new();
    let elsewhere = complete(workshop.up_seeded("elsewhere", ACTORS, ENVIRONMENTS, 300, 6)).result();
    let child = start(workshop.up("run", ACTORS, ENVIRONMENTS, 10 * FRAMES));
    let run = workshop.run("run");
    run.wait_for_rollouts(8);
    let late = run.learner();
    // Not while it writes: a file that is nearly there gets its name when the learner wakes.
    wait_until("the learner is stopped between two files", || {
        signal(late, Signal::STOP);
        std::thread::sleep(Duration::from_millis(20));
        let files = std::fs::read_dir(run.folder.checkpoints()).into_iter().flatten().flatten();
        let writes = files.into_iter().any(|file| file.path().extension().is_some_and(|end| end == "partial"));
        if writes {
            signal(late, Signal::CONT);
        }
        !writes
    });
    kill_child(child);
    wait_until("its actors leave", || run.processes("--actor ").is_empty());
    let first = run.folder.id().expect("a run has an id");
    std::fs::remove_dir_all(run.folder.root()).expect("a folder to remove");
    assert_eq!(complete(workshop.up_seeded("run", ACTORS, ENVIRONMENTS, 300, 6)).result(), elsewhere);
    signal(late, Signal::CONT);
    run.wait_for_end();
    let own = run.folder.id().expect("a run has an id");
    let entries = std::fs::read_dir(run.folder.checkpoints()).expect("checkpoints").flatten();
    let manifests: Vec<PathBuf> =
        entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|end| end == "json")).collect();
    assert!(!manifests.is_empty());
    for path in manifests {
        let manifest: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).expect("JSON");
        assert_eq!(manifest["run"], own.as_str(), "{}", path.display());
    }
    assert_eq!(complete(workshop.resume("run")).result(), elsewhere);
    // Nobody else can know any more what the first run left in shared memory.
    wire::WireAddress::new(&first, 1).sweep().expect("what is ours can be removed");
}
