//! Every mistake gets one clear message, a non-zero exit, and leaves nothing behind.

use std::path::Path;
use std::process::{Command, Stdio};
use system_tests::{Printed, Terminal, Workshop, complete, finish, start, tell};

/// Fails, says `expected` on standard error, and does not panic.
fn refused(printed: &Printed, expected: &str) {
    assert!(!printed.success, "it should have been refused: {printed:#?}");
    assert!(printed.stderr.contains(expected), "expected `{expected}` in {printed:#?}");
    assert!(!printed.stderr.contains("panicked"), "{printed:#?}");
}

/// It would begin anew, over its own figures: by `resume` and by the command of a launcher that begins and goes on.
#[test]
fn a_run_whose_checkpoints_are_gone_is_not_gone_on_with() {
    let workshop = Workshop::new();
    let command = |workshop: &Workshop| {
        let mut up = workshop.up("run", 1, 1, 20_000);
        up.args(["--hosts", "1", "--host-rank", "0"]);
        up
    };
    let child = start(command(&workshop));
    let run = workshop.run("run");
    run.wait_for_rollouts(3);
    assert!(complete(workshop.orchestrator(&["stop", "run"])).success);
    finish(child);
    let figures = || std::fs::read(run.folder.metrics()).unwrap();
    let before = figures();
    std::fs::remove_dir_all(run.folder.checkpoints()).unwrap();
    for _ in ["gone", "empty"] {
        for again in [workshop.resume("run"), command(&workshop)] {
            refused(&complete(again), "this run has trained, but there is no checkpoint in");
        }
        std::fs::create_dir_all(run.folder.checkpoints()).unwrap();
    }
    assert_eq!(figures(), before);
}

#[test]
fn mistakes_on_the_command_line() {
    let workshop = Workshop::new();
    refused(&complete(workshop.orchestrator(&["up", "--preset", "demmo"])), "did you mean `demo`?");
    refused(&complete(workshop.orchestrator(&["up", "--actors", "0"])), "actors");
    refused(&complete(workshop.orchestrator(&["up", "--frames", "0"])), "frames");
    let set = complete(workshop.orchestrator(&["up", "--preset", "demo", "--set", "ppo.lerning_rate=1e-3"]));
    refused(&set, "'--set <KEY=VALUE>': unknown key `lerning_rate` (did you mean `learning_rate`?)");
    // A run has its configuration.
    refused(&complete(workshop.orchestrator(&["eval", "runs/a", "--set", "ppo.clip=0.2"])), "cannot be used with");
    refused(&complete(workshop.orchestrator(&["eval", "runs/a", "--config", "tiny.toml"])), "cannot be used with");
    refused(&complete(workshop.orchestrator(&["up", "--seed", "1,2,3"])), "`orchestrator suite FILE --seed 1,2,3`");
    for command in [&["up"][..], &["config"], &["eval"], &["suite", "table.toml"]] {
        let command = [command, &["--seed", "9223372036854775808"]].concat();
        refused(&complete(workshop.orchestrator(&command)), "a seed is a whole number from 0 to 9223372036854775807");
    }
    // No device: where this is broken it would be gone.
    assert!(Command::new("mkfifo").arg(workshop.path("pipe")).status().unwrap().success());
    for other in ["pipe", "."] {
        let printed = complete(workshop.orchestrator(&["config", "demo", "--out", other]));
        refused(&printed, &format!("{other} is no file: name another one with --out"));
    }
    refused(&complete(workshop.orchestrator(&["replay", "--check", "nothing.mcap"])), "nothing.mcap");
}

