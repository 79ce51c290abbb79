//! Processes of a run, found by what their command lines hold, and signals to them.

use crate::fault::Who;
use rustix::process::{Pid, Signal, kill_process};
use std::path::Path;

/// A process of ours.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    pub pid: u32,
    pub line: String,
}

impl Found {
    /// The name of its program and, of a learner or actor, its number: what its figures go under.
    pub fn name(&self) -> String {
        let program = self.line.split(' ').next().unwrap_or_default();
        let program = Path::new(program).file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let after = |flag: &str| Some(self.line.split_once(flag)?.1.split(' ').next()?.to_owned());
        let number = after(" --rank ").or_else(|| after(" --actor "));
        number.map_or_else(|| program.to_owned(), |number| format!("{program}-{number}"))
    }
}

/// All processes whose command lines name `folder` or something in it, in the order of their numbers. Not those that
/// have ended and wait for their parent.
pub fn of_folder(folder: &Path) -> Vec<Found> {
    let folder = folder.display().to_string();
    let mut found = vec![];
    for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else { continue };
        let Ok(bytes) = std::fs::read(entry.path().join("cmdline")) else { continue };
        let line = String::from_utf8_lossy(&bytes).trim_end_matches('\0').replace('\0', " ");
        if pid != std::process::id() && line.contains(&folder) {
            found.push(Found { pid, line });
        }
    }
    found.sort_unstable_by_key(|one| one.pid);
    found
}

/// The process of this role among those of a folder, whose first command is `first`. Where several have the role, as
/// actors of a run and of its validation, the newest.
pub fn find(who: Who, folder: &Path, first: u32) -> Option<u32> {
    let has = |line: &str, words: &[&str]| words.iter().all(|word| format!("{line} ").contains(word));
    let newest = |test: &dyn Fn(&str) -> bool| {
        of_folder(folder).into_iter().rev().find(|one| one.pid != first && test(&one.line)).map(|one| one.pid)
    };
    match who {
        Who::Orchestrator => Some(first),
        Who::Learner(rank) => newest(&|line| {
            let ranked = format!(" --rank {rank} ");
            has(line, &["/learner ", &ranked]) || (rank == 0 && has(line, &["/learner evaluate "]))
        }),
        Who::Actor(number) => newest(&|line| has(line, &[" --wire ", &format!(" --actor {number} ")])),
        Who::Child => newest(&|line| has(line, &["/orchestrator "])),
    }
}

/// Sends a signal; false if there is no such process any more.
pub fn signal(pid: u32, signal: Signal) -> bool {
    i32::try_from(pid).ok().and_then(Pid::from_raw).is_some_and(|pid| kill_process(pid, signal).is_ok())
}
