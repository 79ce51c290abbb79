//! Every mistake gets one clear message, a non-zero exit, and leaves nothing behind.

use proto::config::Config;
use proto::evaluation::{EvaluationConfig, ObjectSet};
use proto::kitchen::Split;
use std::process::Command;
use system_tests::{Terminal, Workshop, complete, finish, start};

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
    assert!(workshop.call(&["stop", "run"]).success);
    finish(child);
    let figures = || std::fs::read(run.folder.metrics()).unwrap();
    let before = figures();
    let identity = || std::fs::read(run.folder.identity()).unwrap();
    let started = identity();
    for entry in std::fs::read_dir(run.folder.checkpoints()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|end| end == "safetensors") {
            std::fs::write(path, "garbage").unwrap();
        }
    }
    for why in ["no checkpoint in", "there is no checkpoint in"] {
        for again in [workshop.resume("run"), command(&workshop)] {
            complete(again).refused(&format!("this run has trained, but {why}"));
        }
        let _ = std::fs::remove_dir_all(run.folder.checkpoints());
    }
    std::fs::create_dir_all(run.folder.checkpoints()).unwrap();
    complete(workshop.resume("run")).refused("this run has trained, but there is no checkpoint in");
    assert_eq!(figures(), before);
    assert_eq!(identity(), started, "no start is on record that could not be");
}

const SEED: &str = "a seed is a whole number from 0 to 9223372036854775807";

