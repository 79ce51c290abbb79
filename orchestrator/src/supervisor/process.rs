//! Child processes: they are started with a lifeline, their output is read, and they are reaped.
//!
//! Every child gets a process group of its own, so that Ctrl-C in the terminal reaches the orchestrator alone, and a
//! pipe as standard input, its lifeline: it closes when the orchestrator lets go or dies. Standard error goes line by
//! line to `RUN/logs/NAME.log`; warnings, errors and whatever is not a log line (a panic, a library's complaint) also
//! to the terminal. A learner writes its events to standard output ([`proto::event`]).

use super::event::{Event, Exit, Process};
use super::messages::{last_call, of_environment};
use crate::environment::describe::place;
use crate::output::log_line::LogLine;
use crate::preflight::placement::{Placement, start_on};
use crate::preflight::programs::Programs;
use proto::actor_notes::Noted;
use proto::config::EnvironmentConfig;
use proto::device::{VISIBLE_DEVICES, device_name};
use proto::event::LearnerEvent;
use proto::hosts::MEETING_KEY;
use proto::plain_file::open_plain;
use proto::run_folder::RunFolder;
use rustix::io::{FdFlags, fcntl_setfd};
use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use std::collections::{BTreeMap, VecDeque};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::os::fd::AsRawFd;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncRead, BufReader};
use tokio::process::{Child, ChildStdin, Command};
use tokio::sync::{mpsc, oneshot};
use tracing::Level;
use wire::WireAddress;

/// The variables with the token that keeps strangers out where a run has several hosts, and with its file's name.
pub const TOKEN: &str = "STILLROOM_TOKEN";
pub const TOKEN_FILE: &str = "STILLROOM_TOKEN_FILE";
/// NCCL's own variable for the interface that it uses; `=` asks for exactly that one.
const NCCL_INTERFACE: &str = "NCCL_SOCKET_IFNAME";
const LAST_WORDS: usize = 10;
const LONGEST_LINE: usize = 64 << 10;
/// After a child's death its pipes close at once, unless a grandchild holds them.
const PIPES_CLOSE: Duration = Duration::from_secs(2);
const TRACE_WITHIN: Duration = Duration::from_millis(500);

#[derive(Debug, Clone)]
pub struct Launch {
    pub programs: Programs,
    pub environment: Option<EnvironmentConfig>,
    pub learners: u32,
    pub threads: u32,
    pub evaluates: bool,
    pub folder: RunFolder,
    pub address: WireAddress,
    /// Cores of each; none where the kernel chooses. It numbers the processes of this host from 0.
    pub placement: Option<Placement>,
    pub first: [u32; 2],
    pub network: Option<LearnersNetwork>,
}

#[derive(Debug, Clone)]
pub struct LearnersNetwork {
    pub hosts: u32,
    pub store: SocketAddr,
    pub key: String,
    pub own: IpAddr,
    pub interface: Option<String>,
    pub listener: Option<Arc<TcpListener>>,
}

impl LearnersNetwork {
    fn tell(&self, command: &mut Command, rank: u32) {
        let Self { hosts, store, key, own, interface, listener } = self;
        command.args(["--hosts", &hosts.to_string(), "--meet", &store.to_string(), "--address", &own.to_string()]);
        if let (0, Some(listener)) = (rank, listener) {
            command.args(["--listener", &listener.as_raw_fd().to_string()]);
        }
        // Not on the command line, which everybody can read.
        command.env(MEETING_KEY, key);
        let interface = interface.as_deref().or(own.is_loopback().then_some("lo"));
        if let (Some(interface), None) = (interface, std::env::var_os(NCCL_INTERFACE)) {
            command.env(NCCL_INTERFACE, format!("={interface}"));
        }
    }

    /// Starts the process that inherits the listening socket. Nothing else is started meanwhile: all processes are
    /// started by one thread.
    fn lend<T>(&self, start: impl FnOnce() -> T) -> std::io::Result<T> {
        let Some(listener) = &self.listener else { return Ok(start()) };
        fcntl_setfd(listener, FdFlags::empty())?;
        let started = start();
        fcntl_setfd(listener, FdFlags::CLOEXEC)?;
        Ok(started)
    }
}

