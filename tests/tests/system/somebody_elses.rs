//! Run folders that came from somebody else: what reads one shows nothing of other files, and ends in bounded time and
//! memory, whatever lies there.

use crate::figures::validating;
use proto::run_folder::{RolloutName, RunFolder};
use std::fs::File;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use system_tests::{Viewer, Workshop, complete};

const SECRET: &str = "xyzzy-private-xyzzy";
/// What reads a run.
const READERS: [&[&str]; 8] = [
    &["list"],
    &["status", "runs/bad"],
    &["logs", "runs/bad"],
    &["logs", "runs/bad", "-n", "3"],
    &["compare", "runs/bad", "runs/good"],
    &["report", "runs/bad", "--out", "page"],
    &["replay", "--check", "runs/bad"],
    &["export", "runs/bad", "--format", "npz", "--out", "data"],
];
/// Where the viewer shows a run.
const PAGES: [&str; 4] = ["", "/curves", "/episodes", "/episodes?source=training"];

/// A workshop with a run, and a copy of it for each victim.
fn workshop() -> Workshop {
    let workshop = validating();
    complete(workshop.up("runs/good", 1, 2, 300)).result();
    workshop
}

fn copy(workshop: &Workshop) -> RunFolder {
    let _ = std::fs::remove_dir_all(workshop.path("runs/bad"));
    workshop.copy("runs/good", "runs/bad").folder
}

/// One of each kind of file and folder, relative to the run.
fn places(run: &RunFolder) -> Vec<PathBuf> {
    let checkpoints = run.list(&run.checkpoints()).expect("checkpoints");
    let newest = |kind: RolloutName| {
        let mut of_kind = checkpoints.iter().filter(|item| kind.rollout_of(&item.path).is_some());
        of_kind.next_back().expect("a checkpoint").path.clone()
    };
    let files = [run.identity(), run.config(), run.summary(), run.metrics(), run.validation_log()];
    let folders = [run.logs(), run.checkpoints(), run.recordings(), run.validations()];
    let of_checkpoint = [RolloutName::Manifest, RolloutName::Tensors, RolloutName::Figures].map(newest);
    let others = [run.log("orchestrator"), run.log("actor-00"), run.recording(1, 0)];
    let all = files.into_iter().chain(folders).chain(of_checkpoint).chain(others);
    all.map(|path| path.strip_prefix(run.root()).expect("it is in the run").to_owned()).collect()
}

/// Has all readers read the bad run, and hands on what each printed and how long it took.
fn read(workshop: &Workshop, mut judge: impl FnMut(&str, &str)) {
    for reader in READERS {
        let _ = std::fs::remove_dir_all(workshop.path("page"));
        let _ = std::fs::remove_dir_all(workshop.path("data"));
        // A process that reads without a bound has no memory.
        let limited = workshop.limited("ulimit -v 6000000", &workshop.orchestrator(reader));
        let began = Instant::now();
        let printed = complete(limited);
        assert!(began.elapsed() < Duration::from_mins(1), "{reader:?} took {:?}", began.elapsed());
        assert!(!printed.stderr.contains("panicked"), "{reader:?}: {printed:#?}");
        judge(reader[0], &(printed.stdout + &printed.stderr));
    }
    let viewer = Viewer::start(workshop, &[]);
    for page in PAGES {
        let answer = viewer.get(&format!("/api/runs/bad{page}"));
        judge("view", &String::from_utf8_lossy(&answer.body));
    }
    judge("view", &viewer.json("/api/runs").to_string());
    assert!(viewer.stop());
}

#[test]
fn no_reader_follows_a_link_out_of_a_run_folder() {
    let workshop = workshop();
    let private = workshop.path("private");
    std::fs::write(&private, format!("{SECRET}\n")).unwrap();
    for place in places(&workshop.run("runs/good").folder) {
        let bad = copy(&workshop);
        let victim = bad.root().join(&place);
        let (elsewhere, is_folder) = (workshop.path("elsewhere"), victim.is_dir());
        let _ = std::fs::remove_dir_all(&elsewhere);
        if is_folder {
            std::fs::rename(&victim, &elsewhere).unwrap();
            std::fs::write(elsewhere.join("orchestrator.log"), format!("{SECRET}\n")).unwrap();
            symlink(&elsewhere, &victim).unwrap();
        } else {
            std::fs::remove_file(&victim).unwrap();
            symlink(&private, &victim).unwrap();
        }
        let mut refused = 0;
        read(&workshop, |reader, told| {
            assert!(!told.contains(SECRET), "{reader} follows {}: {told}", place.display());
            refused += usize::from(told.contains("a link or no plain file"));
        });
        // Tensors are read by those that want weights.
        assert!(refused > 0 || place.extension().is_some_and(|kind| kind == "safetensors"), "{}", place.display());
    }
}