/// What is typed, and a part of the answer.
const TYPED: &[(&str, &str)] = &[
    ("up --preset demmo", "did you mean `demo`?"),
    ("up --actors 0", "actors"),
    ("up --frames 0", "a whole number of frames from 1 on"),
    ("resume runs/a --frames 0", "a whole number of frames from 1 on"),
    ("up --preset demo --set ppo.lerning_rate=1e-3", "unknown key `lerning_rate` (did you mean `learning_rate`?)"),
    ("eval runs/a --set ppo.clip=0.2", "cannot be used with"),
    ("eval runs/a --config tiny.toml", "cannot be used with"),
    ("up --seed 1,2,3", "`orchestrator suite FILE --seed 1,2,3`"),
    ("up --seed 9223372036854775808", SEED),
    ("config --seed 9223372036854775808", SEED),
    ("eval --seed 9223372036854775808", SEED),
    ("suite table.toml --seed 9223372036854775808", SEED),
    ("config demo --out pipe", "pipe is no file: name another one with --out"),
    ("config demo --out .", ". is no file: name another one with --out"),
    ("replay --check nothing.mcap", "nothing.mcap"),
    ("eval nowhere", "nowhere does not exist"),
    ("eval", "RUN|CHECKPOINT"),
    ("eval --preset demo --split train --distribution fixed", "have no fixed episodes"),
    ("eval --preset demo --split training", "training"),
    ("eval --preset demo --actors 4", "actors"),
    ("eval bare", "there is no checkpoint in"),
    ("up --frames 2Mio", "2000000, 2_000_000, 2M or 2e6"),
    ("up --seed -1", "a seed is a whole number from 0 to"),
    ("up --env-command true", "serves no environments"),
    ("suite demo", "a suite is a TOML file"),
    ("suite papr --check", "; did you mean `paper`?"),
    ("up --preset ppo", "there is no preset `ppo`;"),
    ("up demo", "`--preset demo`"),
    ("resume a", "did you mean runs/a?"),
    ("status run/a", "did you mean runs/a?"),
    ("resume nowhere", "nowhere does not exist: no run began there; `orchestrator list`"),
    ("stop nowhere", "nowhere does not exist"),
    ("replay nowhere", "nowhere does not exist; `orchestrator list`"),
    ("resume runs/a --preset demo", "`orchestrator up --from RUN`"),
    ("eval runs/a/best", "--set validation.every_frames=N"),
    ("eval runs/a --kitchens 1,2", "those of a split: --split train, validation or test"),
    ("eval policy.onnx", "give the run, or a policy file"),
    ("eval policy.json", "give the run, or a file of one of these"),
    ("export runs/a --out policy.pt", "call it policy.onnx (for onnxruntime) or policy.safetensors"),
    ("export runs/a --format npz --out policy.onnx", "policy.onnx ends as another format"),
    ("export runs/a --format onnx --out policy.safetensors", "policy.safetensors ends as another format"),
    ("recover empty.mcap", "empty.mcap is empty"),
    ("recover policy.json", "policy.json is not an MCAP recording"),
    ("replay empty.mcap", "empty.mcap is empty"),
    ("replay --check empty.mcap", "empty.mcap is empty"),
    ("replay runs/a --episode 99999", "the recordings hold no episode 99999"),
    ("replay asked", "asked has no recordings"),
    ("replay asked --check", "asked is an evaluation without recordings"),
    ("resume asked", "asked is an evaluation"),
    ("eval asked", "asked is an evaluation of models/fetch.safetensors: give"),
    ("eval --preset demo --kitchens 5000..9000", "--kitchens 5000..9000: must be at most 1000 kitchens"),
    ("eval runs/../nowhere", ": runs/../nowhere does not exist"),
    ("up --preset demo --from runs/a", "runs/a holds another network"),
    ("up --preset point-nav-demo --from runs/a --run c", "arm_point_nav, this run of point_nav: their networks differ"),
    ("eval demo", "`orchestrator eval --preset demo` evaluates untrained ones"),
    ("logs runs/a --process actor-77", "runs/a holds no log of actor-77"),
    ("config runs/a", "`orchestrator config --of runs/a` prints that of a run"),
    ("up --preset demo --frames 1", "--frames 1 cannot be divided over 2 stages"),
    ("up --preset demo --hosts 2 --host-rank 0 --rendezvous 127.0.0.1:29400 --run b", "cannot share 1 learner"),
    ("up --preset demo --hosts 2 --host-rank 0 --rendezvous 127.0.0.1:29400", "several hosts need --run DIR"),
    ("up --preset demo --config nowhere.toml", "cannot read configuration nowhere.toml"),
    ("up --config nowhere.toml", "cannot read configuration nowhere.toml"),
    ("doctor --config nowhere.toml", "cannot read configuration nowhere.toml"),
    ("up --preset demo --config broken.toml", "broken.toml:1: the value after `=` is missing"),
    ("up --preset demo --config no-scene.toml", "nowhere/scene.toml cannot be used: there is no such file"),
    ("up --preset demo --from nowhere", "nowhere does not exist"),
    ("kitchens --scene nowhere.toml", "nowhere.toml: there is no such file"),
    ("kitchens --scene bare", "bare: is a folder: name the scene's file in it"),
    ("up --config demo", "there is no such file; `--preset demo` takes the preset"),
    ("config nowhere.toml", "there is no preset `nowhere.toml`: a file is given as `--config nowhere.toml`"),
    ("suite nowhere.toml", "nowhere.toml is no file, and no built-in suite (ablations, "),
    ("suite broken.toml", "broken.toml: line 1, `ppo.clip =`: the value after `=` is missing"),
    ("suite policy.json", "policy.json: it must be TOML: line 1, "),
    ("status runs", "runs is not a run folder: it holds runs, which `orchestrator list runs` shows"),
    ("compare runs/a policy.onnx", "policy.onnx is a file: give the folder of a run"),
    ("suite broken.toml --gpus 0,0", "--gpus: 0 is given twice"),
    ("suite broken.toml --gpus 0,", "--gpus: an empty name in the list"),
    ("suite broken.toml --gpus all", "--gpus 0,1"),
    ("suite broken.toml --seed 1,2,1", "--seed: 1 is given twice"),
    ("import nowhere.safetensors --run b", "nowhere.safetensors does not exist"),
    ("recover nowhere.mcap", "nowhere.mcap does not exist: name a recording, of a run a file in RUN/recordings"),
    ("report nowhere", "nowhere does not exist; `orchestrator list`"),
    ("report policy.onnx", "policy.onnx is a file: give the folder of a run"),
    ("replay policy.onnx", "policy.onnx is a file: give the folder of a run"),
    ("replay runs", "runs is not a run folder: it holds runs"),
    ("export policy.onnx --format npz --out arrays", "policy.onnx is a file: give the folder of a run"),
    ("view policy.onnx", "policy.onnx is a file: give the folder of a run"),
    ("config --of runs", "runs is not a run folder: it holds runs"),
    ("export runs/a", "`orchestrator export RUN --out policy.onnx`"),
    ("list nowhere", "nowhere is not a folder"),
    ("view nowhere", "nowhere is not a folder"),
    ("compare runs/a nowhere", "nowhere does not exist"),
    ("logs nowhere", "nowhere does not exist"),
    ("top nowhere", "nowhere does not exist"),
    ("export nowhere --out p.onnx", "nowhere does not exist"),
    ("up --env-command true --env-declaration mine.toml", "mine.toml:1: missing key `doc`"),
    ("up --env-command true --env-declaration nowhere.toml", "cannot read nowhere.toml"),
    ("up --preset gym", "needs `--env gymnasium:ID`, or a task of your own"),
    ("report --table nowhere.json", "nowhere.json does not exist: `orchestrator report RUN --table nowhere.json`"),
    ("report --table policy.json", "policy.json keeps no table: name a file that"),
    ("report runs/a --out policy.json", "policy.json is a file: choose a folder with --out"),
    ("eval pool", "name the policy file"),
    ("up --preset demo --run policy.json", "policy.json is a file, or below one: choose another folder"),
    ("up --preset demo --run runs/a", "for another run choose another folder"),
    ("config --of nowhere", "nowhere does not exist"),
    ("resume runs/a --frames 60", "frames already, and a budget of 60 cannot take them back"),
    ("config demo --set task=pick", "tasks: arm_point_nav, point_nav"),
    ("config demo --config mine.yaml", "it must be TOML"),
    ("config demo --config lr.toml", "lr.toml:2: unknown key `lr`; here it is `ppo.learning_rate = RATE`"),
    ("config demo --config epochs.toml", "epochs.toml:1: ppo.epochs = 100: must be 1 to 64"),
    ("up --set ppo.learning_rate 1e-3", "`--set ppo.learning_rate=1e-3`"),
    ("up --task point_nav", "`--preset point-nav-demo`"),
    ("up --env gymnasium", "as in gymnasium:CartPole-v1"),
    ("up --env ./mine.py", "as in ./mine.py:make_env"),
    ("up --env gymnasium:CartPole-v1 --set task=point_nav", "task = \"point_nav\" is a built-in task"),
    ("up --env gymnasium:CartPole-v1 --python /no/python", "--python /no/python does not exist"),
    ("recover runs/a", "runs/a is a folder: name a recording, of a run a file in runs/a/recordings"),
    ("allow pool", "pool is not a run folder"),
    ("eval pool/policy.safetensors", "policy.safetensors is no safetensors file: give the folder of a run"),
    ("up --preset demo --from policy.onnx", "policy.onnx is ONNX"),
    ("import policy.onnx --run b", "policy.onnx is ONNX: weights are a policy file"),
    ("import junk.safetensors --run b", "junk.safetensors is no safetensors file: weights are a policy file"),
    ("delete runs/a", "then `rm -r RUN`"),
    ("status", "the newest is `orchestrator status runs/a`"),
    ("stop", "the newest is `orchestrator stop runs/a`"),
    ("resume", "the newest is `orchestrator resume runs/a`"),
    ("suite no-targets.toml --check", "an episode of point-nav-demo-1 has no target"),
    ("suite lr.suite.toml --check", "config.ppo.lr: unknown key `lr`; here it is `ppo.learning_rate = RATE`"),
    ("config demo --config pool", "pool: it is a folder"),
    ("view --address 127.0.0.1:8766", "--address 127.0.0.1 --port 8766"),
];