impl Launch {
    fn command(&self, process: Process, incarnation: u32) -> Command {
        let mut command = match process {
            Process::Learner(rank) => {
                let mut command = Command::new(&self.programs.learner);
                if self.evaluates {
                    command.arg("evaluate").arg("--run").arg(self.folder.root());
                } else {
                    command.arg("--run").arg(self.folder.root()).arg("--rank").arg(rank.to_string());
                }
                if self.learners > 1 {
                    // Each learner sees one device, so kernels and NCCL need no device number.
                    let visible = std::env::var(VISIBLE_DEVICES).ok();
                    let device = rank - self.first[0];
                    command.env(VISIBLE_DEVICES, device_name(device as usize, visible.as_deref()));
                    // All are on this machine: NCCL's sockets need not be open to others.
                    if self.network.is_none() && std::env::var_os(NCCL_INTERFACE).is_none() {
                        command.env(NCCL_INTERFACE, "=lo");
                    }
                }
                if let Some(network) = &self.network {
                    network.tell(&mut command, rank);
                }
                let threads = self.threads.to_string();
                command.envs(self.programs.learner_environment.iter().map(|(name, value)| (name, value)));
                command.env("OMP_NUM_THREADS", &threads).env("MKL_NUM_THREADS", &threads);
                // Beside busy actors a spinning OpenMP thread burns the core that its sibling waits for. A thousand
                // turns cost no more than to sleep and be woken.
                command.env("GOMP_SPINCOUNT", "1000").env("OMP_WAIT_POLICY", "PASSIVE");
                // Besides its warnings, which the learner logs itself, libtorch logs only its internals.
                if std::env::var_os("TORCH_CPP_LOG_LEVEL").is_none() {
                    command.env("TORCH_CPP_LOG_LEVEL", "ERROR");
                }
                command
            }
            Process::Actor(actor) => {
                let mut command = match &self.environment {
                    Some(environment) => environment.program().into(),
                    None => Command::new(&self.programs.actor),
                };
                command.arg("--actor").arg(actor.to_string()).arg("--config").arg(absolute(self.folder.config()));
                command
            }
        };
        command.arg("--wire").arg(self.address.to_string()).arg("--incarnation").arg(incarnation.to_string());
        command.arg("--lifeline");
        // What keeps strangers out is for orchestrators alone.
        command.env_remove(TOKEN).env_remove(TOKEN_FILE);
        if incarnation > 1 {
            // An armed fault point applies once, not to every replacement of the dead process.
            command.env_remove(wire::fault::VARIABLE);
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command.process_group(0).kill_on_drop(true);
        command
    }
}

/// A path that is the same in whatever folder a process works. Without a current folder it stays as it is.
fn absolute(path: PathBuf) -> PathBuf {
    std::path::absolute(&path).unwrap_or(path)
}

struct Handle {
    lifeline: Option<ChildStdin>,
    kill: Option<oneshot::Sender<()>>,
}

pub struct Processes {
    launch: Launch,
    running: BTreeMap<Process, Handle>,
    events: mpsc::Sender<Event>,
}

impl Processes {
    pub fn new(launch: Launch, events: mpsc::Sender<Event>) -> Self {
        Self { launch, running: BTreeMap::new(), events }
    }