/// What is not understood is answered with what to type.
#[test]
fn what_a_newcomer_types() {
    let workshop = Workshop::new();
    complete(workshop.up("runs/a", 1, 1, 100)).result();
    for file in ["policy.onnx", "policy.json"] {
        std::fs::write(workshop.path(file), "{}").unwrap();
    }
    for (typed, help) in [
        ("up --set learning_rate=1e-3", "did you mean `ppo.learning_rate` or `reward.lagrangian.learning_rate`?"),
        ("up --set device=cuda", "did you mean `learner.device`?"),
        ("up --frames 2Mio", "2000000, 2_000_000, 2M or 2e6"),
        ("up --seed -1", "a seed is a whole number from 0 to"),
        ("up demo", "`--preset demo`"),
        ("train", "`orchestrator up` does that"),
        ("resume a", "did you mean runs/a?"),
        ("resume nowhere", "nowhere does not exist: no run began there; `orchestrator list`"),
        ("stop nowhere", "nowhere does not exist"),
        ("replay nowhere", "nowhere does not exist; `orchestrator list`"),
        ("resume runs/a --preset demo", "`orchestrator up --from RUN`"),
        ("eval runs/a/best", "--set validation.every_frames=N"),
        ("eval runs/a --kitchens 99", "for built-in kitchens type --split train, valid or test"),
        ("eval policy.onnx", "give the run, or a policy file"),
        ("eval policy.json", "give the run, or a file of one of these"),
        ("export runs/a --out policy.pt", "call it policy.onnx (for onnxruntime) or policy.safetensors"),
        ("view --address 127.0.0.1:8766", "--address 127.0.0.1 --port 8766"),
    ] {
        let typed: Vec<&str> = typed.split(' ').collect();
        refused(&complete(workshop.orchestrator(&typed)), help);
    }
    assert!(complete(workshop.orchestrator(&["man", "up"])).success && !workshop.path("up").exists());
    std::fs::create_dir(workshop.path("empty")).unwrap();
    let list = complete(workshop.orchestrator(&["list", "empty"]));
    assert!(list.success && list.stderr.contains("no run yet: `orchestrator up` starts one"), "{list:#?}");
}

#[test]
fn a_filter_of_the_log_is_heard_and_a_wrong_one_named() {
    let workshop = Workshop::new();
    let told = |filter: &str| {
        let mut command = workshop.orchestrator(&["presets"]);
        command.env("STILLROOM_LOG", filter);
        let printed = complete(command);
        assert!(printed.success, "{printed:#?}");
        printed.stderr
    };
    let wrong = told("orchestrator=loud");
    assert!(wrong.contains("STILLROOM_LOG is not a filter and is ignored"), "{wrong}");
    assert_eq!(told("warn,wire=debug"), "");
}

#[test]
fn an_unknown_key_is_named_with_file_line_and_neighbour() {
    let workshop = Workshop::new();
    std::fs::write(workshop.path("wrong.toml"), "[ppo]\n\nlerning_rate = 1\n").unwrap();
    let printed = complete(workshop.orchestrator(&["up", "--preset", "demo", "--config", "wrong.toml"]));
    refused(&printed, "wrong.toml:3: unknown key `lerning_rate` (did you mean `learning_rate`?)");
}

#[test]
fn what_is_no_ordinary_file_is_not_read() {
    let workshop = Workshop::new();
    assert!(Command::new("mkfifo").arg(workshop.path("pipe.toml")).status().unwrap().success());
    std::fs::File::create(workshop.path("huge.toml")).unwrap().set_len(100 << 20).unwrap();
    for (file, problem) in [
        ("pipe.toml", "pipe.toml: it is not an ordinary file"),
        ("/dev/zero", "/dev/zero: it is not an ordinary file"),
        ("huge.toml", "huge.toml: it has more than the 4194304 bytes"),
    ] {
        for named in [true, false] {
            let mut args = vec!["up", "--config", file];
            args.extend(if named { &["--preset", "demo"][..] } else { &[] });
            refused(&complete(workshop.orchestrator(&args)), problem);
        }
        refused(&complete(workshop.orchestrator(&["suite", file])), problem);
    }
}