/// What is not understood is answered with what to type.
#[test]
fn what_a_newcomer_types() {
    let workshop = Workshop::new();
    complete(workshop.up("runs/a", 1, 1, 100)).result();
    std::fs::create_dir_all(workshop.path("bare/checkpoints")).unwrap();
    std::fs::write(workshop.path("empty.mcap"), "").unwrap();
    let run = workshop.run("runs/a").folder;
    let mut config = Config::of_run(&run).unwrap();
    let checkpoint = Some("models/fetch.safetensors".to_owned());
    let asked = EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 6);
    config.evaluation = Some(EvaluationConfig { checkpoint, ..asked });
    (config.recording.enabled, config.actors.count) = (false, 5);
    std::fs::create_dir(workshop.path("asked")).unwrap();
    std::fs::write(workshop.path("asked/config.toml"), config.to_toml()).unwrap();
    std::fs::copy(run.identity(), workshop.path("asked/run.toml")).unwrap();
    for file in ["policy.onnx", "policy.json"] {
        std::fs::write(workshop.path(file), "{}").unwrap();
    }
    std::fs::write(workshop.path("broken.toml"), "ppo.clip = ").unwrap();
    std::fs::create_dir(workshop.path("pool")).unwrap();
    for (file, text) in [
        ("mine.toml", "[[metrics]]\nname = \"fast\"\nover = \"last\"\nvalue = \"reward\"\n"),
        ("mine.yaml", "seed: 1\n"),
        ("mine.py", ""),
        ("lr.toml", "[ppo]\nlr = 1e-3\n"),
        ("epochs.toml", "ppo.epochs = 100\n"),
        ("junk.safetensors", "what this is, is no safetensors file"),
        ("lr.suite.toml", "seeds = [1]\n[[runs]]\npreset = \"demo\"\nconfig.ppo.lr = 1e-3\n"),
        (
            "no-targets.toml",
            "seeds = [1]\n[[evaluations]]\nsplit = \"test\"\nobjects = \"novel\"\n[[runs]]\npreset = \"point-nav-demo\"\n",
        ),
        ("pool/policy.safetensors", ""),
    ] {
        std::fs::write(workshop.path(file), text).unwrap();
    }
    std::fs::write(workshop.path("no-scene.toml"), "scenes = [\"nowhere/scene.toml\"]").unwrap();
    // No device: where this is broken it would be gone.
    assert!(Command::new("mkfifo").arg(workshop.path("pipe")).status().unwrap().success());
    for &(typed, help) in TYPED {
        let typed: Vec<&str> = typed.split(' ').collect();
        let printed = workshop.call(&typed);
        printed.refused(help);
        // What is wrong in itself is wrong whenever it is called; these two can be right another time.
        let expected = if ["eval bare", "up --env-command true"].contains(&&*typed.join(" ")) { 1 } else { 2 };
        assert_eq!(printed.status, Some(expected), "{typed:?}");
    }
    assert!(!workshop.path("c").exists(), "what is refused leaves no folder");
    // The newest run, which has trained nothing, has nothing to evaluate.
    std::fs::create_dir(workshop.path("runs/fresh")).unwrap();
    std::fs::copy(run.config(), workshop.path("runs/fresh/config.toml")).unwrap();
    let identity = std::fs::read_to_string(run.identity()).unwrap();
    let later = identity.replace("created_unix_s = 1", "created_unix_s = 2");
    std::fs::write(workshop.path("runs/fresh/run.toml"), later).unwrap();
    for (command, newest) in [("status", "fresh"), ("eval", "a"), ("report", "a")] {
        workshop.call(&[command]).refused(&format!("the newest is `orchestrator {command} runs/{newest}`"));
    }
    let presets = workshop.call(&["presets"]).good().stdout;
    assert!(presets.starts_with("To begin with, on a CPU\n  demo "), "{presets}");
    std::fs::create_dir(workshop.path("empty")).unwrap();
    let list = workshop.call(&["list", "empty"]);
    assert!(list.success && list.stderr.contains("no run yet: `orchestrator up` starts one"), "{list:#?}");
}

