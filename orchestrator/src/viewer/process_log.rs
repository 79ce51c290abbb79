//! The end of each process's log, and the processes of a run as a page lists them.

use super::processes::Process;
use super::tail::{New, Tail};
use crate::output::log_line::LogLine as Parsed;
use proto::run_folder::by_number;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::time::Instant;
use tracing::Level;
use view::data::{LogLine, Worker};

pub const WARNINGS: usize = 30;
const LINES: usize = 14;
const TEXT_MAX: usize = 600;

pub struct Log {
    tail: Tail,
    pub lines: VecDeque<LogLine>,
    pub warnings: VecDeque<LogLine>,
    /// Starts of its process in all, and within the newest start of the orchestrator.
    starts: u32,
    incarnation: u32,
    /// Its process is on another host.
    is_remote: bool,
}

impl Log {
    pub fn of(tail: Tail, is_remote: bool) -> Self {
        let (lines, warnings) = (VecDeque::new(), VecDeque::new());
        Self { tail, lines, warnings, starts: 0, incarnation: 0, is_remote }
    }

    pub fn read(&mut self, until: Instant) -> std::io::Result<()> {
        loop {
            let new = self.tail.read()?;
            let more = new.more;
            self.take(new);
            if !more || Instant::now() > until {
                return Ok(());
            }
        }
    }

    fn take(&mut self, new: New) {
        if new.anew {
            (self.starts, self.incarnation) = (0, 0);
            self.lines.clear();
            self.warnings.clear();
        }
        for line in new.lines {
            let line = String::from_utf8_lossy(&line);
            if let Some(start) = line.strip_prefix("--- ") {
                self.starts += 1;
                let number = start.split_once(", start ").and_then(|(_, rest)| rest.split_once(' ')?.0.parse().ok());
                self.incarnation = number.unwrap_or(self.starts);
                continue;
            }
            let Parsed { level, text } = Parsed::parse(&line);
            let at = line.split_once(' ').filter(|_| level.is_some()).map_or("", |(at, _)| at);
            let text = text.chars().take(TEXT_MAX).collect();
            let shown = LogLine { at: at.to_owned(), level: level.map_or("", |level| level.as_str()).to_owned(), text };
            // An error is the least verbose of levels.
            if level.is_some_and(|level| level <= Level::WARN) {
                push(&mut self.warnings, shown.clone(), WARNINGS);
            }
            push(&mut self.lines, shown, LINES);
        }
    }
}

fn push(lines: &mut VecDeque<LogLine>, line: LogLine, most: usize) {
    if lines.len() == most {
        lines.pop_front();
    }
    lines.push_back(line);
}

/// Processes of a run by their logs, and what `/proc` says of those on this host; `growing`: those whose memory grows.
pub fn workers(logs: &BTreeMap<String, Log>, processes: &[Process], growing: &BTreeMap<String, String>) -> Vec<Worker> {
    let process = |name: &str| processes.iter().find(|process| process.name == name);
    let worker = |name: &str, incarnation: u32, starts: u32| {
        let process = process(name);
        Worker {
            name: name.to_owned(),
            pid: process.map(|process| process.pid),
            incarnation,
            starts,
            cores: process.and_then(|process| process.cores),
            memory_bytes: process.and_then(|process| process.memory_bytes),
            growth: growing.get(name).cloned(),
            stopped: process.is_some_and(|process| process.stopped),
        }
    };
    // While a run goes on, those that have ended are left out: of other hosts nothing is seen.
    let ended = |name: &str, log: &Log| !processes.is_empty() && !log.is_remote && process(name).is_none();
    let of_logs = logs.iter().filter(|(name, log)| log.starts > 0 && !ended(name, log));
    let mut workers: Vec<Worker> = of_logs.map(|(name, log)| worker(name, log.incarnation, log.starts)).collect();
    // The orchestrator and learners before actors.
    let is_actor = |worker: &Worker| !worker.name.starts_with("learner");
    workers
        .sort_by(|a, b| is_actor(a).cmp(&is_actor(b)).then_with(|| by_number(Path::new(&a.name), Path::new(&b.name))));
    if process("orchestrator").is_some() {
        workers.insert(0, worker("orchestrator", 1, 1));
    }
    workers
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::run_folder::RunFolder;

    #[test]
    fn of_a_run_that_goes_on_what_has_ended_is_left_out() {
        let folder = RunFolder::new("nowhere");
        let log = |name: &str, is_remote: bool| {
            let tail = Tail::of(folder.clone(), folder.log(name), 0);
            (name.to_owned(), Log { starts: 1, ..Log::of(tail, is_remote) })
        };
        let logs = BTreeMap::from([log("actor-00", false), log("actor-01", false), log("actor-02", true)]);
        let process =
            |name: &str| Process { name: name.to_owned(), pid: 7, cores: None, memory_bytes: None, stopped: false };
        let named = |processes: &[Process]| {
            let workers = workers(&logs, processes, &BTreeMap::new());
            workers.into_iter().map(|worker| worker.name).collect::<Vec<_>>()
        };
        assert_eq!(named(&[process("orchestrator"), process("actor-01")]), ["orchestrator", "actor-01", "actor-02"]);
        assert_eq!(named(&[]), ["actor-00", "actor-01", "actor-02"], "at rest");
    }
}
