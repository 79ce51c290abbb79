//! Runs to which nothing happens, with which others are compared: each is made once for all tests of a build, though each
//! test is a process of its own.

use crate::{Run, Workshop, binary, complete};
use proto::digest::sha256;
use proto::run_folder::RunFolder;
use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::Command;

/// A complete run to which nothing happened.
#[derive(Debug)]
pub struct Undisturbed {
    /// Digest of its weights and number of its frames.
    pub result: (String, u64),
    /// Its folder, which is shared: it is only read.
    pub run: Run,
}

impl Undisturbed {
    /// The run that `command`, one of `workshop` for a run called `undisturbed`, makes with the configuration there. It is
    /// made unless these programs have made it before.
    pub fn of(workshop: &Workshop, command: Command) -> Self {
        let config = std::fs::read_to_string(workshop.path("tiny.toml")).expect("a workshop has a configuration");
        let programs = ["orchestrator", "learner", "actor"].map(|name| {
            let program = std::fs::metadata(binary(name)).expect("a program that is built");
            (program.len(), program.mtime(), program.mtime_nsec())
        });
        let arguments: Vec<_> = command.get_args().collect();
        assert!(arguments.iter().any(|argument| *argument == NAME), "the run is called {NAME}: {arguments:?}");
        let all = binary("orchestrator").with_file_name(NAME);
        let build = all.join(&sha256(format!("{programs:?}").as_bytes())[..16]);
        let folder = build.join(&sha256(format!("{arguments:?} {config}").as_bytes())[..16]);
        let lock = File::create(all.with_extension("lock")).expect("a writable target folder");
        lock.lock().expect("a lock");
        if !build.exists() {
            // Those of programs that are not there any more.
            let _ = std::fs::remove_dir_all(&all);
        }
        let run = Run { folder: RunFolder::new(folder.join(NAME)) };
        let said = folder.join("said");
        if !said.exists() {
            make(&folder, &config, command, &run);
        }
        let said = std::fs::read_to_string(said).expect("what the command said");
        let (weights, frames) = said.split_once(' ').expect("two words");
        Self { result: (weights.to_owned(), frames.parse().expect("a number")), run }
    }
}

/// What all of these runs are called.
const NAME: &str = "undisturbed";

fn make(folder: &Path, config: &str, mut command: Command, run: &Run) {
    // What a test that was killed has left.
    let _ = std::fs::remove_dir_all(folder);
    std::fs::create_dir_all(folder).expect("a writable target folder");
    std::fs::write(folder.join("tiny.toml"), config).expect("a writable target folder");
    command.current_dir(folder);
    let printed = complete(command);
    let (weights, frames) = printed.result();
    assert_eq!(printed.deaths(), Vec::<&str>::new(), "nothing happens to it");
    run.assert_nothing_left();
    std::fs::write(folder.join("said"), format!("{weights} {frames}")).expect("a writable target folder");
}