#[test]
fn a_filter_of_the_log_is_heard_and_a_wrong_one_named() {
    let workshop = Workshop::new();
    let told = |filter: &str| {
        let mut command = workshop.orchestrator(&["presets"]);
        command.env("STILLROOM_LOG", filter);
        let printed = complete(command).good();
        printed.stderr
    };
    let wrong = told("orchestrator=loud");
    assert!(wrong.contains("STILLROOM_LOG is not a filter and is ignored"), "{wrong}");
    assert_eq!(told("warn,wire=debug"), "");
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
            workshop.call(&args).refused(problem);
        }
        workshop.call(&["suite", file]).refused(problem);
    }
}

#[test]
fn a_result_that_cannot_be_written_is_a_failure() {
    let workshop = Workshop::new();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("Linux has it");
    let mut command = workshop.orchestrator(&["presets"]);
    command.stdout(full);
    complete(command).refused("cannot write to standard output: No space left on device");
}

/// It gives EIO, where a pipe without a reader gives EPIPE. Nobody is left who could miss the result.
#[test]
fn a_terminal_that_was_closed_makes_no_command_fail() {
    let workshop = Workshop::new();
    for command in [&["presets"][..], &["config", "--preset", "demo"], &["completions", "bash"]] {
        let mut command = workshop.orchestrator(command);
        command.stdout(Terminal::closed());
        let printed = complete(command);
        assert!(printed.success && printed.stderr.is_empty(), "{printed:#?}");
    }
}

#[test]
fn a_current_folder_that_was_removed_is_named() {
    let workshop = Workshop::new();
    let first = "mkdir gone && cd gone && rmdir ../gone";
    let command = workshop.limited(first, &workshop.orchestrator(&["list", "/tmp"]));
    complete(command).refused("the current folder cannot be used: change to another one: No such file");
}