/// A run folder of somebody else's can hold anything in the place of its files.
#[test]
fn pipes_and_devices_in_a_run_folder_are_not_read() {
    let workshop = Workshop::new();
    complete(workshop.up("runs/good", 1, 2, 300)).result();
    let bad = workshop.run("runs/bad").folder;
    let commands: [&[&str]; 5] = [
        &["status", "runs/bad"],
        &["list"],
        &["report", "runs/bad", "--out", "page.html"],
        &["replay", "--check", "runs/bad"],
        &["resume", "runs/bad"],
    ];
    // Commands that need not read the file, or of which it is no run any more.
    for (victim, unread) in [
        (bad.identity(), &["list", "replay"][..]),
        (bad.config(), &["replay", "resume"]),
        (bad.summary(), &[]),
        (bad.metrics(), &["replay", "resume"]),
        (bad.recording(1, 0), &["status", "list", "report", "resume"]),
    ] {
        for pipe in [true, false] {
            let copied =
                Command::new("cp").args(["-r", "runs/good", "runs/bad"]).current_dir(workshop.path("")).status();
            assert!(copied.unwrap().success());
            std::fs::remove_file(&victim).unwrap();
            if pipe {
                assert!(Command::new("mkfifo").arg(&victim).status().unwrap().success());
            } else {
                std::os::unix::fs::symlink("/dev/zero", &victim).unwrap();
            }
            for command in commands {
                // None waits for ever, and none takes it for what it should be.
                let printed = complete(workshop.orchestrator(command));
                let told = printed.stderr + &printed.stdout;
                let told = told.contains("a link or no plain file");
                assert!(told || unread.contains(&command[0]), "{} {command:?}", victim.display());
            }
            std::fs::remove_dir_all(bad.root()).unwrap();
        }
    }
}

#[test]
fn a_result_that_cannot_be_written_is_a_failure() {
    let workshop = Workshop::new();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("Linux has it");
    let mut command = workshop.orchestrator(&["presets"]);
    command.stdout(full);
    refused(&complete(command), "cannot write to standard output: No space left on device");
}

/// It gives EIO, where a pipe without a reader gives EPIPE. Nobody is left who could miss the result.
#[test]
fn a_terminal_that_was_closed_makes_no_command_fail() {
    let workshop = Workshop::new();
    for command in [&["presets"][..], &["config", "--preset", "demo"], &["completions", "bash"], &["man"]] {
        let mut command = workshop.orchestrator(command);
        command.stdout(Terminal::closed());
        let printed = complete(command);
        assert!(printed.success && printed.stderr.is_empty(), "{printed:#?}");
    }
}

#[test]
fn a_current_folder_that_was_removed_is_named() {
    let workshop = Workshop::new();
    let list = workshop.orchestrator(&["list", "/tmp"]);
    let mut command = Command::new("sh");
    command.args(["-c", "mkdir gone && cd gone && rmdir ../gone && exec \"$0\" \"$@\""]);
    command.arg(list.get_program()).args(list.get_args()).current_dir(workshop.path(""));
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    refused(&complete(command), "the current folder cannot be used: change to another one: No such file");
}

#[test]
fn a_terminal_is_given_no_orders_by_a_file() {
    let workshop = Workshop::new();
    std::fs::write(workshop.path("loud.toml"), "\"a\\u001b]0;mine\\u0007\\u001b[2J\" = 1\n").unwrap();
    let printed = complete(workshop.orchestrator(&["up", "--preset", "demo", "--config", "loud.toml"]));
    refused(&printed, "unknown key `a\\u{1b}]0;mine\\u{7}\\u{1b}[2J`");
    assert!(!printed.stderr.contains(['\u{1b}', '\u{7}']), "{printed:#?}");
}

#[test]
fn a_temporary_folder_with_too_long_a_name() {
    let workshop = Workshop::new();
    let long = workshop.path(&"long".repeat(20));
    std::fs::create_dir(&long).unwrap();
    let mut command = workshop.up("far", 1, 1, 100);
    command.env("TMPDIR", &long);
    refused(&complete(command), "set TMPDIR to a shorter one");
    assert!(!workshop.path("far").exists(), "nothing is left of a run that never began");
    let mut doctor = workshop.orchestrator(&["doctor", "--preset", "demo"]);
    doctor.env("TMPDIR", &long);
    let Printed { success, stdout, .. } = complete(doctor);
    assert!(!success && stdout.contains("set TMPDIR to a shorter one"), "{stdout}");
}

#[test]
fn a_temporary_folder_that_is_not_there_is_named_before_anything_is_made() {
    let workshop = Workshop::new();
    let doctor = ["doctor", "--preset", "demo"];
    for mut command in
        [workshop.up("far", 1, 1, 100), workshop.orchestrator(&["clean"]), workshop.orchestrator(&doctor)]
    {
        command.env("TMPDIR", workshop.path("gone"));
        let Printed { success, stdout, stderr, .. } = complete(command);
        let told = stdout + &stderr;
        let why = "gone cannot be used: No such file or directory (os error 2). Set TMPDIR to a folder";
        assert!(!success && told.matches(why).count() == 1, "{told}");
    }
    assert!(!workshop.path("far").exists(), "nothing is left of a run that never began");
}

