//! A file of a run that something damaged is named, with what to do; and that works.

use proto::checkpoint::Manifest;
use proto::digest::sha256;
use proto::run_folder::{RolloutName, RunFolder};
use std::path::Path;
use system_tests::{Printed, Workshop, binary, complete};

/// Refused with one error that names the file; the command in it, if it has one.
fn refused<'a>(printed: &'a Printed, file: &Path, remedy: &str) -> Option<&'a str> {
    let errors: Vec<&str> = printed.stderr.lines().filter(|line| line.starts_with("error: ")).collect();
    let [error] = errors[..] else { panic!("one error was expected: {printed:#?}") };
    let name = file.file_name().and_then(|name| name.to_str()).expect("a file with a name");
    assert!(!printed.success && error.contains(&format!("{name} is damaged (")), "{printed:#?}");
    assert!(error.contains(remedy), "`{remedy}` was expected in {error}");
    error.split('`').nth(1)
}

/// As after a disk that lost a part of it.
fn cut(file: &Path) {
    let whole = std::fs::read(file).expect("the file to damage");
    std::fs::write(file, &whole[..whole.len() / 2]).expect("a writable file");
}

/// As a person pastes it.
fn pasted(workshop: &Workshop, line: &str) -> Printed {
    let mut shell = workshop.program("sh");
    shell.args(["-c", line]);
    complete(shell)
}

/// A command that names the program alone, with its path.
fn with_program(line: &str) -> String {
    line.replacen("orchestrator", &binary("orchestrator").display().to_string(), 1)
}

#[test]
fn a_run_is_given_its_configuration_again() {
    let workshop = Workshop::new();
    complete(workshop.up("my run", 1, 3, 150)).result();
    let folder = workshop.run("my run").folder;
    // Every checkpoint holds what it was saved under.
    let config = folder.config();
    let configured = std::fs::read(&config).expect("a configuration");
    let manifests = |folder: &RunFolder| {
        let checkpoints = std::fs::read_dir(folder.checkpoints()).expect("checkpoints");
        let paths = checkpoints.map(|entry| entry.expect("an entry").path());
        paths.filter(|path| path.extension().is_some_and(|end| end == "json")).collect::<Vec<_>>()
    };
    // The newest one's is of a version with another key: the one before is taken.
    let newest = manifests(&folder).into_iter().max_by_key(|path| RolloutName::Manifest.rollout_of(path));
    let newest = newest.expect("a checkpoint");
    let manifest = Manifest::read(&newest).expect("a manifest");
    let other = format!("unknown = 1\n{}", manifest.config);
    let other = Manifest { config_sha256: sha256(other.as_bytes()), config: other, ..manifest };
    std::fs::write(&newest, other.seal()).expect("a writable file");
    for damage in [
        |file: &Path| std::fs::write(file, "unknown = 1").expect("a writable file"),
        |file: &Path| std::fs::write(file, "seed").expect("a writable file"),
        |file: &Path| {
            std::fs::remove_file(file).expect("a file to remove");
        },
    ] {
        damage(&config);
        let printed = workshop.call(&["status", "my run"]);
        let line = printed.stderr.split('`').nth_back(1).unwrap_or_else(|| panic!("a command: {printed:#?}"));
        assert!(!printed.success && line.starts_with("orchestrator config --of "), "{printed:#?}");
        assert!(pasted(&workshop, &with_program(line)).success, "{line}");
        assert_eq!(std::fs::read(&config).expect("it is there again"), configured, "{line}");
    }

    // Without a checkpoint that can be read the command has nothing to write, and leaves what is there.
    std::fs::write(&config, "seed").expect("a writable file");
    let manifests = manifests(&folder);
    assert!(!manifests.is_empty());
    for manifest in &manifests {
        cut(manifest);
    }
    let out = config.to_str().expect("a path of text");
    let printed = workshop.call(&["config", "--of", "my run", "--out", out]);
    assert!(!printed.success && printed.stderr.starts_with("error: "), "{printed:#?}");
    assert_eq!(std::fs::read(&config).expect("it is there still"), b"seed");
    // And is not named.
    workshop.call(&["status", "my run"]).refused("go on with the version that began the run");
}