#[test]
fn the_doctor_finds_what_is_wrong_with_a_run_folder() {
    let workshop = Workshop::new();
    std::fs::write(workshop.path("file"), "").unwrap();
    std::fs::create_dir(workshop.path("full")).unwrap();
    std::fs::write(workshop.path("full/file"), "").unwrap();
    for (run, problem) in [("full", Some("is not empty, and it is no run")), ("file/run", Some("file")), ("new", None)]
    {
        let printed = workshop.call(&["doctor", "--preset", "demo", "--run", run]);
        let found: Vec<&str> = printed.stdout.lines().filter(|line| line.contains("PROBLEM")).collect();
        match problem {
            Some(problem) => assert!(!printed.success && found.concat().contains(problem), "{printed:#?}"),
            None => assert!(printed.success && printed.stdout.contains("new is free"), "{printed:#?}"),
        }
        // `up` is of the same opinion.
        if let Some(problem) = problem {
            workshop.call(&["up", "--preset", "demo", "--run", run]).refused(problem);
        }
    }
}

#[test]
fn too_few_open_files_are_refused_if_the_limit_cannot_be_raised() {
    let workshop = Workshop::new();
    let printed = complete(workshop.limited("ulimit -n 100", &workshop.up("few", 2, 2, 400)));
    printed.refused("more actors than open files allow: with 2 actors and 1 learner a process needs up to");
    printed.refused("may have 100 (the hard limit");
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
    complete(command).refused("not-there");

    let other = workshop.path("other-torch");
    std::fs::create_dir_all(other.join("lib")).unwrap();
    std::fs::write(other.join("lib/libtorch_cpu.so"), "").unwrap();
    std::fs::write(other.join("build-version"), "2.4.1\n").unwrap();
    let mut command = workshop.up("old", 1, 1, 100);
    command.env("LIBTORCH", &other);
    let printed = complete(command);
    printed.refused("2.4.1");
    printed.refused("2.11");
}

#[test]
fn a_run_folder_in_use_or_already_there() {
    let workshop = Workshop::new();
    let child = start(workshop.up("busy", 1, 2, 5_000));
    workshop.run("busy").wait_for_rollouts(2);
    complete(workshop.up("busy", 1, 2, 5_000)).refused("busy");
    complete(workshop.resume("busy")).refused("busy");
    workshop.call(&["stop", "busy"]).good();
    assert!(finish(child).success);
    complete(workshop.up("busy", 1, 2, 5_000)).refused("resume");
}

#[test]
fn a_truncated_recording() {
    let workshop = Workshop::new();
    complete(workshop.up("cut", 1, 2, 600)).result();
    let recording = workshop.run("cut").recordings().remove(0);
    let length = std::fs::metadata(&recording).unwrap().len();
    std::fs::OpenOptions::new().write(true).open(&recording).unwrap().set_len(length * 2 / 3).unwrap();

    let printed = workshop.call(&["replay", "--check", recording.to_str().unwrap()]);
    assert!(printed.stderr.contains("orchestrator recover"), "{printed:#?}");
    assert_eq!(printed.status, Some(proto::exit::EXIT_INCOMPLETE), "{printed:#?}");
    let repaired = workshop.call(&["recover", recording.to_str().unwrap()]);
    assert_eq!(repaired.status, Some(proto::exit::EXIT_INCOMPLETE), "what came after the cut is lost: {repaired:#?}");
    assert!(repaired.stdout.contains("the file ends here, before its end mark"), "{repaired:#?}");
    // What is there agrees, but the file is not what was recorded, and neither is the run.
    for path in [recording.to_str().unwrap(), "cut"] {
        let printed = workshop.call(&["replay", "--check", path]);
        assert_eq!(printed.status, Some(proto::exit::EXIT_INCOMPLETE), "{printed:#?}");
        assert!(printed.stdout.contains("differences: 0"), "{printed:#?}");
        assert!(printed.stderr.contains("was repaired, and not all was there"), "{printed:#?}");
    }
    let replay = workshop.call(&["replay", "--check", "cut"]);
    assert!(replay.stderr.contains("of the 600 steps that the run has"), "{replay:#?}");

    std::fs::write(workshop.path("noise.mcap"), [7u8; 4096]).unwrap();
    workshop.call(&["replay", "--check", "noise.mcap"]).refused("noise.mcap");
}