#[test]
fn the_doctor_finds_what_is_wrong_with_a_run_folder() {
    let workshop = Workshop::new();
    std::fs::write(workshop.path("file"), "").unwrap();
    std::fs::create_dir(workshop.path("full")).unwrap();
    std::fs::write(workshop.path("full/file"), "").unwrap();
    for (run, problem) in [("full", Some("is not empty, and it is no run")), ("file/run", Some("file")), ("new", None)]
    {
        let printed = complete(workshop.orchestrator(&["doctor", "--preset", "demo", "--run", run]));
        let found: Vec<&str> = printed.stdout.lines().filter(|line| line.contains("PROBLEM")).collect();
        match problem {
            Some(problem) => assert!(!printed.success && found.concat().contains(problem), "{printed:#?}"),
            None => assert!(printed.success && printed.stdout.contains("new is free"), "{printed:#?}"),
        }
        // `up` is of the same opinion.
        if let Some(problem) = problem {
            refused(&complete(workshop.orchestrator(&["up", "--preset", "demo", "--run", run])), problem);
        }
    }
}

#[test]
fn more_actors_than_memory_allows() {
    let workshop = Workshop::new();
    refused(&complete(workshop.up("crowd", 512, 256, 1_000_000)), "memory");
    assert!(!workshop.path("crowd").exists(), "nothing is left of a run that never began");
}

#[test]
fn a_dev_shm_that_is_too_small() {
    let workshop = Workshop::new();
    // A mount namespace of our own, in which /dev/shm has Docker's problem.
    let up = workshop.up("small", 4, 16, 1_000);
    let mut command = Command::new("unshare");
    command.args(["--user", "--map-root-user", "--mount", "sh", "-c"]);
    command.arg("mount -t tmpfs -o size=4m tmpfs /dev/shm && exec \"$0\" \"$@\"");
    command.arg(up.get_program()).args(up.get_args()).current_dir(workshop.path(""));
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let printed = complete(command);
    if printed.stderr.contains("unshare:") || printed.stderr.contains("mount:") {
        tell(&format!("skipped: this machine allows no mount namespaces: {}", printed.stderr));
        return;
    }
    refused(&printed, "/dev/shm");
}

#[test]
fn too_few_open_files_are_refused_if_the_limit_cannot_be_raised() {
    let workshop = Workshop::new();
    let printed = complete(workshop.limited("ulimit -n 100", &workshop.up("few", 2, 2, 400)));
    refused(&printed, "more actors than open files allow: with 2 actors and 1 learner a process needs up to");
    refused(&printed, "may have 100 (the hard limit");
    assert!(!workshop.path("few").exists(), "nothing is left of a run that never began");
    let doctor = workshop.orchestrator(&["doctor", "--preset", "demo"]);
    let printed = complete(workshop.limited("ulimit -n 100", &doctor));
    let row = printed.stdout.lines().find(|line| line.starts_with("open files")).expect("a finding of its own");
    assert!(row.contains("PROBLEM") && !printed.success, "{printed:#?}");

    // The orchestrator has 64 open files in such a run and the learner 60, both a few more for moments.
    complete(workshop.limited("ulimit -Sn 56", &workshop.up("raised", 2, 2, 400))).result();
}

#[test]
fn a_libtorch_that_is_missing_or_of_another_version() {
    let workshop = Workshop::new();
    let mut command = workshop.up("none", 1, 1, 100);
    command.env("LIBTORCH", workshop.path("not-there"));
    refused(&complete(command), "not-there");

    let other = workshop.path("other-torch");
    std::fs::create_dir_all(other.join("lib")).unwrap();
    std::fs::write(other.join("lib/libtorch_cpu.so"), "").unwrap();
    std::fs::write(other.join("build-version"), "2.4.1\n").unwrap();
    let mut command = workshop.up("old", 1, 1, 100);
    command.env("LIBTORCH", &other);
    let printed = complete(command);
    refused(&printed, "2.4.1");
    refused(&printed, "2.11");
}