#[test]
fn what_is_said_of_a_damaged_file_helps() {
    let workshop = Workshop::new();
    // With a space, which a shell must not see.
    let result = complete(workshop.up("my run", 1, 3, 300)).result();
    let folder = workshop.run("my run").folder;

    let summary = folder.summary();
    cut(&summary);
    refused(&workshop.call(&["status", "my run"]), &summary, "delete it");
    let printed = complete(workshop.resume("my run"));
    let line = refused(&printed, &summary, "writes it anew").expect("a command");
    std::fs::remove_file(&summary).expect("a damaged file to delete");
    assert_eq!(pasted(&workshop, line).result(), result, "{line}");
    assert!(workshop.call(&["status", "my run"]).success);

    // There is a second recording now, of that start. Not a word of it can be read, the first is compared all the same.
    let recordings = workshop.run("my run").recordings();
    assert_eq!(recordings.len(), 2);
    std::fs::write(&recordings[1], [0; 5000]).expect("a writable file");
    let replay = workshop.call(&["replay", "--check", "my run"]);
    assert_eq!(replay.status, Some(6), "{replay:#?}");
    assert!(replay.stderr.contains("does not begin with MCAP's magic bytes): it is passed over"), "{replay:#?}");
    std::fs::write(&recordings[0], [0; 5000]).expect("a writable file");
    let neither = workshop.call(&["replay", "--check", "my run"]);
    assert!(neither.status == Some(1) && neither.stderr.contains("is not an MCAP recording"), "{neither:#?}");

    // Two checkpoints are kept: where the newest is damaged, everybody takes the one before.
    let mut tensors: Vec<_> = std::fs::read_dir(folder.checkpoints())
        .expect("checkpoints")
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.extension().is_some_and(|kind| kind == "safetensors"))
        .collect();
    tensors.sort();
    let [.., before, newest] = &tensors[..] else { panic!("two checkpoints were expected: {tensors:?}") };
    let whole = std::fs::read(newest).expect("a checkpoint");
    cut(newest);
    let out = workshop.path("policy.onnx").display().to_string();
    let export = workshop.call(&["export", "my run", "--out", &out]);
    let name = |path: &Path| path.file_stem().and_then(|name| name.to_str()).expect("text").to_owned();
    assert!(export.success && export.stderr.contains(&format!("{}.json is taken", name(before))), "{export:#?}");
    std::fs::write(newest, whole).expect("a writable file");

    let evaluate = ["eval", "my run", "--split", "validation", "--objects", "novel", "--episodes", "6"];
    let evaluated = || assert!(workshop.call(&evaluate).success);
    let report = || workshop.call(&["report", "my run"]);
    evaluated();
    let evaluations = folder.root().join("evaluations");
    let [evaluation] = &std::fs::read_dir(&evaluations).expect("evaluations").collect::<Vec<_>>()[..] else {
        panic!("one evaluation was expected");
    };
    let evaluation = evaluation.as_ref().expect("a readable folder").path();
    cut(&evaluation.join("evaluation.json"));
    let without = report();
    let note = "evaluation.json: it is damaged (delete its folder, and evaluate again)";
    assert!(without.success && without.stderr.contains(note), "{without:#?}");
    std::fs::remove_dir_all(&evaluation).expect("a folder to delete");
    evaluated();
    let with = report();
    assert!(with.success && !with.stderr.contains("damaged"), "{with:#?}");

    let identity = folder.identity();
    cut(&identity);
    let printed = complete(workshop.resume("my run"));
    let line = refused(&printed, &identity, "begins another run like it with its weights").expect("a command");
    let next = pasted(&workshop, &format!("{} --run next", with_program(line)));
    assert_eq!(next.result().1, result.1, "{line}: it has the same budget");
    assert_ne!(next.result().0, result.0, "{line}: it trained on from other weights than before");

    // An evaluation has no weights to begin with.
    let evaluation =
        std::fs::read_dir(&evaluations).expect("evaluations").next().expect("one").expect("readable").path();
    cut(&evaluation.join("run.toml"));
    let printed = workshop.call(&["status", &evaluation.display().to_string()]);
    assert_eq!(refused(&printed, &evaluation.join("run.toml"), "delete its folder, and evaluate again"), None);
}
