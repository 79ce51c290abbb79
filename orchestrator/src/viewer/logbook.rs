//! The logs of a run's processes, on all of its hosts: which there are, and what is new in them, by time.

use super::tail::Tail;
use crate::output::format::{bytes, counted};
use anyhow::{Context, Result, bail};
use proto::run_folder::{Item, RunFolder};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, VecDeque};
use std::path::PathBuf;

const LOGS_MOST: usize = 2048;
/// All logs together are read up to so many bytes; of longer ones the ends.
const BYTES_MOST: u64 = 4 << 30;

#[derive(Debug, Clone)]
pub struct Found {
    /// Its process. What supervises another host is its `agent`.
    pub name: String,
    pub path: PathBuf,
    bytes: u64,
}

/// Those of a run. Of more than are read there is one more than these, which [`beginnings`] leaves out.
pub fn logs_of(folder: &RunFolder) -> std::io::Result<Vec<Found>> {
    let mut found = logs_in(folder)?;
    for host in folder.host_folders() {
        if found.len() > LOGS_MOST {
            break;
        }
        let number = host.root().file_name().and_then(|name| name.to_str()?.parse::<u32>().ok()).unwrap_or_default();
        let named = |found: Found| match found.name.as_str() {
            "orchestrator" => Found { name: format!("agent-{number}"), ..found },
            _ => found,
        };
        found.extend(logs_in(&host)?.into_iter().map(named));
    }
    found.truncate(LOGS_MOST + 1);
    Ok(found)
}

fn logs_in(folder: &RunFolder) -> std::io::Result<Vec<Found>> {
    let is_log = |item: &Item| !item.is_folder && item.path.extension().is_some_and(|extension| extension == "log");
    let named = |item: Item| {
        Some(Found { name: item.path.file_stem()?.to_str()?.to_owned(), path: item.path, bytes: item.bytes })
    };
    Ok(folder.list(&folder.logs())?.into_iter().filter(is_log).filter_map(named).collect())
}

