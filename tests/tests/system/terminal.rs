//! A run on a terminal: `top` from another one, the line of `up` that renews itself, and the events for scripts.

use rustix::process::Signal;
use serde_json::Value;
use system_tests::{Terminal, Workshop, complete, finish, signal, start, wait_until};

/// What leaves the other screen and shows the cursor.
const LEAVES: &str = "\x1b[?1049l";

#[test]
fn a_run_is_watched_from_another_terminal_which_comes_back() {
    let workshop = Workshop::new();
    let child = start(workshop.up("run", 2, 2, 3000));
    let run = workshop.run("run");
    run.wait_for_rollouts(3);
    let terminal = Terminal::open(80, 24);
    let modes = terminal.modes();
    let top = start(terminal.session(&workshop.orchestrator(&["top", "run"])));
    terminal
        .wait_for(0, &["running", "frames/s", "return", "SRwoD", "disturbance", "learner-0", "actor-01", "q leave"]);
    assert_ne!(terminal.modes(), modes, "keys come as they are pressed");
    assert!(terminal.written().chars().any(|one| ('\u{2801}'..='\u{28ff}').contains(&one)), "curves");
    let before = terminal.written().len();
    terminal.resize(130, 40);
    terminal.wait_for(before, &["learner-0", "actor-01", "q leave"]);
    assert!(!terminal.written().contains(LEAVES));
    terminal.press("q");
    finish(top).good();
    assert_eq!(terminal.modes(), modes);
    // What was written last may still be on its way.
    wait_until("the screen is as it was", || {
        let written = terminal.written();
        written.contains(LEAVES) && written.ends_with("\x1b[?25h")
    });
    let (weights, frames) = finish(child).result();
    assert_eq!(frames, 3000);

    // Of a complete run; an interrupt from the keyboard, and signals from elsewhere, leave as well.
    for leave in ["\x03", "\x1b", "TERM", "HUP"] {
        let before = terminal.written().len();
        let top = start(terminal.session(&workshop.orchestrator(&["top", "run"])));
        terminal.wait_for(before, &["complete", "3,000 / 3,000 frames"]);
        match leave {
            "TERM" => run.processes("top").into_iter().for_each(|pid| signal(pid, Signal::TERM)),
            "HUP" => run.processes("top").into_iter().for_each(|pid| signal(pid, Signal::HUP)),
            key => terminal.press(key),
        }
        let left = finish(top);
        assert!(left.success, "{leave:?}: {left:#?}");
        assert_eq!(terminal.modes(), modes, "{leave:?}");
        wait_until("the screen is as it was", || terminal.written()[before..].contains(LEAVES));
    }

    let refused = workshop.call(&["top", "run"]);
    assert!(!refused.success && refused.stdout.is_empty(), "{refused:#?}");
    assert_eq!(refused.stderr.matches("top needs a terminal: `orchestrator status RUN`").count(), 1, "{refused:#?}");
    workshop.call(&["top", "nothing"]).refused("nothing");
    // Whoever watched, the weights are the same.
    assert_eq!(complete(workshop.up("alone", 2, 2, 3000)).result().0, weights);
}

#[test]
fn on_a_terminal_one_line_renews_itself_and_warnings_scroll_above_it() {
    let workshop = Workshop::new();
    let terminal = Terminal::open(80, 24);
    let child = start(terminal.session(&workshop.up("run", 2, 2, 1500)));
    let run = workshop.run("run");
    run.wait_for_rollouts(3);
    run.kill_one("--actor ");
    assert!(finish(child).success, "{}", terminal.written());
    // What was written last may still be on its way.
    wait_until("the summary is on the terminal", || terminal.written().contains("frames: 1500"));
    let written = terminal.written();
    // What stands in a line of the terminal at the end: what came after it was erased last.
    let lines: Vec<&str> = written.lines().filter_map(|line| line.rsplit("\x1b[J").next()).collect();
    assert!(lines.iter().all(|line| !line.contains(" / 1,500  ")), "no progress stays: {lines:#?}");
    assert!(lines.iter().any(|line| line.contains("WARN") && line.contains(" died")), "{lines:#?}");
    let last = lines.iter().rposition(|line| line.starts_with("frames: 1500"));
    assert!(last.is_some_and(|last| lines[last - 1].starts_with("weights: ")), "{lines:#?}");
    // Never more than one line, and never wider than the terminal.
    // After a line of the log it is drawn again.
    let drawn = written.split("\r\x1b[J").skip(1).filter(|drawn| drawn.contains(" / 1,500  "));
    let progress: Vec<&str> = drawn.map(|drawn| drawn.lines().next_back().unwrap_or_default()).collect();
    assert!(progress.len() > 5 && progress.iter().all(|line| line.chars().count() < 80), "{progress:#?}");
    assert!(!written.contains("A\x1b[J"), "nothing above the line is erased");
}

