//! `metrics.jsonl`: one JSON object a trained rollout.
//!
//! The file is only ever appended to. After a crash a learner goes on from its last checkpoint and trains some
//! rollouts again: of several lines with one rollout number the last holds, and a line makes all earlier ones with
//! higher numbers void. [`History`] reads it that way. A line that a crash cut short is skipped.

use anyhow::{Context, Result};
use proto::control::Timing;
use proto::run_folder::RunFolder;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};

/// One line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trained {
    /// Number of the rollout, from 0.
    pub rollout: u64,
    /// Frames trained on, this rollout included.
    pub frames: u64,
    /// Stage, as an index into the configuration's.
    pub stage: u32,
    /// When it was trained, seconds since 1970.
    pub at_unix_s: u64,
    /// Incarnation of the orchestrator.
    pub incarnation: u32,
    /// Where the time went.
    pub timing: Timing,
    /// Figures: see [`proto::control::metric`].
    pub metrics: BTreeMap<String, f64>,
}

/// All parts of a timing together, seconds.
pub fn total_s(timing: &Timing) -> f64 {
    timing.simulate_s + timing.infer_s + timing.update_s + timing.other_s
}

/// The rollouts that count, in order.
#[derive(Debug, Clone, Default)]
pub struct History {
    rollouts: BTreeMap<u64, Trained>,
}

impl History {
    /// What the folder's `metrics.jsonl` says; empty when there is none.
    pub fn read(folder: &RunFolder) -> Result<Self> {
        let path = folder.metrics();
        let mut history = Self::default();
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(history),
            Err(error) => return Err(error).with_context(|| path.display().to_string()),
        };
        for line in BufReader::new(file).split(b'\n') {
            let line = line.with_context(|| path.display().to_string())?;
            if let Ok(trained) = serde_json::from_slice(&line) {
                history.insert(trained);
            }
        }
        Ok(history)
    }

    /// Takes in the newest line.
    pub fn insert(&mut self, trained: Trained) {
        self.rewind_to(trained.rollout);
        self.rollouts.insert(trained.rollout, trained);
    }

    /// A learner begins with `rollout` again: what came after its checkpoint is void.
    pub fn rewind_to(&mut self, rollout: u64) {
        drop(self.rollouts.split_off(&rollout));
    }

    /// In order of their numbers.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Trained> {
        self.rollouts.values()
    }

    /// Frames trained on.
    pub fn frames(&self) -> u64 {
        self.rollouts.values().next_back().map_or(0, |last| last.frames)
    }
}

/// Appends to `metrics.jsonl`.
#[derive(Debug)]
pub struct Journal {
    file: File,
}

impl Journal {
    /// Opens the folder's file for appending. A line that a crash cut short is ended, so that the next is whole.
    pub fn open(folder: &RunFolder) -> Result<Self> {
        let path = folder.metrics();
        let mut file = OpenOptions::new()
            .create(true)
            .read(true)
            .append(true)
            .open(&path)
            .with_context(|| format!("cannot open {}", path.display()))?;
        let mut last = [b'\n'];
        if file.metadata()?.len() > 0 {
            file.seek(SeekFrom::End(-1))?;
            file.read_exact(&mut last)?;
        }
        if last != *b"\n" {
            file.write_all(b"\n")?;
        }
        Ok(Self { file })
    }

    /// Writes one line, in one call.
    pub fn append(&mut self, trained: &Trained) -> Result<()> {
        let mut line = serde_json::to_vec(trained)?;
        line.push(b'\n');
        self.file.write_all(&line).context("cannot write metrics.jsonl")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trained(rollout: u64, mark: u64) -> Trained {
        Trained {
            rollout,
            frames: (rollout + 1) * 10,
            stage: 0,
            at_unix_s: mark,
            incarnation: 1,
            timing: Timing::default(),
            metrics: BTreeMap::new(),
        }
    }

    #[test]
    fn later_lines_hold_and_void_what_lay_ahead() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        assert_eq!(History::read(&folder).unwrap().frames(), 0);
        let mut journal = Journal::open(&folder).unwrap();
        for rollout in 0..5 {
            journal.append(&trained(rollout, 1)).unwrap();
        }
        drop(journal);
        // A crash in the middle of a line, then a learner that goes on from rollout 2.
        let torn = &serde_json::to_vec(&trained(5, 1)).unwrap()[..20];
        OpenOptions::new().append(true).open(folder.metrics()).unwrap().write_all(torn).unwrap();
        let mut journal = Journal::open(&folder).unwrap();
        for rollout in 2..4 {
            journal.append(&trained(rollout, 2)).unwrap();
        }
        let history = History::read(&folder).unwrap();
        let kept: Vec<_> = history.iter().map(|trained| (trained.rollout, trained.at_unix_s)).collect();
        assert_eq!(kept, [(0, 1), (1, 1), (2, 2), (3, 2)]);
        assert_eq!(history.frames(), 40);
    }
}
