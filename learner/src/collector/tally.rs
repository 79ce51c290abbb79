//! Figures of a rollout, added in the order of its rows, whatever the order in which outcomes come: a floating-point sum
//! depends on it.

use super::column_map::ColumnMap;
use super::environments::Ended;
use super::statistics::RolloutStatistics;
use std::collections::VecDeque;

/// An outcome that is still to be added.
#[derive(Debug)]
struct Waiting {
    t: usize,
    reward: f32,
    ended: Option<Ended>,
}

/// The figures of each shard, and the outcomes of columns that are ahead of others.
#[derive(Debug)]
pub struct Tally {
    column_map: ColumnMap,
    statistics: Vec<RolloutStatistics>,
    /// By column.
    waiting: Vec<VecDeque<Waiting>>,
    /// Rows that are added.
    rows: usize,
    frames: u64,
}

impl Tally {
    /// Of so many shards.
    pub fn new(column_map: ColumnMap, shards: usize) -> Self {
        let waiting = (0..column_map.columns()).map(|_| VecDeque::new()).collect();
        Self { column_map, statistics: vec![RolloutStatistics::default(); shards], waiting, rows: 0, frames: 0 }
    }

    /// An outcome has come: those of a column in the order of their rows.
    pub fn take(&mut self, t: usize, column: usize, reward: f32, ended: Option<Ended>) {
        self.frames += 1;
        self.waiting[column].push_back(Waiting { t, reward, ended });
    }

    /// Nothing more will come of the first `rows` rows.
    pub fn add(&mut self, rows: usize, shards: &[usize]) {
        for t in self.rows..rows {
            for column in (0..self.column_map.halves()).flat_map(|half| self.column_map.batch(half)) {
                let Some(Waiting { reward, ended, .. }) = self.waiting[column].pop_front_if(|first| first.t == t)
                else {
                    continue;
                };
                let statistics = &mut self.statistics[shards[column]];
                statistics.add_step(reward);
                if let Some(Ended { last, running }) = ended {
                    statistics.add_episode(&last, &running);
                }
            }
        }
        self.rows = self.rows.max(rows);
    }

    /// Outcomes that have come.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// The figures of each shard.
    ///
    /// # Panics
    /// If some outcomes are not added.
    pub fn finish(self) -> Vec<RolloutStatistics> {
        assert!(self.waiting.iter().all(VecDeque::is_empty), "every outcome is of a row that is complete");
        self.statistics
    }
}