    /// Starts a child. On failure the child counts as one that exited at once.
    pub fn spawn(&mut self, process: Process, incarnation: u32) -> Result<(), String> {
        let log_path = self.launch.folder.log(&process.to_string());
        let mut log = open_plain(&log_path, OpenOptions::new().create(true).append(true))
            .map_err(|cause| format!("cannot open its log {}: {cause}", log_path.display()))?;
        let mut command = self.launch.command(process, incarnation);
        let program = command.as_std().get_program().to_owned();
        let _ = writeln!(log, "--- {process}, start {incarnation} of {}", self.launch.address);
        let [first_learner, first_actor] = self.launch.first;
        let mut start = || match &self.launch.placement {
            None => Ok(command.spawn()),
            Some(placement) => {
                let cores = match process {
                    Process::Learner(rank) => placement.of_learner(rank - first_learner),
                    Process::Actor(actor) => placement.of_actor(actor - first_actor),
                };
                start_on(cores, || command.spawn()).map_err(|error| format!("{process}: {error:#}"))
            }
        };
        let child = match (&self.launch.network, process) {
            (Some(network), Process::Learner(0)) => {
                network.lend(start).map_err(|error| format!("{process}: {error:#}"))?
            }
            _ => start(),
        };
        let mut child = child?.map_err(|cause| format!("{}: {cause}", program.display()))?;
        tracing::debug!("{process} started, pid {}", child.id().unwrap_or_default());
        let lifeline = child.stdin.take();
        let (kill, killed) = oneshot::channel();
        let notes = match process {
            Process::Actor(actor) if self.launch.environment.is_some() => Some((self.launch.folder.clone(), actor)),
            Process::Actor(_) | Process::Learner(_) => None,
        };
        let child = Attended { child, process, incarnation, notes };
        tokio::spawn(attend(child, log, self.events.clone(), killed));
        self.running.insert(process, Handle { lifeline, kill: Some(kill) });
        Ok(())
    }

    pub fn close_lifeline(&mut self, process: Process) {
        if let Some(handle) = self.running.get_mut(&process) {
            handle.lifeline = None;
        }
    }

    pub fn kill(&mut self, process: Process) {
        if let Some(kill) = self.running.get_mut(&process).and_then(|handle| handle.kill.take()) {
            // Err: it has just ended by itself.
            let _ = kill.send(());
        }
    }