/// The events that a command tells, which must be all that it prints on standard output.
fn events(stdout: &str) -> Vec<Value> {
    stdout.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))).collect()
}

fn named<'a>(events: &'a [Value], name: &str) -> Vec<&'a Value> {
    events.iter().filter(|event| event["event"] == name).collect()
}

#[test]
fn scripts_are_told_what_happens() {
    let workshop = Workshop::new();
    let mut command = workshop.up("run", 2, 2, 800);
    command.arg("--json");
    let child = start(command);
    let run = workshop.run("run");
    run.wait_for_rollouts(3);
    run.kill_one("--actor ");
    let printed = finish(child).good();
    let told = events(&printed.stdout);
    assert!(told.iter().all(|event| event["at_unix_s"].as_f64().is_some_and(|at| at > 1.7e9)), "{told:#?}");
    let started = named(&told, "started");
    assert_eq!((started.len(), &started[0]["budget"], &started[0]["seed"]), (1, &800.into(), &5.into()));
    let frames: Vec<u64> = named(&told, "rollout").iter().filter_map(|event| event["frames"].as_u64()).collect();
    let expected: Vec<u64> = run.metrics().values().filter_map(|line| line["frames"].as_u64()).collect();
    assert_eq!(frames, expected, "a rollout each");
    assert!(named(&told, "rollout").iter().all(|event| event["timing"]["update_s"].is_f64()), "{told:#?}");
    assert!(!named(&told, "checkpoint").is_empty() && named(&told, "learner_ready").len() == 1);
    let ended = named(&told, "process_ended");
    let killed = ended.iter().find(|event| event["how"].as_str().is_some_and(|how| how.contains("SIGKILL")));
    let process = &killed.expect("the killed one")["process"];
    let starts: Vec<&Value> =
        named(&told, "process_started").into_iter().filter(|event| event["process"] == *process).collect();
    assert_eq!((&starts[0]["incarnation"], &starts[1]["incarnation"]), (&1.into(), &2.into()));
    let warned = named(&told, "log")
        .into_iter()
        .any(|event| event["level"] == "WARN" && event["text"].as_str().is_some_and(|text| text.contains(" died")));
    assert!(warned, "{told:#?}");

    let last = told.last().expect("events");
    assert_eq!(
        (&last["event"], &last["how"], &last["summary"]["frames"]),
        (&"ended".into(), &"complete".into(), &800.into())
    );
    let weights = last["summary"]["weights"].as_str().expect("a digest");
    let again = complete(workshop.resume("run")).result();
    assert_eq!(again, (weights.to_owned(), 800));
    let mut resume = workshop.resume("run");
    resume.arg("--json");
    let again = events(&complete(resume).stdout);
    assert_eq!((again.len(), &again[0]["summary"]), (1, &last["summary"]));
}

#[test]
fn the_last_event_tells_why_figures_cannot_be_written_and_a_resume_writes_them() {
    let workshop = Workshop::new();
    let mut command = workshop.up("run", 1, 2, 400);
    command.arg("--json");
    let child = start(command);
    let run = workshop.run("run");
    run.wait_for_rollouts(1);
    // Something else has the name.
    let place = workshop.path("run/summary.json");
    std::fs::create_dir_all(place.join("in the way")).expect("a folder");
    let printed = finish(child);
    printed.refused("summary.json");
    let told = events(&printed.stdout);
    let last = told.last().expect("events");
    assert_eq!((&last["event"], &last["how"]), (&"ended".into(), &"failed".into()), "{last}");
    assert!(last["reason"].as_str().is_some_and(|reason| reason.contains("summary.json")), "{last}");
    assert_eq!(named(&told, "ended").len(), 1);
    run.assert_nothing_left();

    std::fs::remove_dir_all(&place).expect("removed");
    assert_eq!(complete(workshop.resume("run")).result().1, 400);
    assert!(place.is_file());
}
