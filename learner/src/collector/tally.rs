//! Figures of a rollout, added in the order of its rows, whatever the order in which outcomes come: a floating-point sum
//! depends on it.

use super::column_map::ColumnMap;
use super::statistics::{Ended, RolloutStatistics};
use proto::task::Spec;
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
    pub fn new(column_map: ColumnMap, task: &'static Spec, shards: usize) -> Self {
        let waiting = (0..column_map.columns()).map(|_| VecDeque::new()).collect();
        Self { column_map, statistics: vec![RolloutStatistics::of(task); shards], waiting, rows: 0, frames: 0 }
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
                if let Some(ended) = ended {
                    statistics.add_episode(&ended);
                }
            }
        }
        self.rows = self.rows.max(rows);
    }

    /// Outcomes that have come.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// The figures of each shard. Panics if some outcomes are not added.
    pub fn finish(self) -> Vec<RolloutStatistics> {
        assert!(self.waiting.iter().all(VecDeque::is_empty), "every outcome is of a row that is complete");
        self.statistics
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collector::RunningEpisode;

    /// Of two rows and two halves: returns whose sum depends on the order in which they are added, each column's last of
    /// another size.
    const RETURNS: [[f64; 4]; 2] = [[1e16, 1.0, -1e16, 1.0], [1.0, 1e16, 3.0, -1e16]];

    fn tally(shards: usize) -> Tally {
        Tally::new(ColumnMap::new(0, 2, 2), &Spec::built_in()[0], shards)
    }

    fn ended(episode_return: f64) -> Ended {
        let running = RunningEpisode { episode_return, ..RunningEpisode::default() };
        Ended { length: 1, running }
    }

    /// Two actors with two environments: columns 0 and 2 are the first halves, 1 and 3 the second ones.
    fn sum(order: &[(usize, usize)], shards: &[usize], rows: impl Fn(usize) -> usize) -> Vec<Option<f64>> {
        let mut tally = tally(shards.iter().max().unwrap() + 1);
        for (taken, &(t, column)) in order.iter().enumerate() {
            tally.take(t, column, 0.5, Some(ended(RETURNS[t][column])));
            tally.add(rows(taken), shards);
        }
        tally.add(2, shards);
        assert_eq!(tally.frames(), order.len() as u64);
        let mean = |statistics: &RolloutStatistics| statistics.metrics().get(proto::metric::RETURN).copied();
        tally.finish().iter().map(mean).collect()
    }

    #[test]
    fn sums_are_those_of_rows_in_order_however_far_ahead_some_are() {
        let in_order = [(0, 0), (0, 2), (0, 1), (0, 3), (1, 0), (1, 2), (1, 1), (1, 3)];
        let expected = in_order.iter().fold(0.0, |sum, &(t, column)| sum + RETURNS[t][column]) / 8.0;
        assert_eq!(sum(&in_order, &[0; 4], |taken| (taken + 1) / 4), [Some(expected)]);
        let ahead = [(0, 3), (1, 3), (0, 1), (0, 2), (1, 2), (1, 1), (0, 0), (1, 0)];
        let as_they_come = ahead.iter().fold(0.0, |sum, &(t, column)| sum + RETURNS[t][column]) / 8.0;
        assert!(as_they_come != expected, "the order matters");
        assert_eq!(sum(&ahead, &[0; 4], |taken| usize::from(taken >= 6)), [Some(expected)]);
    }

    #[test]
    fn each_shard_has_its_own_and_who_holds_has_none() {
        let order = [(0, 0), (1, 0), (0, 1), (0, 3), (0, 2)];
        let found = sum(&order, &[0, 0, 1, 1], |_| 0);
        let of_first = (RETURNS[0][0] + RETURNS[0][1] + RETURNS[1][0]) / 3.0;
        assert_eq!(found, [Some(of_first), Some(f64::midpoint(RETURNS[0][2], RETURNS[0][3]))]);
        let nothing = tally(1).finish();
        assert_eq!((nothing.len(), nothing[0].frames()), (1, 0));
    }
}
