//! The commands in the book: each page's blocks are run in their order in an empty folder, as the page says; and all
//! commands of ours that any page shows, run or not, have options that exist.

use book::{Block, How, Page, pages};
use std::fmt::Write;
use std::os::unix::fs::symlink;
use std::process::{Command, Stdio};
use system_tests::{Printed, Workshop, binary, complete, root};

/// What `run=small` adds to `stillroom up`, where the page does not say otherwise.
const SMALL: &str = "\
--set learner.device=cpu --set learner.threads=1 --set learner.actor_deadline_s=240 --set network.encoder=cnn \
--set network.input_pool=4 --set network.hidden=32 --set ppo.rollout_steps=10 --set ppo.epochs=2 \
--set episode.max_steps=24 --set validation.every_frames=0 --set checkpoint.interval_s=0";

/// The same, for options of which the page may have one already.
const SMALL_OPTIONS: [(&str, &str); 3] = [("--actors", "2"), ("--envs-per-actor", "2"), ("--frames", "400")];

/// What of the checkout a page's commands use.
const LINKED: [&str; 4] = ["deploy", "docs", "scenes", "suites"];

fn page(path: &str) -> Page {
    let found = pages(&root()).expect("the book can be read").into_iter().find(|page| page.path == path);
    found.unwrap_or_else(|| panic!("docs/SUMMARY.md has no page {path}"))
}

fn is_run(block: &Block) -> bool {
    block.language() == "sh" && matches!(block.how(), How::Run | How::RunSmall)
}

/// The budget of `resume` where a page has one: more than the few frames of `up`.
const LONGER: &str = "600";

/// A program `stillroom` that gives `up` a tiny network and few frames, and `resume` few more.
fn write_small(workshop: &Workshop) {
    let mut script = format!("#!/bin/sh\nprogram='{}'\n", binary("orchestrator").display());
    // Each word in its turn goes to the end.
    writeln!(
        script,
        "if [ \"$1\" = resume ]; then\nbefore=\nfor word; do\nshift\n[ \"$before\" = --frames ] && set -- \"$@\" {LONGER} || \
         set -- \"$@\" \"$word\"\nbefore=$word\ndone\nfi"
    )
    .expect("a string");
    script += "[ \"$1\" = up ] || exec \"$program\" \"$@\"\nshift\nall=\" $* \"\n";
    for (option, value) in SMALL_OPTIONS {
        writeln!(script, "case $all in *' {option} '*) ;; *) set -- \"$@\" {option} {value} ;; esac")
            .expect("a string");
    }
    // Before the page's own settings, which win.
    writeln!(script, "exec \"$program\" up {SMALL} \"$@\"").expect("a string");
    workshop.script("small/stillroom", &script);
}

fn shell(workshop: &Workshop, block: &Block) -> Printed {
    let programs = binary("orchestrator").parent().expect("a program is in a folder").to_owned();
    let own = workshop.path(if block.how() == How::RunSmall { "small" } else { "named" });
    let path = std::env::var("PATH").unwrap_or_default();
    let path = format!("{}:{}:{path}", own.display(), programs.display());
    let mut command = workshop.program("sh");
    command.args(["-euc", &block.text]).current_dir(workshop.path("page")).env("PATH", path);
    complete(command)
}

/// Runs the blocks of a page.
fn follow(path: &str) {
    let page = page(path);
    let workshop = Workshop::new();
    for folder in ["page", "small", "named"] {
        std::fs::create_dir(workshop.path(folder)).expect("a writable temporary folder");
    }
    write_small(&workshop);
    // The name that users type.
    symlink(binary("orchestrator"), workshop.path("named/stillroom")).expect("a writable temporary folder");
    for folder in LINKED {
        let there = root().join(folder).canonicalize().expect("a folder of the checkout");
        symlink(there, workshop.path("page").join(folder)).expect("a writable temporary folder");
    }
    let blocks: Vec<Block> = page.blocks().into_iter().filter(is_run).collect();
    assert!(!blocks.is_empty(), "{path} has nothing to run");
    for block in blocks {
        let printed = shell(&workshop, &block);
        assert!(
            printed.success,
            "docs/{path}:{}: exit status {:?}\n{}--- stdout\n{}\n--- stderr\n{}",
            block.line, printed.status, block.text, printed.stdout, printed.stderr
        );
    }
}

/// One test for each page, so that they run side by side.
macro_rules! pages_that_run {
    ($($name:ident: $path:literal,)*) => {
        const RUN: &[&str] = &[$($path),*];
        $(#[test]
        fn $name() {
            follow($path);
            assert!(RUN.contains(&$path));
        })*
    };
}

pages_that_run! {
    first_run: "first-run.md",
    commands: "commands.md",
    terminal: "terminal.md",
    troubles: "troubles.md",
    scenes: "scenes.md",
    evaluation: "evaluation.md",
    report: "report.md",
    configuration: "configuration.md",
    scaling: "scaling.md",
    recovery: "recovery.md",
    recordings: "recordings.md",
}

#[test]
fn every_page_with_commands_that_are_run_has_its_test() {
    let pages = pages(&root()).unwrap();
    let run: Vec<&str> =
        pages.iter().filter(|page| page.blocks().iter().any(is_run)).map(|page| page.path.as_str()).collect();
    for path in &run {
        assert!(RUN.contains(path), "docs/{path} has commands to run: add it to the list in this file");
    }
    assert_eq!(run.len(), RUN.len());
}

/// Also of blocks that are not run. A value that only a reader can fill in (`RUN`, `HOST`) is not judged: `--help` ends
/// the program before it looks for files.
#[test]
fn commands_that_are_not_run_have_options_that_exist() {
    let mut calls = 0;
    let mut wrong = vec![];
    let mut documents: Vec<(String, Vec<Block>)> =
        pages(&root()).unwrap().into_iter().map(|page| (page.path.clone(), page.blocks())).collect();
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let readme = Page { path: "../README.md".to_owned(), title: String::new(), text: readme };
    documents.push((readme.path.clone(), readme.blocks()));
    for (path, blocks) in documents {
        for block in blocks.iter().filter(|block| block.language() == "sh") {
            for call in block.calls() {
                // `stillroom` is another name of `orchestrator`.
                let program = call[0].rsplit('/').next().unwrap().replace("stillroom", "orchestrator");
                // `...` stands for what the reader adds.
                let mut words: Vec<&str> = call[1..].iter().map(String::as_str).filter(|word| *word != "...").collect();
                words.push("--help");
                let printed = Command::new(binary(&program)).args(&words).stdin(Stdio::null()).output().unwrap();
                calls += 1;
                if !printed.status.success() {
                    let said = String::from_utf8_lossy(&printed.stderr).into_owned();
                    wrong.push(format!("docs/{path}:{}: {}\n{said}", block.line, call.join(" ")));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(calls > 80, "only {calls} calls were tried");
    let printed = Command::new(binary("orchestrator")).args(["up", "--no-such-option", "--help"]).output().unwrap();
    assert!(!printed.status.success(), "a wrong option is found");
}
