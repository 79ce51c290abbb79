use super::figures::progress;
use super::file::{Suite, SuiteEntry};
use super::folder::{Next, Step, SuiteFolder};
use super::state::{RunStatus, State, Status};
use crate::evaluation::choice::word;
use crate::output::log_line::error_in;
use crate::output::table::cell;
use crate::output::terminal;
use crate::run::lifeline::this_program;
use crate::supervisor::shell::{hang_up_signal, next};
use anyhow::{Context, Result};
use proto::bounded;
use proto::device::VISIBLE_DEVICES;
use proto::exit::how;
use proto::plain_file::open_plain;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::process::{ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tokio::process::{Child, Command};
use tokio::signal::unix::{SignalKind, signal};
use wire::fault;

const TICK: Duration = Duration::from_millis(200);
/// How long a process of an earlier call may go on holding a run: it saves, at the end of an update at the latest.
const HELD_PATIENCE: Duration = Duration::from_mins(15);
const LINE_EVERY: Duration = Duration::from_secs(20);
const REFRESH_EVERY: Duration = Duration::from_secs(2);
const LAST_WORDS_BYTES: u64 = 8192;
const REASON_MAX: usize = 150;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SuiteOutcome {
    Done,
    Stopped,
    Interrupted,
    Incomplete,
}

struct Worker {
    entry: usize,
    step: Step,
    place: usize,
    child: Child,
    /// Where its own words begin in the log, which has those of earlier tries, too.
    log_begin: u64,
}

struct Scheduler<'a> {
    suite: &'a Suite,
    folder: &'a SuiteFolder,
    state: State,
    places: Vec<Option<String>>,
    workers: Vec<Worker>,
    settled: Vec<bool>,
    held_since: BTreeMap<usize, Instant>,
    stops: u32,
}

/// Works on a suite until all is done that can be. `gpus`: a place each; none = one place that sees what this process
/// sees.
pub fn run(suite: &Suite, folder: &SuiteFolder, gpus: &[String]) -> Result<SuiteOutcome> {
    let names = suite.entries.iter().map(|entry| entry.name.as_str());
    let state = State::read(&folder.state(), names)?;
    let places = if gpus.is_empty() { vec![None] } else { gpus.iter().cloned().map(Some).collect() };
    let settled = vec![false; suite.entries.len()];
    let (workers, held_since) = (Vec::new(), BTreeMap::new());
    let scheduler = Scheduler { suite, folder, state, places, workers, settled, held_since, stops: 0 };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("tokio")?;
    runtime.block_on(scheduler.run())
}

