//! Starts real runs of the built binaries in temporary folders, injects faults, and checks the results.
//!
//! The binaries are those that `cargo build` of the same profile put beside the test executable; `make test` builds
//! them first.

pub mod board;
mod browser;
pub mod evidence;
mod network;
pub mod recording;
mod terminal;
mod undisturbed;
mod viewer;

pub use browser::Browser;
pub use evidence::Evidence;
pub use network::{Network, Quality};
pub use recording::{Recording, recorded_depth};
pub use terminal::Terminal;
pub use undisturbed::Undisturbed;
pub use viewer::{Answer, Viewer};

use proto::run_folder::RunFolder;
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::io::Write;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// A configuration that exercises everything and finishes within seconds: two stages, budgets that are no multiple
/// of the number of environments, both halves of an actor, a depth recording.
pub const TINY: &str = r#"
[episode]
max_steps = 24
start_distance_max_m = 1.0
goal_distance_max_m = 1.0

[network]
encoder = "cnn"
input_pool = 4
hidden = 32

[ppo]
rollout_steps = 10
epochs = 2

[learner]
device = "cpu"
threads = 1
actor_deadline_s = 60.0

[checkpoint]
interval_s = 0.0

[recording]
depth_share = 0.2
"#;

/// How long any one command of a test may take.
pub const DEADLINE: Duration = Duration::from_mins(4);

/// Waits until `condition` holds, looking fifty times a second.
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    wait_for(what, || condition().then_some(()));
}

/// Waits until there is such a thing.
pub fn wait_for<T>(what: &str, mut find: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = find() {
            return found;
        }
        assert!(begun.elapsed() < DEADLINE, "not within {} s: {what}", DEADLINE.as_secs());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The checkout.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().expect("a checkout")
}

/// Says something about a test that passes: that it is skipped, or what it does without. What the macros print of such a
/// test is not shown.
pub fn tell(text: &str) {
    let test = std::thread::current();
    let _ = writeln!(std::io::stderr(), "{}: {text}", test.name().unwrap_or("test"));
}

pub fn binary(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("a running test has a path");
    // Tests lie in target/PROFILE/deps, programs beside those that are started.
    let folder = test.parent().expect("a program lies in a folder");
    let profile = if folder.ends_with("deps") { folder.parent().expect("target/PROFILE") } else { folder };
    let path = profile.join(name);
    let release = if profile.ends_with("release") { " --release" } else { "" };
    assert!(path.exists(), "{} is not built: `cargo build{release} --workspace --bins` first", path.display());
    path
}

/// A temporary place for runs with the tiny configuration in it.
#[derive(Debug)]
pub struct Workshop {
    folder: tempfile::TempDir,
}

impl Default for Workshop {
    fn default() -> Self {
        Self::new()
    }
}

