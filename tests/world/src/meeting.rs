//! The learners' group: collective operations that end for nobody before all have begun them, and fail or hang for the
//! others when one is dead.

use crate::service::TaskId;
use learner::collector::Boundary;
use std::rc::Rc;

/// What a learner brings to a collective operation.
#[derive(Debug, Clone)]
pub enum Word {
    Here,
    /// A number that must be everybody's.
    Same(u64),
    /// Numbers to be added up, and a digest to be added up with them.
    Sum(Vec<u64>, u64),
    /// Its environments, for the first learner's checkpoint.
    Part(Boundary),
    /// The first learner's word counts.
    First(u8),
}

/// Another learner is dead.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lost;

/// The group of one joint start.
#[derive(Debug)]
pub struct Meeting {
    calls: Vec<Vec<Option<Word>>>,
    /// By rank: operations begun.
    begun: Vec<usize>,
    tasks: Vec<Option<TaskId>>,
    /// When the others notice that one is dead; none if they hang.
    lost_at: Option<u64>,
    dead: bool,
}

impl Meeting {
    /// A group of that many.
    pub fn new(learners: u32) -> Self {
        let learners = learners as usize;
        Self { calls: vec![], begun: vec![0; learners], tasks: vec![None; learners], lost_at: None, dead: false }
    }

    /// A learner begins its next operation. Those that can go on when it was the last.
    pub fn begin(&mut self, rank: u32, task: TaskId, word: Word) -> Vec<TaskId> {
        let rank = rank as usize;
        self.tasks[rank] = Some(task);
        let call = self.begun[rank];
        self.begun[rank] += 1;
        if self.calls.len() == call {
            self.calls.push(vec![None; self.begun.len()]);
        }
        self.calls[call][rank] = Some(word);
        let whole = self.calls[call].iter().all(Option::is_some);
        if whole { self.tasks.iter().flatten().copied().collect() } else { vec![] }
    }

    /// What all brought to the operation that this learner is in, once all have; none while it waits.
    pub fn end(&mut self, rank: u32, now: u64) -> Option<Result<Rc<Vec<Word>>, Lost>> {
        let call = self.begun[rank as usize] - 1;
        let words: Option<Vec<Word>> = self.calls[call].iter().cloned().collect();
        match words {
            Some(words) => Some(Ok(Rc::new(words))),
            None => self.lost_at.filter(|&at| at <= now).map(|_| Err(Lost)),
        }
    }

    /// A learner is dead: from `at` on the others notice, or never. Those who wait.
    pub fn died(&mut self, task: TaskId, at: Option<u64>) -> Vec<TaskId> {
        if !self.tasks.contains(&Some(task)) || std::mem::replace(&mut self.dead, true) {
            return vec![];
        }
        self.lost_at = at;
        self.tasks.iter().flatten().copied().filter(|&other| other != task).collect()
    }
}