impl Scheduler<'_> {
    async fn run(mut self) -> Result<SuiteOutcome> {
        let mut interrupts = signal(SignalKind::interrupt()).context("cannot catch SIGINT")?;
        let mut terminations = signal(SignalKind::terminate()).context("cannot catch SIGTERM")?;
        let mut hang_ups = hang_up_signal()?;
        let mut tick = tokio::time::interval(TICK);
        let mut told = Instant::now();
        self.write()?;
        loop {
            tokio::select! {
                _ = interrupts.recv() => self.stop(),
                // Asking twice in this way changes nothing, as for a run.
                _ = terminations.recv() => if self.stops == 0 { self.stop() },
                () = next(&mut hang_ups) => if self.stops == 0 { self.stop() },
                _ = tick.tick() => {}
            }
            self.reap()?;
            if self.stops == 0 {
                self.begin_what_fits()?;
            }
            let waits = self.settled.contains(&false) && self.stops == 0;
            if self.workers.is_empty() && !waits {
                break;
            }
            let every = if terminal::interactive() { REFRESH_EVERY } else { LINE_EVERY };
            if told.elapsed() >= every {
                told = Instant::now();
                self.tell();
            }
        }
        terminal::progress(Vec::new());
        Ok(if self.stops > 1 {
            SuiteOutcome::Interrupted
        } else if self.stops == 1 {
            SuiteOutcome::Stopped
        } else if self.state.runs.values().all(|standing| standing.status == Status::Done) {
            SuiteOutcome::Done
        } else {
            SuiteOutcome::Incomplete
        })
    }

    fn stop(&mut self) {
        self.stops += 1;
        if self.stops == 1 {
            let what = match self.workers.len() {
                1 => "its process saves and leaves".to_owned(),
                many => format!("{many} processes save and leave"),
            };
            terminal::note(&format!("stopping: {what}"));
        }
        for worker in &self.workers {
            let pid = worker.child.id().and_then(|id| rustix::process::Pid::from_raw(id.cast_signed()));
            if let Some(pid) = pid {
                // One that has just ended needs no signal.
                let _ = rustix::process::kill_process(pid, rustix::process::Signal::INT);
            }
        }
    }

    fn reap(&mut self) -> Result<()> {
        let mut index = 0;
        while index < self.workers.len() {
            match self.workers[index].child.try_wait().context("waiting for a process")? {
                None => index += 1,
                Some(status) => {
                    let worker = self.workers.swap_remove(index);
                    self.ended(&worker, status)?;
                }
            }
        }
        Ok(())
    }

    /// Decides what the end of a process means: only what is in the folder counts as done.
    fn ended(&mut self, worker: &Worker, exit: ExitStatus) -> Result<()> {
        let entry = &self.suite.entries[worker.entry];
        let next = self.folder.next(self.suite, entry)?;
        let went_on = match (&worker.step, &next) {
            (_, Next::Done) | (Step::Begin | Step::Resume, Next::Step(Step::Evaluate(_))) => true,
            (Step::Evaluate(before), Next::Step(Step::Evaluate(after))) => after > before,
            _ => false,
        };
        let status = if next == Next::Done {
            Status::Done
        } else if went_on {
            Status::Waiting
        } else if self.stops > 0 || exit.success() {
            Status::Stopped
        } else {
            Status::Failed { reason: last_words(&self.folder.log(entry), worker.log_begin, exit) }
        };
        if status != Status::Waiting || self.stops > 0 {
            self.settled[worker.entry] = true;
        }
        if went_on {
            let figures = progress(self.suite, self.folder, entry, &worker.step, None);
            terminal::note(&format!("{}: {figures}", entry.name));
        }
        self.state.of(&entry.name).status = status.clone();
        match &status {
            Status::Waiting => {}
            Status::Failed { reason } => terminal::note(&format!(
                "{} failed: {} (all it said: {})",
                entry.name,
                cell(reason, REASON_MAX),
                self.folder.log(entry).display()
            )),
            other => {
                let done = self.state.runs.values().filter(|run| run.status == Status::Done).count();
                let (how, all) = (other.word(), self.settled.len());
                terminal::note(&format!("{} {how} ({done} of {all} runs)", entry.name));
            }
        }
        self.write()
    }

    fn begin_what_fits(&mut self) -> Result<()> {
        for index in 0..self.suite.entries.len() {
            if self.settled[index] || self.workers.iter().any(|worker| worker.entry == index) {
                continue;
            }
            let taken = |place: &usize| self.workers.iter().any(|worker| worker.place == *place);
            let Some(place) = (0..self.places.len()).find(|place| !taken(place)) else { break };
            let entry = &self.suite.entries[index];
            match self.folder.next(self.suite, entry)? {
                Next::Done => {
                    self.settled[index] = true;
                    self.state.of(&entry.name).status = Status::Done;
                    self.write()?;
                }
                Next::HeldBy(holder) => self.wait_for(index, &holder)?,
                Next::After(from) if self.settled[from] => {
                    self.settled[index] = true;
                    let reason =
                        format!("{} is not trained, whose weights it begins with", self.suite.entries[from].name);
                    self.state.of(&entry.name).status = Status::Failed { reason };
                    self.write()?;
                }
                Next::After(_) => {}
                Next::Step(step) => {
                    self.held_since.remove(&index);
                    self.begin(index, step, place)?;
                }
            }
        }
        Ok(())
    }

    fn wait_for(&mut self, index: usize, holder: &str) -> Result<()> {
        let name = &self.suite.entries[index].name;
        let first = !self.held_since.contains_key(&index);
        let since = *self.held_since.entry(index).or_insert_with(Instant::now);
        if first {
            terminal::note(&format!("{name}: waiting for {holder}, which still works on it"));
        } else if since.elapsed() > HELD_PATIENCE {
            self.settled[index] = true;
            self.state.of(name).status = Status::Failed { reason: format!("{holder} still works on it") };
            self.write()?;
        }
        Ok(())
    }

    fn begin(&mut self, index: usize, step: Step, place: usize) -> Result<()> {
        let entry = &self.suite.entries[index];
        let status = match &step {
            Step::Begin | Step::Resume => Status::Training,
            Step::Evaluate(number) => Status::Evaluating { evaluation: self.suite.evaluations[*number].folder() },
        };
        let gpu = self.places[place].as_ref().map_or_else(String::new, |gpu| format!(" on GPU {gpu}"));
        terminal::note(&format!("{}: {}{gpu}", entry.name, status.text()));
        let standing = self.state.of(&entry.name);
        *standing = RunStatus { status, tries: standing.tries + 1 };
        self.write()?;
        self.folder.clear(self.suite, entry, &step)?;
        fault::reach("suite.before_process");
        let log_begin = std::fs::metadata(self.folder.log(entry)).map_or(0, |log| log.len());
        let child = self.command(entry, &step, place)?.spawn().context("cannot start a process")?;
        self.workers.push(Worker { entry: index, step, place, child, log_begin });
        fault::reach("suite.after_process");
        Ok(())
    }

    fn command(&self, entry: &SuiteEntry, step: &Step, place: usize) -> Result<Command> {
        let log_path = self.folder.log(entry);
        let log = open_plain(&log_path, OpenOptions::new().create(true).append(true));
        let log = log.with_context(|| format!("cannot open {}", log_path.display()))?;
        let mut command = Command::from(this_program());
        command.arg("--parent").arg(std::process::id().to_string());
        let run = self.folder.run(entry);
        match step {
            Step::Begin => {
                command.args(["up", "--preset", &entry.preset, "--seed", &entry.seed.to_string()]);
                command.arg("--config").arg(self.folder.config(entry)).arg("--run").arg(run.root());
                if let Some(from) = entry.from {
                    command.arg("--from").arg(self.folder.run(&self.suite.entries[from]).root());
                }
                if let Some(frames) = entry.frames {
                    command.args(["--frames", &frames.to_string()]);
                }
            }
            Step::Resume => {
                command.arg("resume").arg(run.root());
            }
            Step::Evaluate(number) => {
                let asked = &self.suite.evaluations[*number];
                command.arg("eval").arg(self.folder.subject(entry, asked));
                command.arg("--out").arg(self.folder.evaluation(entry, asked));
                command.args(["--split", &word(&asked.split)]);
                if let Some(objects) = &asked.objects {
                    command.args(["--objects", &word(objects)]);
                }
                if let Some(episodes) = asked.episodes {
                    command.args(["--episodes", &episodes.to_string()]);
                }
                if asked.deterministic {
                    command.arg("--deterministic");
                }
            }
        }
        if let Some(gpu) = &self.places[place] {
            command.env(VISIBLE_DEVICES, gpu);
        }
        command.stdin(Stdio::null()).stdout(log.try_clone().context("log")?).stderr(log);
        // Ctrl-C in a terminal goes to its whole process group: it is for us to pass on, once.
        command.process_group(0);
        Ok(command)
    }

    fn tell(&self) {
        let columns = terminal::live_columns();
        let line = |worker: &Worker| {
            let entry = &self.suite.entries[worker.entry];
            let columns = columns.map(|columns| columns.saturating_sub(entry.name.chars().count() + 2));
            format!("{}  {}", entry.name, progress(self.suite, self.folder, entry, &worker.step, columns))
        };
        let lines: Vec<String> = self.workers.iter().map(line).collect();
        if columns.is_some() {
            terminal::progress(lines);
        } else {
            for line in &lines {
                terminal::note(line);
            }
        }
    }

    fn write(&self) -> Result<()> {
        self.state.write(&self.folder.state())
    }
}

