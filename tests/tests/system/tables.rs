//! What is printed of runs: logs, comparisons, tables as JSON; and what is made of the command line itself.

use serde_json::Value;
use std::fs::OpenOptions;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::Command;
use system_tests::{Workshop, complete, finish, start};

fn row<'a>(table: &'a Value, name: &str) -> &'a Value {
    let rows = table.as_array().expect("rows");
    &rows.iter().find(|row| row["name"] == name).unwrap_or_else(|| panic!("no {name} in {rows:#?}"))["values"]
}

/// NCCL does, when it is asked for its reasons; its lines would stand between the learner's events.
#[test]
fn what_a_library_prints_in_a_learner_is_in_its_log_and_no_event() {
    const LINE: &str = "[0] NCCL INFO Channel 00/08 : 0 1";
    let workshop = Workshop::new();
    let child = start(workshop.up("run", 2, 2, 2000));
    let run = workshop.run("run");
    run.wait_for_rollouts(1);
    let learner = run.processes("--rank 0 ")[0];
    let mut output = OpenOptions::new().write(true).open(format!("/proc/{learner}/fd/1")).expect("it lives");
    writeln!(output, "{LINE}").expect("a pipe that is read");
    drop(output);
    let printed = finish(child);
    assert!(printed.success && !printed.stderr.contains("no event"), "{printed:#?}");
    let log = run.log("learner-0");
    assert!(log.lines().any(|line| line == LINE), "{log}");
    assert!(printed.stderr.contains(&format!("learner-0: {LINE}")), "and shown as its words: {printed:#?}");
}

#[test]
fn logs_are_followed_and_runs_are_compared() {
    let workshop = Workshop::new();
    let child = start(workshop.up_seeded("one", 2, 2, 600, 5));
    let run = workshop.run("one");
    run.wait_for_rollouts(1);
    let mut follower = start(workshop.orchestrator(&["logs", "one", "--follow"]));
    let followed = BufReader::new(follower.stdout.take().expect("a pipe"));
    let one = finish(child).result();
    let followed: Vec<String> = followed.lines().map_while(Result::ok).collect();
    assert!(finish(follower).success, "it ends with the run");

    let printed = workshop.call(&["logs", "one"]);
    let lines: Vec<&str> = printed.stdout.lines().collect();
    assert!(!printed.stdout.contains(", start 1 of "), "they come before all text: {printed:#?}");
    let sorted = |mut lines: Vec<String>| {
        lines.sort();
        lines
    };
    let all = sorted(lines.iter().map(|line| (*line).to_owned()).collect());
    assert_eq!(sorted(followed), all, "what was followed is what is there");
    for process in ["orchestrator  ", "learner-0     ", "actor-00      ", "actor-01      "] {
        assert!(lines.iter().any(|line| line.starts_with(process)), "{process}: {lines:#?}");
    }
    let times: Vec<&str> = lines.iter().filter_map(|line| line.get(14..)?.split(' ').next()).collect();
    let times: Vec<&str> = times.into_iter().filter(|word| word.ends_with('Z')).collect();
    assert!(times.len() > 3 && times.is_sorted(), "{times:#?}");
    let learner = workshop.call(&["logs", "one", "--process", "learner-0"]).stdout;
    assert_eq!(learner, run.log("learner-0"));
    let last = workshop.call(&["logs", "one", "--process", "learner", "-n", "1"]).stdout;
    assert_eq!(last.lines().collect::<Vec<_>>(), learner.lines().last().into_iter().collect::<Vec<_>>());
    workshop
        .call(&["logs", "one", "--process", "acter"])
        .refused("no log of acter: there are those of actor-00, actor-01, learner-0");
    // A reader that has had enough is no error.
    let head = format!("{} logs one | head -n 1", system_tests::binary("orchestrator").display());
    let head = Command::new("bash").args(["-o", "pipefail", "-c", &head]).current_dir(workshop.path("")).output();
    assert!(head.expect("a shell").status.success());

    let two = complete(workshop.up_seeded("two", 2, 2, 400, 6)).result();
    let compared = workshop.call(&["compare", "one", "two", "--json"]).json();
    assert_eq!(compared["runs"], serde_json::json!(["one", "two"]));
    assert_eq!(*row(&compared["configuration"], "seed"), serde_json::json!([5, 6]));
    let keys: Vec<&str> =
        compared["configuration"].as_array().expect("rows").iter().filter_map(|row| row["name"].as_str()).collect();
    assert!(keys.iter().all(|key| *key == "seed" || key.starts_with("stages.")), "{keys:?}");
    assert_eq!(*row(&compared["figures"], "weights"), serde_json::json!([one.0, two.0]));
    assert_eq!(*row(&compared["figures"], "frames"), serde_json::json!([600, 400]));
    let text = workshop.call(&["compare", "one", "two"]).stdout;
    let seed: Vec<&str> =
        text.lines().find(|line| line.starts_with("  seed ")).unwrap_or_default().split(' ').collect();
    assert!(seed.contains(&"5") && seed.contains(&"6"), "{text}");
    workshop.call(&["compare", "one"]).refused("give two runs or more");

    assert_eq!(workshop.call(&["list", ".", "--json"]).json().as_array().map(Vec::len), Some(2));
    let report = workshop.call(&["report", "one", "two", "--json"]).json();
    assert_eq!(report, workshop.json("runs/report/report.json"));

    // Where an evaluation of a policy file stands.
    std::fs::create_dir(workshop.path("evaluations")).expect("a folder");
    std::fs::rename(workshop.path("two"), workshop.path("evaluations/two")).expect("a move");
    assert_eq!(workshop.call(&["list", "--json"]).json()[0]["folder"], "evaluations/two");
}

