//! One way to open a file of a run folder.
//!
//! A run folder can be somebody else's. `RunFolder` follows no link in it and reads nothing without a bound, so what reads
//! runs opens files by its methods. What opens others stands in [`OTHERS`], with the reason.

use crate::modules::Target;
use crate::{Finding, Rule};

/// Crates that read run folders.
const READERS: [&str; 4] = ["orchestrator/", "report/", "view/", "learner/"];

/// Calls that open a file or a folder by its path, as the ends of paths.
const CALLS: [&[&str]; 11] = [
    &["fs", "read"],
    &["fs", "read_to_string"],
    &["fs", "read_dir"],
    &["File", "open"],
    &["File", "options"],
    &["OpenOptions", "new"],
    &["OpenOptions", "open"],
    &["bounded", "open"],
    &["bounded", "read"],
    &["bounded", "read_text"],
    &["open_plain"],
];

/// Files and folders of sources that open something else, and what.
const OTHERS: &[(&str, &str)] = &[
    ("orchestrator/src/preflight/", "the machine, and libtorch"),
    ("orchestrator/src/run/process_state.rs", "/proc"),
    ("orchestrator/src/run/signal.rs", "/proc"),
    ("orchestrator/src/run/remains.rs", "/proc, /dev/shm and the temporary folder"),
    ("orchestrator/src/run/identity.rs", "/dev/urandom and the kernel's boot_id"),
    ("orchestrator/src/viewer/processes.rs", "/proc"),
    ("orchestrator/src/supervisor/shell.rs", "/proc"),
    ("learner/src/ffi/", "/proc"),
    ("learner/src/peers.rs", "/proc"),
    ("learner/src/process/machine.rs", "libtorch, and /proc"),
    ("orchestrator/src/hosts/token.rs", "a file that the user names"),
    ("orchestrator/src/command/view.rs", "a file that the user names"),
    ("orchestrator/src/command/overrides.rs", "a file that the user names"),
    ("orchestrator/src/command/environment_flags.rs", "a file that the user names"),
    ("orchestrator/src/command/replay.rs", "the folder of films, which the user can name"),
    ("orchestrator/src/environment/consent.rs", "what this user has allowed"),
    ("orchestrator/src/suite/file.rs", "a file that the user names"),
    ("orchestrator/src/training/next_steps.rs", "a file that the user names"),
    ("orchestrator/src/report_builder/kept.rs", "a file that the user names"),
    ("orchestrator/recording/src/reader.rs", "a recording that the user names, or that was listed"),
    ("orchestrator/recording/src/repair.rs", "a recording that the user names, and its folder"),
    ("orchestrator/export/src/file.rs", "a file that the user names"),
    ("learner/src/declared.rs", "a file that the user names"),
    ("learner/src/probe/", "a file that the user names"),
    ("learner/src/process/import.rs", "a file that the user names"),
    ("learner/src/process/weights.rs", "a file that the user names"),
    ("orchestrator/src/run/scenes.rs", "the original of a scene, which the user names"),
    ("orchestrator/src/supervisor/process.rs", "logs, to write them"),
    ("orchestrator/src/supervisor/session.rs", "logs, to write them"),
    ("orchestrator/src/training/validation.rs", "a log, to write it, and the folder that the run writes"),
    ("orchestrator/src/training/budget.rs", "the folder that the run writes"),
    ("orchestrator/src/training/tensorboard/", "event files, to write them on"),
    ("orchestrator/recording/src/recorder/", "recordings, to write them"),
    ("orchestrator/src/run/json_lines.rs", "lines, to write them on"),
    ("orchestrator/src/run/lock.rs", "locks, to take them"),
    ("learner/src/process/lock.rs", "locks, to take them"),
    ("orchestrator/src/run/cut_off.rs", "a folder that is removed"),
    ("orchestrator/src/command/import.rs", "a folder that is removed"),
    ("orchestrator/src/run/create.rs", "a folder that is to be empty"),
    ("orchestrator/src/run/unfinished.rs", "a folder that is to be empty"),
    ("orchestrator/src/report_builder/files.rs", "the folder that the report writes"),
    ("orchestrator/src/suite/", "a suite's folder, which the suite writes"),
    ("orchestrator/src/command/player.rs", "a run of its own in the temporary folder"),
    ("orchestrator/src/command/test.rs", "runs of its own in the temporary folder"),
];

/// Files that are opened in another way.
pub(crate) fn findings(targets: &[Target]) -> Vec<Finding> {
    let read_runs = |file: &str| {
        let is_source = file.contains("/src/") && !file.ends_with("tests.rs") && !file.contains("/tests/");
        is_source && READERS.iter().any(|reader| file.starts_with(reader))
    };
    let is_other = |file: &str| OTHERS.iter().any(|(place, _)| file.starts_with(place));
    let modules = targets.iter().flat_map(|target| &target.modules);
    let judged = modules.filter(|module| !module.test && read_runs(&module.file) && !is_other(&module.file));
    let mut found = vec![];
    for module in judged {
        let used = module.uses.iter().filter(|used| !used.test).map(|used| (&used.path, used.line));
        let mentioned = module.mentions.iter().filter(|mention| !mention.test);
        for (path, line) in used.chain(mentioned.map(|mention| (&mention.path, mention.line))) {
            if let Some(call) =
                CALLS.iter().find(|call| path.iter().map(String::as_str).collect::<Vec<_>>().ends_with(call))
            {
                found.push(Finding {
                    path: module.file.clone(),
                    line,
                    rule: Rule::Opening,
                    what: format!("`{}` opens by a path", call.join("::")),
                    detail: String::new(),
                });
            }
        }
    }
    found
}
