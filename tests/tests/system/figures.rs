//! The figures of a run (`metrics.jsonl`, `validation.jsonl`, `summary.json`, `best`) are those of the undisturbed run,
//! whoever was killed and whichever file was damaged on the way. Only times, and what starts and recordings are called,
//! differ.

use rustix::process::Signal;
use serde_json::Value;
use std::path::PathBuf;
use std::process::Child;
use system_tests::{
    Run, Undisturbed, Workshop, board, complete, finish, is_held, kill, kill_child, kill_child_and_adopt, signal,
    start, wait_until,
};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 3;
const FRAMES: u64 = 600;

/// A workshop whose runs are validated after each 300 frames, an episode in each kitchen.
pub fn validating() -> Workshop {
    let workshop = Workshop::new();
    workshop.configure(("", ""), "\n[validation]\nevery_frames = 300\nepisodes = 1\n");
    workshop
}

/// What TensorBoard shows is what the lines of the run say, each step once.
fn shown_by_tensorboard(run: &Run) {
    let shown = |of_stages: bool, tag: &str| {
        let curves = board::curves(&run.folder, of_stages);
        curves.into_iter().map(|(step, figures)| (step, figures.get(tag).copied())).collect::<Vec<_>>()
    };
    let said = |path: PathBuf, figure: fn(&Value) -> &Value| {
        let lines = lines(path);
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

fn lines(path: PathBuf) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    text.lines().map(|line| serde_json::from_str(line).expect("whole lines")).collect()
}

/// The undisturbed run in such a workshop, with validations or without.
fn undisturbed(workshop: &Workshop) -> Undisturbed {
    let undisturbed = Undisturbed::of(workshop, workshop.up("undisturbed", ACTORS, ENVIRONMENTS, FRAMES));
    let folder = &undisturbed.run.folder;
    let validations = if folder.validations().exists() { 2 } else { 0 };
    assert_eq!((lines(folder.validation_log()).len(), folder.best_rollout().is_some()), (validations, validations > 0));
    undisturbed
}

/// Resumes a run until it is complete; it is the undisturbed one.
fn assert_resumes(workshop: &Workshop, name: &str, what: &str) {
    complete(workshop.resume(name)).result();
    let run = workshop.run(name);
    run.assert_same(&undisturbed(workshop), what);
    shown_by_tensorboard(&run);
    run.assert_nothing_left();
}

#[test]
fn an_orchestrator_that_hears_nothing_before_it_is_killed_loses_no_figures() {
    let workshop = Workshop::new();
    // A recorder that is stopped would stop the actors, too.
    workshop.configure(("[recording]\n", "[recording]\nenabled = false\n"), "");
    for (number, rollouts) in [1, 5].into_iter().enumerate() {
        let name = format!("deaf-{number}");
        let child = start(workshop.up(&name, ACTORS, ENVIRONMENTS, FRAMES));
        let run = workshop.run(&name);
        run.wait_for_rollouts(rollouts);
        // What its learner tells now lies in a pipe that nobody reads.
        signal(child.id(), Signal::STOP);
        let known = run.metrics().len();
        let checkpoint = |rollout: usize| run.folder.checkpoint_manifest(rollout as u64).exists();
        wait_until("a checkpoint that nobody hears of", || checkpoint(known + 1) || checkpoint(known + 2));
        kill_child(child);
        run.wait_for_end();
        let status = workshop.call(&["status", &name]);
        let note = "not in metrics.jsonl and are taken from the checkpoint";
        assert!(status.stdout.contains(note), "{status:#?}");
        assert_resumes(&workshop, &name, &format!("killed after {rollouts} rollouts"));
    }
}

/// It was lost: the run ended as complete, with status 0, and `resume` only printed the summary.
#[test]
fn a_validation_that_is_killed_in_every_try_is_missed_and_made_up_by_resume() {
    let workshop = validating();
    let validations = lines(undisturbed(&workshop).run.folder.validation_log());
    let last = format!("rollout-{:08}", validations.last().unwrap()["rollout"].as_u64().unwrap());
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
    let status = workshop.call(&["status", "killed"]);
    assert!(status.stdout.contains("note: the validation after rollout "), "{status:#?}");
    assert_resumes(&workshop, "killed", "killed in every try");
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
        let status = workshop.call(&["status", name]).stdout;
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
        wait_until("it is stopped", || is_held(late));
        let files = std::fs::read_dir(run.folder.checkpoints()).into_iter().flatten().flatten();
        let writes = files.into_iter().any(|file| file.path().extension().is_some_and(|end| end == "partial"));
        if writes {
            signal(late, Signal::CONT);
        }
        !writes
    });
    kill_child_and_adopt(child);
    wait_until("its actors leave", || run.processes("--actor ").is_empty());
    let first = run.folder.id().expect("a run has an id");
    std::fs::remove_dir_all(run.folder.root()).expect("a folder to remove");
    assert_eq!(complete(workshop.up_seeded("run", ACTORS, ENVIRONMENTS, 300, 6)).result(), elsewhere);
    assert!(is_held(late), "the learner of the first run wakes only now");
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