    pub fn forget(&mut self, process: Process) {
        self.running.remove(&process);
    }
}

struct Attended {
    child: Child,
    process: Process,
    incarnation: u32,
    /// What an actor that runs the code of others keeps written down.
    notes: Option<(RunFolder, u32)>,
}

/// Stays with a child until it is reaped and everything it wrote has been read. Whatever it has started dies with it.
async fn attend(attended: Attended, log: File, events: mpsc::Sender<Event>, mut killed: oneshot::Receiver<()>) {
    let Attended { mut child, process, incarnation, notes } = attended;
    let group = child.id().and_then(|id| Pid::from_raw(id.cast_signed()));
    let stdout = child.stdout.take().map(|stdout| tokio::spawn(hear(stdout, process, incarnation, events.clone())));
    let quiet = notes.is_some();
    let stderr = child.stderr.take().map(|stderr| tokio::spawn(keep_log(stderr, process, log, quiet)));
    let mut may_be_killed = true;
    let status = loop {
        tokio::select! {
            status = child.wait() => break status,
            order = &mut killed, if may_be_killed => {
                may_be_killed = false;
                if order.is_ok() {
                    if let (Some(_), Some(id)) = (&notes, group) {
                        // Python writes a trace to standard error. The library of other languages ignores the signal.
                        let _ = kill_process(id, Signal::USR1);
                        let _ = tokio::time::timeout(TRACE_WITHIN, child.wait()).await;
                    }
                    if let Err(error) = child.start_kill() {
                        tracing::debug!("cannot kill {process}: {error}");
                    }
                }
            }
        }
    };
    if let (Some(_), Some(group)) = (&notes, group) {
        // Err: there is nobody left, as it should be.
        let _ = kill_process_group(group, Signal::KILL);
    }
    // No event is lost: all are delivered before its exit.
    if let Some(stdout) = stdout {
        let _ = tokio::time::timeout(PIPES_CLOSE, stdout).await;
    }
    let (mut last_words, trace) = match stderr {
        Some(stderr) => tokio::time::timeout(PIPES_CLOSE, stderr).await.ok().and_then(Result::ok).unwrap_or_default(),
        None => Default::default(),
    };
    let exit = match status {
        Ok(status) => exit_of(status),
        Err(error) => Exit::NotStarted(format!("it was lost: {error}")),
    };
    let has_said_why = last_words.iter().any(|line| LogLine::parse(line).level == Some(Level::ERROR));
    if !has_said_why && let Some(noted) = notes.and_then(|(folder, actor)| Noted::read(&folder, actor)) {
        last_words.push(last_call(noted.place, place(&trace).as_deref()));
    }
    tracing::debug!("{process} ended: {exit}");
    let _ = events.send(Event::Exited { process, incarnation, exit, last_words }).await;
}

fn exit_of(status: ExitStatus) -> Exit {
    match (status.code(), status.signal()) {
        (Some(code), _) => Exit::Code(code),
        (None, Some(signal)) => Exit::Signal(signal),
        (None, None) => Exit::NotStarted(status.to_string()),
    }
}

async fn hear(stdout: impl AsyncRead + Unpin, process: Process, incarnation: u32, events: mpsc::Sender<Event>) {
    let mut reader = BufReader::new(stdout);
    while let Some(line) = next_line(&mut reader).await {
        let Process::Learner(rank) = process else {
            tracing::debug!("{process}: {line}");
            continue;
        };
        match serde_json::from_str::<LearnerEvent>(&line) {
            Ok(event) if event.rank() != rank => {
                tracing::warn!("{process} sent an event in another learner's name: {line}");
            }
            Ok(event) => {
                if events.send(Event::Learner { incarnation, event }).await.is_err() {
                    return;
                }
            }
            Err(error) => tracing::warn!("{process} printed a line that is no event ({error}): {line}"),
        }
    }
}

/// Copies a child's standard error to its log; returns its last lines, and the last trace of Python's `faulthandler` in
/// it. `quiet`: what others' code prints, which is no log line, does not go to the terminal.
async fn keep_log(
    stderr: impl AsyncRead + Unpin,
    process: Process,
    mut log: File,
    quiet: bool,
) -> (Vec<String>, String) {
    let mut reader = BufReader::new(stderr);
    let mut last_words = VecDeque::with_capacity(LAST_WORDS);
    let mut trace = String::new();
    let mut log_works = true;
    while let Some(line) = next_line(&mut reader).await {
        if log_works && let Err(error) = writeln!(log, "{line}") {
            // Said once; the pipe must be read on, or the child would block.
            log_works = false;
            tracing::warn!("the log of {process} cannot be written: {error}");
        }
        match LogLine::parse(&line) {
            LogLine { level: Some(Level::TRACE | Level::DEBUG | Level::INFO), text } => {
                tracing::debug!("{process}: {text}");
            }
            // It is reported with the actor's death.
            LogLine { level: Some(Level::ERROR), text } if of_environment(text).is_some() => {
                tracing::debug!("{process}: {text}");
            }
            LogLine { level: Some(Level::ERROR), text } => tracing::error!("{process}: {text}"),
            LogLine { level: None, text } if quiet => {
                tracing::debug!("{process}: {text}");
                // Not of another thread.
                let begins = text.ends_with(" (most recent call first):") && !text.starts_with("Thread ");
                if begins {
                    trace.clear();
                }
                if begins || !trace.is_empty() && trace.len() < LONGEST_LINE {
                    trace.extend([text, "\n"]);
                }
            }
            LogLine { text, .. } if !text.trim().is_empty() => tracing::warn!("{process}: {text}"),
            LogLine { .. } => {}
        }
        if last_words.len() == LAST_WORDS {
            last_words.pop_front();
        }
        last_words.push_back(line);
    }
    (last_words.into(), trace)
}

async fn next_line(reader: &mut (impl AsyncBufReadExt + Unpin)) -> Option<String> {
    let mut line: Vec<u8> = Vec::new();
    loop {
        let available = match reader.fill_buf().await {
            Ok([]) | Err(_) => {
                return (!line.is_empty()).then(|| String::from_utf8_lossy(&line).into_owned());
            }
            Ok(available) => available,
        };
        let end = available.iter().position(|&byte| byte == b'\n');
        let taken = end.unwrap_or(available.len()).min(LONGEST_LINE - line.len());
        line.extend_from_slice(&available[..taken]);
        let complete = end == Some(taken);
        reader.consume(taken + usize::from(complete));
        if complete || line.len() == LONGEST_LINE {
            if line.last() == Some(&b'\r') {
                line.pop();
            }
            return Some(String::from_utf8_lossy(&line).into_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::AsyncReadExt;

    #[test]
    fn nccl_of_several_learners_stays_on_the_machine() {
        let interface = |learners: u32, process: Process| {
            let programs =
                Programs { learner: "learner".into(), actor: "actor".into(), learner_environment: Vec::new() };
            let launch = Launch {
                programs,
                environment: None,
                learners,
                threads: 1,
                evaluates: false,
                folder: RunFolder::new("run"),
                address: WireAddress::new("nccl", 1),
                placement: None,
                first: [0, 0],
                network: None,
            };
            let command = launch.command(process, 1);
            let set = command.as_std().get_envs().find(|(name, _)| *name == NCCL_INTERFACE);
            set.and_then(|(_, value)| Some(value?.to_str()?.to_owned()))
        };
        assert_eq!(interface(2, Process::Learner(1)).as_deref(), Some("=lo"));
        assert_eq!(interface(1, Process::Learner(0)), None);
        assert_eq!(interface(2, Process::Actor(0)), None);
    }

    #[tokio::test]
    async fn lines_are_cut_and_the_last_needs_no_end() {
        let long = "x".repeat(LONGEST_LINE + 5);
        let text = format!("one\r\n\n{long}\nlast");
        let mut reader = BufReader::with_capacity(1000, text.as_bytes());
        let mut lines = vec![];
        while let Some(line) = next_line(&mut reader).await {
            lines.push(line);
        }
        assert_eq!(lines, ["one", "", &long[..LONGEST_LINE], "xxxxx", "last"]);
    }

    #[tokio::test]
    async fn a_child_is_heard_to_its_last_word_before_its_exit() {
        let (sender, mut events) = mpsc::channel(16);
        // An event in another learner's name is ignored.
        let script = r#"echo '{"event":"actors_connected","rank":1}'; echo '{"event":"actors_connected","rank":0}'
            echo one >&2; echo two >&2; read x; exit 7"#;
        let mut child = Command::new("sh")
            .args(["-c", script])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lifeline = child.stdin.take();
        let (_kill, killed) = oneshot::channel();
        let log = tempfile::tempfile().unwrap();
        let child = Attended { child, process: Process::Learner(0), incarnation: 4, notes: None };
        tokio::spawn(attend(child, log, sender, killed));
        let first = events.recv().await.unwrap();
        assert_eq!(first, Event::Learner { incarnation: 4, event: LearnerEvent::ActorsConnected { rank: 0 } });
        drop(lifeline);
        let last = events.recv().await.unwrap();
        assert_eq!(
            last,
            Event::Exited {
                process: Process::Learner(0),
                incarnation: 4,
                exit: Exit::Code(7),
                last_words: vec!["one".into(), "two".into()]
            }
        );
    }

    #[tokio::test]
    async fn of_others_code_that_hangs_the_line_is_said() {
        let (sender, mut events) = mpsc::channel(16);
        let traced = "Thread 0x2 (most recent call first):\\n  File \\\"/lib.py\\\", line 1 in wait\\n\
                      Stack (most recent call first):\\n  File \\\"/mine.py\\\", line 14 in step\\n";
        let script = format!(r#"trap 'printf "{traced}" >&2' USR1; echo ready; while :; do sleep 0.01; done"#);
        let mut child = Command::new("sh")
            .args(["-c", &script])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()
            .unwrap();
        let mut ready = [0];
        child.stdout.as_mut().unwrap().read_exact(&mut ready).await.unwrap();
        let folder = tempfile::tempdir().unwrap();
        let notes = RunFolder::new(folder.path());
        std::fs::create_dir(notes.logs()).unwrap();
        std::fs::write(notes.actor_notes(0), [5_u64, 7, 0, 0].map(u64::to_ne_bytes).as_flattened()).unwrap();
        let (kill, killed) = oneshot::channel();
        let child = Attended { child, process: Process::Actor(0), incarnation: 1, notes: Some((notes, 0)) };
        tokio::spawn(attend(child, tempfile::tempfile().unwrap(), sender, killed));
        kill.send(()).unwrap();
        let Some(Event::Exited { exit, last_words, .. }) = events.recv().await else { panic!("no exit") };
        assert_eq!(exit, Exit::Signal(9));
        let call = "its last call was in environment 5, episode 0, step 7, at step() (/mine.py:14)";
        assert_eq!(last_words.last().map(String::as_str), Some(call));
    }
}
