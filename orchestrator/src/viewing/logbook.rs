//! The logs of a run's processes, on all of its hosts: which there are, and what is new in them, by time.

use super::tail::Tail;
use proto::run_folder::RunFolder;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Logs by the names of their processes. What supervises another host is its `agent`.
pub fn logs_of(folder: &RunFolder) -> Vec<(String, PathBuf)> {
    let mut found = logs_in(&folder.logs());
    for host in folder.host_folders() {
        let number = host.root().file_name().and_then(|name| name.to_str()?.parse::<u32>().ok()).unwrap_or_default();
        let named = |(name, path): (String, PathBuf)| match name.as_str() {
            "orchestrator" => (format!("agent-{number}"), path),
            _ => (name, path),
        };
        found.extend(logs_in(&host.logs()).into_iter().map(named));
    }
    found
}

/// Logs in one folder by the names of their processes.
fn logs_in(folder: &std::path::Path) -> Vec<(String, PathBuf)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let named = |path: PathBuf| Some((path.file_stem()?.to_str()?.to_owned(), path));
    let is_log = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "log");
    let mut found: Vec<(String, PathBuf)> = entries.filter(is_log).filter_map(named).collect();
    found.sort();
    found
}

/// A line of a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// When: what the line begins with, or the last line before it that has a time. Sorts by time.
    pub at: String,
    /// Whose.
    pub process: String,
    /// The whole line.
    pub line: String,
}

/// What was read of a log.
#[derive(Debug)]
struct Book {
    tail: Tail,
    /// Time of its last line that has one.
    at: String,
}

/// Logs that are read again and again.
#[derive(Debug)]
pub struct Logbook {
    folder: RunFolder,
    /// Names or groups of processes; all if there are none.
    wanted: Vec<String>,
    books: BTreeMap<String, Book>,
}

impl Logbook {
    /// Of these processes, or of such groups as `actor`; of all if none is named. Nothing is read yet.
    pub fn of(folder: RunFolder, wanted: Vec<String>) -> Self {
        Self { folder, wanted, books: BTreeMap::new() }
    }

    /// Those of the names that no log has.
    pub fn unknown(&self) -> Vec<&str> {
        let there = logs_of(&self.folder);
        let has = |wanted: &&String| there.iter().any(|(name, _)| is_of(name, wanted));
        self.wanted.iter().filter(|wanted| !has(wanted)).map(String::as_str).collect()
    }

    /// The lines that are new, by time. A line without one, such as those of a panic, stays behind the line before it, or
    /// comes first.
    pub fn read(&mut self) -> std::io::Result<Vec<Entry>> {
        let mut entries = Vec::new();
        for (name, path) in logs_of(&self.folder) {
            if !self.wanted.is_empty() && !self.wanted.iter().any(|wanted| is_of(&name, wanted)) {
                continue;
            }
            let book =
                self.books.entry(name.clone()).or_insert_with(|| Book { tail: Tail::of(path), at: String::new() });
            for line in book.tail.read()?.lines {
                let line = String::from_utf8_lossy(&line).into_owned();
                if let Some(at) = time_of(&line) {
                    at.clone_into(&mut book.at);
                }
                entries.push(Entry { at: book.at.clone(), process: name.clone(), line });
            }
        }
        entries.sort_by(|a, b| a.at.cmp(&b.at));
        Ok(entries)
    }

    /// Whether lines of more than one process can come.
    pub fn is_of_many(&self) -> bool {
        self.books.len() > 1
    }
}

/// Whether a process has this name, or is one of this group: `actor-03` is one of `actor`.
fn is_of(name: &str, wanted: &str) -> bool {
    name.strip_prefix(wanted).is_some_and(|rest| rest.is_empty() || rest.starts_with('-'))
}

/// The time that a line begins with, as `wire::logging` writes it: these sort as text.
fn time_of(line: &str) -> Option<&str> {
    let (time, _) = line.split_once(' ')?;
    let is_time = time.ends_with('Z') && time.contains('T') && time.starts_with(|first: char| first.is_ascii_digit());
    is_time.then_some(time)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(logs: &[(&str, &str)]) -> (tempfile::TempDir, RunFolder) {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        for (place, text) in logs {
            let path = temporary.path().join(place);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        (temporary, folder)
    }

    fn lines(book: &mut Logbook) -> Vec<String> {
        let entries = book.read().unwrap().into_iter();
        entries
            .map(|Entry { process, line, .. }| format!("{process} {}", line.split(' ').next_back().unwrap()))
            .collect()
    }

    #[test]
    fn lines_of_all_processes_and_hosts_come_by_time_and_each_once() {
        let (temporary, folder) = run(&[
            (
                "logs/orchestrator.log",
                "2026-11-21T02:00:01.000000Z  INFO begin\n2026-11-21T02:00:09.000000Z  INFO end\n",
            ),
            ("logs/learner-0.log", "--- start one\n2026-11-21T02:00:03.000000Z  INFO two\na panic\n"),
            ("logs/notes.txt", "no log\n"),
            ("hosts/001/logs/orchestrator.log", "2026-11-21T02:00:02.000000Z  INFO joined\n"),
            ("hosts/001/logs/actor-07.log", "2026-11-21T02:00:04.000000Z  WARN late\n"),
        ]);
        let mut book = Logbook::of(folder, vec![]);
        assert_eq!(
            lines(&mut book),
            [
                "learner-0 one",
                "orchestrator begin",
                "agent-1 joined",
                "learner-0 two",
                "learner-0 panic",
                "actor-07 late",
                "orchestrator end"
            ]
        );
        assert!(book.is_of_many() && lines(&mut book).is_empty());
        let path = temporary.path().join("logs/learner-0.log");
        let mut file = std::fs::File::options().append(true).open(path).unwrap();
        std::io::Write::write_all(&mut file, b"more of the panic\n").unwrap();
        assert_eq!(lines(&mut book), ["learner-0 panic"]);
    }

    #[test]
    fn a_process_is_named_or_its_group() {
        let line = "2026-11-21T02:00:01.000000Z  INFO x\n";
        let (_temporary, folder) = run(&[
            ("logs/orchestrator.log", line),
            ("logs/actor-01.log", line),
            ("logs/actor-10.log", line),
            ("logs/learner-0.log", line),
        ]);
        let of = |wanted: &[&str]| {
            let mut book = Logbook::of(folder.clone(), wanted.iter().map(|&name| name.to_owned()).collect());
            (lines(&mut book), book.unknown().join(","))
        };
        assert_eq!(of(&["actor"]), (vec!["actor-01 x".to_owned(), "actor-10 x".to_owned()], String::new()));
        assert_eq!(of(&["actor-1", "learner-0"]), (vec!["learner-0 x".to_owned()], "actor-1".to_owned()));
    }
}