impl Workshop {
    /// A new, empty one.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join("tiny.toml"), TINY).expect("a writable temporary folder");
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a program.
    pub fn script(&self, name: &str, text: &str) -> PathBuf {
        use std::os::unix::fs::PermissionsExt;
        let path = self.path(name);
        std::fs::write(&path, text).expect("a writable folder");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).expect("a file of ours");
        path
    }

    /// Writes a file that other users may not read.
    pub fn secret(&self, name: &str, text: &str) {
        use std::os::unix::fs::OpenOptionsExt;
        let mut options = std::fs::OpenOptions::new();
        let file = options.write(true).create_new(true).mode(0o600).open(self.path(name));
        file.and_then(|mut file| file.write_all(text.as_bytes())).expect("a writable folder");
    }

    /// `orchestrator ARGS`, ready to be started, with nothing inherited that would change it.
    pub fn orchestrator(&self, arguments: &[&str]) -> Command {
        let mut command = self.program(binary("orchestrator"));
        command.args(arguments);
        command
    }

    /// `orchestrator ARGS`, complete.
    pub fn call(&self, arguments: &[&str]) -> Printed {
        complete(self.orchestrator(arguments))
    }

    /// Any program, ready to be started in the same way.
    pub fn program(&self, path: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(path);
        command.current_dir(self.folder.path()).env_remove("STILLROOM_LOG").env_remove("STILLROOM_FAULT");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// `orchestrator up` of a tiny run called `name`.
    pub fn up(&self, name: &str, actors: u32, environments_per_actor: u32, frames: u64) -> Command {
        self.up_seeded(name, actors, environments_per_actor, frames, 5)
    }

    pub fn up_seeded(&self, name: &str, actors: u32, environments_per_actor: u32, frames: u64, seed: u64) -> Command {
        let mut command = self.orchestrator(&["up", "--preset", "demo", "--config", "tiny.toml", "--run", name]);
        let (actors, environments) = (actors.into(), environments_per_actor.into());
        for (flag, number) in
            [("--seed", seed), ("--actors", actors), ("--envs-per-actor", environments), ("--frames", frames)]
        {
            command.args([flag, &number.to_string()]);
        }
        command
    }

    /// The command in a shell that first does something else, as set its limits with `ulimit`.
    pub fn limited(&self, limits: &str, command: &Command) -> Command {
        let mut shell = self.program("sh");
        shell.args(["-c", &format!("{limits} && exec \"$0\" \"$@\"")]);
        shell.arg(command.get_program()).args(command.get_args());
        shell
    }

    /// `orchestrator resume` of the run called `name`.
    pub fn resume(&self, name: &str) -> Command {
        self.orchestrator(&["resume", name])
    }

    /// The run called `name`.
    pub fn run(&self, name: &str) -> Run {
        Run { folder: RunFolder::new(self.path(name)) }
    }

    /// The tiny configuration with one line in another's place, and more tables.
    pub fn configure(&self, (line, other): (&str, &str), tables: &str) {
        assert!(TINY.contains(line), "{line}");
        std::fs::write(self.path("tiny.toml"), TINY.replace(line, other) + tables).expect("a writable folder");
    }

    /// A copy of a folder.
    pub fn copy(&self, from: &str, to: &str) -> Run {
        let mut copy = self.program("cp");
        copy.args(["-r", from, to]);
        complete(copy).good();
        self.run(to)
    }

    /// A file of JSON.
    pub fn json(&self, name: &str) -> serde_json::Value {
        let text = std::fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{name}: {error}: {text}"))
    }

    /// Simulates what is recorded of a run again.
    pub fn assert_replays(&self, name: &str) {
        let replayed = self.call(&["replay", "--check", name]).good();
        assert!(replayed.stdout.contains("differences: 0"), "{replayed:#?}");
    }
}