/// Where reading each log begins, so that not more than `most` bytes of all are read; and what is said if that is not at
/// its start, or if there are too many logs: the last are left out.
pub fn beginnings(logs: &mut Vec<Found>, most: u64) -> (Vec<u64>, Option<String>) {
    let too_many =
        (logs.len() > LOGS_MOST).then(|| format!("there are more than {LOGS_MOST} logs: the others are left out"));
    logs.truncate(LOGS_MOST);
    let all: u64 = logs.iter().map(|log| log.bytes).fold(0, u64::saturating_add);
    if all <= most {
        return (vec![0; logs.len()], too_many);
    }
    let each = most / logs.len() as u64;
    let begin = |log: &Found| log.bytes.saturating_sub(each);
    let said = format!(
        "{} {} together: of each only the last {} are read",
        counted(logs.len() as u64, "log"),
        if logs.len() == 1 { format!("has {}", bytes(all)) } else { format!("have {}", bytes(all)) },
        bytes(each)
    );
    (logs.iter().map(begin).collect(), Some(too_many.into_iter().chain([said]).collect::<Vec<_>>().join("; ")))
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Entry {
    /// When: what the line begins with, or the last line before it that has a time. Sorts by time.
    pub at: String,
    pub process: String,
    pub line: String,
}

struct Book {
    tail: Tail,
    at: String,
    waiting: VecDeque<Entry>,
}

impl Book {
    fn next(&mut self, process: &str) -> std::io::Result<Option<Entry>> {
        while self.waiting.is_empty() {
            let new = self.tail.read()?;
            for line in new.lines {
                let line = String::from_utf8_lossy(&line).into_owned();
                if let Some(at) = time_of(&line) {
                    at.clone_into(&mut self.at);
                }
                self.waiting.push_back(Entry { at: self.at.clone(), process: process.to_owned(), line });
            }
            if !new.more {
                break;
            }
        }
        Ok(self.waiting.pop_front())
    }
}

pub struct Logbook {
    folder: RunFolder,
    wanted: Vec<String>,
    books: BTreeMap<String, Book>,
    pub note: Option<String>,
}

impl Logbook {
    pub fn of(folder: RunFolder, wanted: Vec<String>) -> Self {
        Self { folder, wanted, books: BTreeMap::new(), note: None }
    }

    pub fn unknown(&self) -> std::io::Result<Vec<&str>> {
        let there = logs_of(&self.folder)?;
        let has = |wanted: &&String| there.iter().any(|found| is_of(&found.name, wanted));
        Ok(self.wanted.iter().filter(|wanted| !has(wanted)).map(String::as_str).collect())
    }

    /// Hands on the lines that are new, by time, until `take` returns false; whether it always returned true. `take` is
    /// also told whether lines of more than one process can come. A line without a time, such as those of a panic, stays
    /// behind the line before it, or comes first. A block of each log is in memory. The error names the logs that cannot
    /// be read; those of the others have been handed on.
    pub fn read(&mut self, mut take: impl FnMut(&Entry, bool) -> Result<bool>) -> Result<bool> {
        let mut logs = logs_of(&self.folder).with_context(|| self.folder.logs().display().to_string())?;
        logs.retain(|log| self.wanted.is_empty() || self.wanted.iter().any(|wanted| is_of(&log.name, wanted)));
        let (beginnings, note) = beginnings(&mut logs, BYTES_MOST);
        self.note = note.or(self.note.take());
        for (Found { name, path, .. }, from) in logs.into_iter().zip(beginnings) {
            let new = || Book {
                tail: Tail::of(self.folder.clone(), path, from),
                at: String::new(),
                waiting: VecDeque::new(),
            };
            self.books.entry(name).or_insert_with(new);
        }
        let (of_many, mut problems) = (self.books.len() > 1, Vec::new());
        let mut heads = BinaryHeap::new();
        let mut advance =
            |process: &str, book: &mut Book, heads: &mut BinaryHeap<Reverse<Entry>>| match book.next(process) {
                Ok(entry) => heads.extend(entry.map(Reverse)),
                Err(error) => problems.push(format!("{process}: {error}")),
            };
        for (process, book) in &mut self.books {
            advance(process, book, &mut heads);
        }
        while let Some(Reverse(entry)) = heads.pop() {
            if !take(&entry, of_many)? {
                return Ok(false);
            }
            if let Some(book) = self.books.get_mut(&entry.process) {
                advance(&entry.process, book, &mut heads);
            }
        }
        if problems.is_empty() { Ok(true) } else { bail!("the log of {}", problems.join("; of ")) }
    }
}

/// Whether a process has this name, or is one of this group: `actor-03` is one of `actor`.
fn is_of(name: &str, wanted: &str) -> bool {
    name.strip_prefix(wanted).is_some_and(|rest| rest.is_empty() || rest.starts_with('-'))
}

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
        let mut lines = Vec::new();
        let all = book.read(|Entry { process, line, .. }, _| {
            lines.push(format!("{process} {}", line.split(' ').next_back().unwrap()));
            Ok(true)
        });
        assert!(all.unwrap());
        lines
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
        assert!(lines(&mut book).is_empty());
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
            (lines(&mut book), book.unknown().unwrap().join(","))
        };
        assert_eq!(of(&["actor"]), (vec!["actor-01 x".to_owned(), "actor-10 x".to_owned()], String::new()));
        assert_eq!(of(&["actor-1", "learner-0"]), (vec!["learner-0 x".to_owned()], "actor-1".to_owned()));
    }

    #[test]
    fn a_log_that_is_a_link_is_refused_and_the_others_are_read() {
        let line = "2026-11-21T02:00:01.000000Z  INFO x\n";
        let (temporary, folder) = run(&[("logs/learner-0.log", line), ("private", "secret\n")]);
        std::os::unix::fs::symlink(temporary.path().join("private"), folder.log("orchestrator")).unwrap();
        let (mut book, mut shown) = (Logbook::of(folder, vec![]), Vec::new());
        let error = book.read(|entry, _| {
            shown.push(entry.line.clone());
            Ok(true)
        });
        assert!(error.unwrap_err().to_string().contains("the log of orchestrator: it is a link"));
        assert_eq!(shown, [line.trim_end()]);
    }

    /// They were left out in silence.
    #[test]
    fn of_more_logs_than_are_read_a_sentence_says_so() {
        let (_temporary, folder) = run(&[("logs/orchestrator.log", "--- start one\n")]);
        for number in 0..LOGS_MOST {
            std::fs::write(folder.log(&format!("actor-{number}")), "").unwrap();
        }
        let mut book = Logbook::of(folder, vec![]);
        assert!(lines(&mut book).is_empty(), "actors come first");
        assert_eq!(book.note.as_deref(), Some("there are more than 2048 logs: the others are left out"));
    }

    #[test]
    fn of_logs_without_end_the_ends_are_read() {
        let line = "2026-11-21T02:00:01.000000Z  INFO x\n";
        let (_temporary, folder) = run(&[("logs/orchestrator.log", ""), ("logs/learner-0.log", line)]);
        let mut file = std::fs::File::options().write(true).open(folder.log("orchestrator")).unwrap();
        file.set_len(200 << 30).unwrap();
        std::io::Seek::seek(&mut file, std::io::SeekFrom::End(0)).unwrap();
        std::io::Write::write_all(&mut file, format!("\n{line}").as_bytes()).unwrap();
        let mut logs = logs_of(&folder).unwrap();
        let (from, said) = beginnings(&mut logs, 1 << 20);
        assert_eq!(from, [0, (200 << 30) + 1 + line.len() as u64 - (1 << 19)]);
        assert!(said.unwrap().starts_with("2 logs have "));
        logs.truncate(1);
        assert_eq!(beginnings(&mut logs, 1 << 20), (vec![0], None));
    }
}