#[test]
fn a_run_folder_in_use_or_already_there() {
    let workshop = Workshop::new();
    let child = start(workshop.up("busy", 1, 2, 5_000));
    workshop.run("busy").wait_for_rollouts(2);
    refused(&complete(workshop.up("busy", 1, 2, 5_000)), "busy");
    refused(&complete(workshop.resume("busy")), "busy");
    let stop = complete(workshop.orchestrator(&["stop", "busy"]));
    assert!(stop.success, "{stop:#?}");
    assert!(finish(child).success);
    refused(&complete(workshop.up("busy", 1, 2, 5_000)), "resume");
}

#[test]
fn corrupt_checkpoints() {
    let workshop = Workshop::new();
    let run = workshop.run("torn");
    let child = start(workshop.up("torn", 1, 2, 2_000));
    run.wait_for_rollouts(4);
    system_tests::signal(child.id(), rustix::process::Signal::INT);
    assert!(finish(child).success);

    let tensors = |path: &Path| path.extension().is_some_and(|end| end == "safetensors");
    let mut files: Vec<_> = std::fs::read_dir(run.folder.checkpoints())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| tensors(path))
        .collect();
    files.sort();
    let newest = files.last().unwrap();

    // The newest one torn: named, skipped, and the run goes on from the one before.
    let length = std::fs::metadata(newest).unwrap().len();
    std::fs::OpenOptions::new().write(true).open(newest).unwrap().set_len(length / 2).unwrap();
    let name = newest.file_stem().unwrap().to_str().unwrap();
    let printed = complete(workshop.resume("torn"));
    printed.result();
    assert!(printed.stderr.contains(name), "the torn checkpoint is named: {printed:#?}");

    // All of a run's checkpoints torn: refused.
    let child = start(workshop.up("all-torn", 1, 2, 2_000));
    let run = workshop.run("all-torn");
    run.wait_for_rollouts(4);
    system_tests::signal(child.id(), rustix::process::Signal::INT);
    assert!(finish(child).success);
    for entry in std::fs::read_dir(run.folder.checkpoints()).unwrap() {
        let path = entry.unwrap().path();
        if tensors(&path) {
            std::fs::write(&path, "garbage").unwrap();
        }
    }
    let identity = || std::fs::read(run.folder.identity()).unwrap();
    let before = identity();
    refused(&complete(workshop.resume("all-torn")), "this run has trained, but no checkpoint in");
    assert_eq!(identity(), before, "no start is on record that could not be");
}

#[test]
fn a_truncated_recording() {
    let workshop = Workshop::new();
    complete(workshop.up("cut", 1, 2, 600)).result();
    let recording = workshop.run("cut").recordings().remove(0);
    let length = std::fs::metadata(&recording).unwrap().len();
    std::fs::OpenOptions::new().write(true).open(&recording).unwrap().set_len(length * 2 / 3).unwrap();

    let printed = complete(workshop.orchestrator(&["replay", "--check", recording.to_str().unwrap()]));
    assert!(printed.stderr.contains("orchestrator recover"), "{printed:#?}");
    assert_eq!(printed.status, Some(proto::exit::EXIT_INCOMPLETE), "{printed:#?}");
    let repaired = complete(workshop.orchestrator(&["recover", recording.to_str().unwrap()]));
    assert_eq!(repaired.status, Some(proto::exit::EXIT_INCOMPLETE), "what came after the cut is lost: {repaired:#?}");
    assert!(repaired.stdout.contains("the file ends here, before its end mark"), "{repaired:#?}");
    // What is there agrees, but the file is not what was recorded, and neither is the run.
    for path in [recording.to_str().unwrap(), "cut"] {
        let printed = complete(workshop.orchestrator(&["replay", "--check", path]));
        assert_eq!(printed.status, Some(proto::exit::EXIT_INCOMPLETE), "{printed:#?}");
        assert!(printed.stdout.contains("differences: 0"), "{printed:#?}");
        assert!(printed.stderr.contains("was repaired, and not all was there"), "{printed:#?}");
    }
    let replay = complete(workshop.orchestrator(&["replay", "--check", "cut"]));
    assert!(replay.stderr.contains("of the 600 steps that the run has"), "{replay:#?}");

    std::fs::write(workshop.path("noise.mcap"), [7u8; 4096]).unwrap();
    refused(&complete(workshop.orchestrator(&["replay", "--check", "noise.mcap"])), "noise.mcap");
}