#[derive(Debug)]
pub struct Printed {
    /// Exit status 0.
    pub success: bool,
    /// Exit status; none after a signal.
    pub status: Option<i32>,
    /// Ended by SIGKILL.
    pub killed: bool,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl Printed {
    fn from(output: &Output) -> Self {
        Self {
            success: output.status.success(),
            killed: output.status.signal() == Some(rustix::process::Signal::KILL.as_raw()),
            status: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// The weights digest and the frame count of the summary's last two lines.
    pub fn result(&self) -> (String, u64) {
        assert!(self.success, "the command failed\n--- stdout\n{}\n--- stderr\n{}", self.stdout, self.stderr);
        let lines: Vec<&str> = self.stdout.trim_end().lines().rev().take(2).collect();
        let frames = lines[0].strip_prefix("frames: ").expect("the last line is the frame count").parse();
        let weights = lines[1].strip_prefix("weights: ").expect("the line before is the weights digest");
        assert!(weights.len() == 64 && weights.chars().all(|digit| digit.is_ascii_hexdigit()), "{weights}");
        (weights.to_owned(), frames.expect("a number"))
    }

    /// The same, of a command that went well.
    #[track_caller]
    #[allow(clippy::return_self_not_must_use)]
    pub fn good(self) -> Self {
        assert!(self.success, "{self:#?}");
        self
    }

    /// Asserts that it failed, said why on standard error, and did not panic.
    #[track_caller]
    pub fn refused(&self, why: &str) {
        assert!(!self.success, "it should have been refused: {self:#?}");
        assert!(self.stderr.contains(why) && !self.stderr.contains("panicked"), "expected `{why}` in {self:#?}");
    }

    /// What a command that went well printed, as JSON.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        assert!(self.success, "{self:#?}");
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{error}: {self:#?}"))
    }

    /// The lines of standard error that tell of a death.
    pub fn deaths(&self) -> Vec<&str> {
        self.stderr.lines().filter(|line| line.contains(" died")).collect()
    }
}

/// Waits for a started command, draining its pipes.
pub fn finish(child: Child) -> Printed {
    let pid = child.id();
    let (sender, receiver) = std::sync::mpsc::channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    if let Ok(output) = receiver.recv_timeout(DEADLINE) {
        return Printed::from(&output.expect("the child's pipes are readable"));
    }
    kill(pid);
    let output = receiver.recv().expect("the waiting thread sends once").expect("readable pipes");
    panic!("pid {pid} hung for {DEADLINE:?}: {:#?}", Printed::from(&output));
}

/// Starts a command.
pub fn start(mut command: Command) -> Child {
    command.spawn().expect("the binary can be started")
}

/// Starts a command and waits for it.
pub fn complete(command: Command) -> Printed {
    finish(start(command))
}

/// SIGKILL; a process that is already gone is fine.
pub fn kill(pid: u32) {
    signal(pid, rustix::process::Signal::KILL);
}

/// Kills a started command and waits for it.
pub fn kill_child(child: Child) -> Printed {
    kill(child.id());
    let printed = finish(child);
    assert!(printed.killed, "it ended before it was killed: {printed:#?}");
    printed
}

/// The same, and this process adopts what the command has started: a stopped learner stays stopped. The kernel wakes a
/// stopped process when the death of its parent orphans its process group.
pub fn kill_child_and_adopt(child: Child) -> Printed {
    let adopt = |parent| rustix::process::set_child_subreaper(parent).expect("any process can adopt");
    adopt(Some(rustix::process::getpid()));
    let printed = kill_child(child);
    adopt(None);
    printed
}

/// Sends a signal; a process that is already gone is fine.
pub fn signal(pid: u32, signal: rustix::process::Signal) {
    let pid = i32::try_from(pid).ok().and_then(rustix::process::Pid::from_raw).expect("a process id");
    let _ = rustix::process::kill_process(pid, signal);
}

/// Whether a signal has stopped a process, as a fault point does that is to hold it: all its threads, for one that waits
/// for the disk stops only after that.
pub fn is_held(pid: u32) -> bool {
    let mut threads = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten().peekable();
    let is_stopped = |stat: String| stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.starts_with('T'));
    threads.peek().is_some()
        && threads.all(|thread| std::fs::read_to_string(thread.path().join("stat")).is_ok_and(is_stopped))
}

/// A run folder under test.
#[derive(Debug)]
pub struct Run {
    pub folder: RunFolder,
}

impl Run {
    /// Waits until the learner has trained at least `rollouts` rollouts.
    pub fn wait_for_rollouts(&self, rollouts: usize) {
        wait_until(&format!("{rollouts} rollouts"), || self.metrics().len() >= rollouts);
    }

    /// The trained rollouts so far; of a rollout trained again after a fault, the newest.
    pub fn metrics(&self) -> BTreeMap<u64, serde_json::Value> {
        let text = std::fs::read_to_string(self.folder.metrics()).unwrap_or_default();
        let lines = text.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
        lines.filter_map(|line| Some((line["rollout"].as_u64()?, line))).collect()
    }

    /// Processes of this run whose command line holds `word`, e.g. `--actor ` (with the space: the orchestrator's own
    /// line holds `--actors`).
    pub fn processes(&self, word: &str) -> Vec<u32> {
        let root = self.folder.root();
        let folder = root.display().to_string();
        let mut found = vec![];
        for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
            let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else { continue };
            let Ok(bytes) = std::fs::read(entry.path().join("cmdline")) else { continue };
            let line = String::from_utf8_lossy(&bytes).replace('\0', " ");
            let here = std::fs::read_link(entry.path().join("cwd")).unwrap_or_default();
            // Some are given a path that begins where they were started.
            let ours = line.contains(&folder) || line.split(' ').any(|argument| here.join(argument).starts_with(root));
            if ours && line.contains(word) {
                found.push(pid);
            }
        }
        found.sort_unstable();
        found
    }

    /// Waits until one of these [`Run::processes`] is held at a fault point (`STILLROOM_FAULT=hold=POINT`); its pid.
    pub fn wait_until_held(&self, word: &str) -> u32 {
        wait_for(&format!("a process `{word}` is held"), || self.processes(word).into_iter().find(|pid| is_held(*pid)))
    }

    /// Kills one process whose command line holds `word`, and waits until it is gone.
    pub fn kill_one(&self, word: &str) {
        let found = self.processes(word);
        let pid = *found.first().unwrap_or_else(|| panic!("no process to kill has `{word}` in its command line"));
        kill(pid);
        wait_until(&format!("pid {pid} (`{word}`) ends by SIGKILL"), || !self.processes(word).contains(&pid));
    }

    /// The log of a process.
    pub fn log(&self, process: &str) -> String {
        std::fs::read_to_string(self.folder.log(process)).expect("a log")
    }

    pub fn trained(&self) -> u64 {
        self.metrics().values().filter_map(|line| line["frames"].as_u64()).max().unwrap_or(0)
    }

    pub fn learner(&self) -> u32 {
        let found = self.processes("--rank");
        assert_eq!(found.len(), 1, "one learner runs");
        found[0]
    }

    /// Messages per topic over all recordings of the run, in file order.
    pub fn recorded(&self) -> BTreeMap<String, u64> {
        let mut counts = BTreeMap::new();
        for path in self.recordings() {
            let bytes = std::fs::read(&path).expect("a readable recording");
            for message in mcap::MessageStream::new(&bytes).expect("an MCAP file") {
                *counts.entry(message.expect("a whole message").channel.topic.clone()).or_default() += 1;
            }
        }
        counts
    }

    /// The MCAP files of the run, in order; also those of other hosts that are in its folder.
    pub fn recordings(&self) -> Vec<PathBuf> {
        let folders = self.folder.host_folders().into_iter().map(|host| host.recordings());
        let folders: Vec<PathBuf> = Some(self.folder.recordings()).into_iter().chain(folders).collect();
        let entries = folders.iter().flat_map(|folder| std::fs::read_dir(folder).into_iter().flatten().flatten());
        let mut files: Vec<PathBuf> = entries
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|end| end == "mcap"))
            .collect();
        files.sort();
        files
    }

    /// Waits until no process of the run is left: a killed orchestrator's children notice within moments, not at once.
    pub fn wait_for_end(&self) {
        let begun = Instant::now();
        while !self.processes("").is_empty() && begun.elapsed() < Duration::from_secs(20) {
            std::thread::sleep(Duration::from_millis(50));
        }
        let processes = self.processes("");
        assert!(processes.is_empty(), "processes are left: {processes:?}");
    }

    /// Asserts that no process, no shared memory and no temporary folder of this run is left.
    pub fn assert_nothing_left(&self) {
        self.wait_for_end();
        let id = self.folder.id().expect("run.toml holds the run's id");
        // Other hosts' names go on with a letter and a number.
        let prefix = format!("{}{id}", wire::PREFIX_MARK);
        for folder in [Path::new(wire::SHARED_MEMORY), &std::env::temp_dir()] {
            let left: Vec<_> = std::fs::read_dir(folder)
                .expect("a readable folder")
                .flatten()
                .filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix))
                .map(|entry| entry.path())
                .collect();
            assert!(left.is_empty(), "{} holds {left:?}", folder.display());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "no process to kill")]
    fn a_process_that_is_not_there_cannot_be_killed() {
        Workshop::new().run("nothing").kill_one("--actor ");
    }

    #[test]
    #[should_panic(expected = "it ended before it was killed")]
    fn a_command_that_has_ended_cannot_be_killed() {
        let mut child = start(Command::new("true"));
        child.wait().unwrap();
        kill_child(child);
    }
}