/// A hole of 200 GB costs nothing to make.
fn sparse(path: &Path) {
    let _ = std::fs::remove_file(path);
    File::create(path).and_then(|file| file.set_len(200 << 30)).expect("a disk with holes");
}

#[test]
fn a_file_without_end_is_named_and_the_rest_of_the_run_is_read() {
    let workshop = workshop();
    for place in places(&workshop.run("runs/good").folder) {
        let bad = copy(&workshop);
        let victim = bad.root().join(&place);
        if victim.is_dir() || place.extension().is_some_and(|kind| kind == "mcap") {
            continue;
        }
        sparse(&victim);
        let mut named = 0;
        read(&workshop, |_, told| named += usize::from(told.contains("are read")));
        let is_named = named > 0 || place.extension().is_some_and(|kind| kind == "safetensors");
        assert!(is_named, "nobody names the bound of {}", place.display());
    }
    let bad = copy(&workshop);
    sparse(&bad.metrics());
    sparse(&bad.validation_log());
    let status = workshop.call(&["status", "runs/bad"]);
    assert!(status.success && status.stdout.contains("300 / 300 frames"), "the checkpoint has them: {status:#?}");
    for (file, most) in [("metrics.jsonl", 256 << 20), ("validation.jsonl", 16 << 20)] {
        let sentence = format!("note: {file} is left out: it has more than the {most} bytes that are read");
        assert!(status.stdout.contains(&sentence), "{status:#?}");
    }
}

/// A summary that was too long or a link was an error of the whole command.
#[test]
fn a_run_that_cannot_be_read_is_named_and_the_others_are_shown() {
    let workshop = workshop();
    workshop.copy("runs/good", "runs/other");
    // Runs of one seed are none beside each other.
    let reseed = |run: &str, digit: &str| {
        let config = workshop.run(run).folder.config();
        let text = std::fs::read_to_string(&config).unwrap();
        std::fs::write(config, text.replacen("seed = ", &format!("seed = {digit}"), 1)).unwrap();
    };
    reseed("runs/other", "1");
    let bad = workshop.run("runs/bad").folder;
    let files = [bad.identity(), bad.config(), bad.summary(), bad.orchestrator_lock(), bad.metrics()];
    for (file, is_link) in files.iter().flat_map(|file| [(file, true), (file, false)]) {
        copy(&workshop);
        reseed("runs/bad", "2");
        sparse(file);
        if is_link {
            std::fs::remove_file(file).and_then(|()| symlink("/etc/hostname", file)).unwrap();
        }
        for command in [
            &["list"][..],
            &["compare", "runs/bad", "runs/good", "runs/other"],
            &["report", "runs/bad", "runs/good", "runs/other", "--out", "page"],
            &["report", "runs", "--out", "page"],
        ] {
            let printed = workshop.call(command);
            // No sentence about one widens the table of all.
            let widest = printed.stdout.lines().map(|line| line.chars().count()).max();
            assert!(command != ["list"] || widest < Some(120), "{}", printed.stdout);
            let told = printed.stdout + &printed.stderr;
            let page = std::fs::read_to_string(workshop.path("page/report.html")).unwrap_or_default();
            let _ = std::fs::remove_dir_all(workshop.path("page"));
            for run in ["runs/good", "runs/other"] {
                assert!(told.contains(run) || page.contains(run), "{command:?}: {told}");
            }
            // A lock's length says nothing: what it holds is read up to a bound.
            let is_said = if is_link { "a link or no plain file" } else { "are read" };
            let is_lock = !is_link && *file == bad.orchestrator_lock();
            assert!(printed.success && (told.contains(is_said) || is_lock), "{} {command:?}: {told}", file.display());
        }
    }
}

#[test]
fn one_runs_folder_does_not_hold_up_the_page_of_another() {
    let workshop = workshop();
    let bad = copy(&workshop);
    for file in
        [bad.metrics(), bad.validation_log(), bad.log("orchestrator"), bad.log("learner-0"), bad.recording(1, 0)]
    {
        sparse(&file);
    }
    // As long as it may be, without one line that is sound.
    File::create(bad.metrics()).unwrap().set_len(256 << 20).unwrap();
    let viewer = Viewer::start(&workshop, &[]);
    let began = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..16 {
            scope.spawn(|| viewer.get("/api/runs/bad/curves"));
        }
        std::thread::sleep(Duration::from_millis(200));
        for _ in 0..3 {
            assert_eq!(viewer.json("/api/runs/good")["card"]["done"], 300);
            assert_eq!(viewer.json("/api/runs").as_array().map(Vec::len), Some(2));
        }
        assert!(began.elapsed() < Duration::from_secs(30), "{:?}", began.elapsed());
    });
    assert!(viewer.stop());
}
