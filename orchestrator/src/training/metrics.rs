//! `metrics.jsonl`: one JSON object a trained rollout.
//!
//! The file is only ever appended to. After a crash a learner goes on from its last checkpoint and trains some rollouts
//! again: of several lines with the same rollout number the last is valid, and a line invalidates all earlier ones with
//! higher numbers. [`History`] reads it that way.
//!
//! A rollout can be missing: a learner whose orchestrator was killed finishes its update and saves before it exits, and
//! no process receives its event. Frames, weights and later lines are complete; only this rollout's figures are lost.

use crate::run::json_lines;
use anyhow::Result;
use proto::event::Timing;
use proto::run_folder::RunFolder;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

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
    /// Figures: see [`proto::metric`].
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
    /// Reads the folder's `metrics.jsonl`; empty when there is none.
    pub fn read(folder: &RunFolder) -> Result<Self> {
        let mut history = Self::default();
        for trained in json_lines::read(&folder.metrics())? {
            history.insert(trained);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::json_lines::Writer;
    use std::fs::OpenOptions;
    use std::io::Write;

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
        let mut journal = Writer::open(&folder.metrics()).unwrap();
        for rollout in 0..5 {
            journal.append(&trained(rollout, 1)).unwrap();
        }
        drop(journal);
        // A crash in the middle of a line, then a learner that goes on from rollout 2.
        let torn = &serde_json::to_vec(&trained(5, 1)).unwrap()[..20];
        OpenOptions::new().append(true).open(folder.metrics()).unwrap().write_all(torn).unwrap();
        let mut journal = Writer::open(&folder.metrics()).unwrap();
        for rollout in 2..4 {
            journal.append(&trained(rollout, 2)).unwrap();
        }
        let history = History::read(&folder).unwrap();
        let kept: Vec<_> = history.iter().map(|trained| (trained.rollout, trained.at_unix_s)).collect();
        assert_eq!(kept, [(0, 1), (1, 1), (2, 2), (3, 2)]);
        assert_eq!(history.frames(), 40);
    }
}