#[test]
fn shells_and_man_get_all_commands() {
    let workshop = Workshop::new();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let printed = workshop.call(&["completions", shell]);
        assert!(printed.success && printed.stderr.is_empty(), "{printed:#?}");
        for word in ["orchestrator", "compare", "resume", "envs-per-actor"] {
            assert!(printed.stdout.contains(word), "{shell}: {word}");
        }
        if shell == "bash" {
            // A shell takes them, and completes a command by them.
            let script = format!(
                "{}\nCOMP_WORDS=(orchestrator com); COMP_CWORD=1; _orchestrator orchestrator com orchestrator\n\
                 echo \"${{COMPREPLY[@]}}\"",
                printed.stdout
            );
            let output = Command::new("bash").args(["-c", &script]).output().expect("bash");
            assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "compare completions", "{output:?}");
        }
    }
    workshop.call(&["completions", "tcsh"]).refused("[possible values: bash");
    assert!(workshop.call(&["man", "pages/"]).success);
    let page = std::fs::read_to_string(workshop.path("pages/orchestrator.1")).expect("a page");
    assert!(page.contains(".TH orchestrator 1") && page.contains("orchestrator\\-compare(1)"), "{page}");
    let up = std::fs::read_to_string(workshop.path("pages/orchestrator-up.1")).expect("a page");
    assert!(up.contains("\\-\\-envs\\-per\\-actor"), "{up}");
    let count = std::fs::read_dir(workshop.path("pages")).expect("a folder").count();
    let listed = workshop.call(&["help"]).stdout;
    let lines = listed.lines().take_while(|line| *line != "Options:");
    let commands = lines.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    // The program has a page, too.
    assert_eq!(count, commands.count() + 1);
}

/// Of a checkout with our program, and others that do nothing.
#[test]
fn an_installation_brings_pages_and_completions_and_takes_them_away() {
    let workshop = Workshop::new();
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for folder in ["deploy", "target/release", ".torch/libtorch/lib", "models"] {
        std::fs::create_dir_all(workshop.path(folder)).expect("a folder");
    }
    std::fs::copy(sources.join("deploy/install"), workshop.path("deploy/install")).expect("the script");
    std::fs::copy(system_tests::binary("orchestrator"), workshop.path("target/release/orchestrator"))
        .expect("a program");
    for program in ["actor", "learner"] {
        std::fs::copy("/bin/true", workshop.path("target/release").join(program)).expect("a program");
    }
    for file in ["build-version", "lib/libtorch.so"] {
        std::fs::write(workshop.path(".torch/libtorch").join(file), "0").expect("a file");
    }
    let foreign = workshop.path("prefix/share/man/man1/other.1");
    std::fs::create_dir_all(foreign.parent().expect("a folder")).expect("a folder");
    std::fs::write(&foreign, "not ours").expect("a file");
    let install = |more: &[&str]| {
        let script = workshop.path("deploy/install");
        let output = Command::new("sh").arg(script).args(more).arg(workshop.path("prefix")).output().expect("a shell");
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    assert_eq!(install(&[]), (true, String::new()));
    let files = [
        ("man/man1/orchestrator-resume.1", ".TH orchestrator-resume 1 "),
        ("bash-completion/completions/orchestrator", "complete -F _orchestrator"),
        ("zsh/site-functions/_orchestrator", "#compdef orchestrator"),
        ("fish/vendor_completions.d/orchestrator.fish", "complete -c orchestrator"),
        ("bash-completion/completions/stillroom", "complete -F _stillroom"),
        ("zsh/site-functions/_stillroom", "#compdef stillroom"),
        ("fish/vendor_completions.d/stillroom.fish", "complete -c stillroom"),
    ];
    for (place, expected) in files {
        let path = workshop.path("prefix/share").join(place);
        let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert!(text.contains(expected), "{place}: {text}");
    }
    let mut help = Command::new(workshop.path("prefix/bin/stillroom"));
    let help = help.args(["up", "--help"]).output().expect("the other name");
    assert!(String::from_utf8_lossy(&help.stdout).contains("Usage: stillroom up"), "{help:?}");
    assert_eq!(install(&["-u"]), (true, String::new()));
    let left = Command::new("find").arg(workshop.path("prefix")).args(["-not", "-type", "d"]).output().expect("find");
    assert_eq!(String::from_utf8_lossy(&left.stdout).trim(), foreign.display().to_string());
    // What is somebody else's stays.
    let page = workshop.path("prefix/share/man/man1/orchestrator.1");
    std::fs::write(&page, "not ours either").expect("a file");
    let (success, error) = install(&[]);
    assert!(!success && error.contains("exists and is not Stillroom's"), "{error}");
    assert_eq!(std::fs::read_to_string(&page).expect("a file"), "not ours either");
}