fn last_words(log: &Path, begin: u64, exit: ExitStatus) -> String {
    let mut end = Vec::new();
    let read = open_plain(log, OpenOptions::new().read(true)).and_then(|mut file| {
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(LAST_WORDS_BYTES).max(begin)))?;
        file.read_to_end(&mut end)
    });
    let text = String::from_utf8_lossy(&end);
    // What the program reports at its end, else the last that it logged as an error.
    let error = text.lines().rev().find_map(|line| line.strip_prefix("error: "));
    let error = error.or_else(|| text.lines().rev().find_map(error_in));
    match (read, error) {
        (Ok(_), Some(error)) => error.to_owned(),
        _ => format!("its process {}", how(exit)),
    }
}

#[derive(Debug, Serialize)]
pub struct EntryProgress {
    pub name: String,
    pub folder: String,
    #[serde(flatten)]
    pub status: RunStatus,
}

pub fn standings(suite: &Suite, folder: &SuiteFolder) -> Result<Vec<EntryProgress>> {
    let text = bounded::read_text(&folder.state()).context("suite.json")?;
    let mut state: State = serde_json::from_str(&text).context("suite.json")?;
    let standing = |entry: &SuiteEntry| EntryProgress {
        name: entry.name.clone(),
        folder: folder.run(entry).root().display().to_string(),
        status: state.runs.remove(&entry.name).unwrap_or_default(),
    };
    Ok(suite.entries.iter().map(standing).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::process::ExitStatusExt;

    #[test]
    fn a_try_that_says_nothing_has_not_the_reason_of_the_one_before() {
        let log = tempfile::NamedTempFile::new().unwrap();
        let before = "error: the disk is full\n";
        std::fs::write(log.path(), before).unwrap();
        let killed = ExitStatus::from_raw(9);
        assert_eq!(last_words(log.path(), 0, killed), "the disk is full");
        let how = "its process was killed by signal 9 (SIGKILL)";
        assert_eq!(last_words(log.path(), before.len() as u64, killed), how);
        std::fs::write(log.path(), format!("{before}error: no such device\n")).unwrap();
        assert_eq!(last_words(log.path(), before.len() as u64, killed), "no such device");
    }
}
