//! The batch, divided by columns: into minibatches, of which each is a step of the optimiser, and these into chunks, which
//! only bound memory. Each shard is divided by itself: a chunk has columns of one.

use super::gae::Targets;
use super::loss::Experience;
use crate::device::upload;
use crate::network::{Embedded, Network, Observations, Packing};
use crate::rollout::Rollout;
use crate::shards::Shards;
use proto::random::{Key, Purpose};
use std::ops::Range;

/// Rows of a minibatch that go through the network in one pass: those of some columns.
#[derive(Debug)]
pub(crate) struct Chunk {
    /// Which of this learner's shards its columns are of.
    pub shard: usize,
    /// Which (step, column) each row is.
    pub packing: Packing,
    /// What the loss compares the network's output with.
    pub experience: Experience,
    /// What was seen, if nothing bounds the memory of a pass: then it is gathered once, not in every epoch. Otherwise each
    /// chunk gathers its own anew.
    observations: Option<Observations>,
}

/// A rollout's columns to be dealt out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deal {
    pub minibatches: u32,
    pub seed: u64,
    pub rollout: u64,
    /// Number, in the whole run, of the learner's first column.
    pub first_column: usize,
}

/// Deals a shard's columns out among minibatches, as evenly as can be: one list of columns each, in order. Neighbours
/// are alike, such as the environments of one kitchen, so chance deals: a function of (seed, rollout, column of the
/// whole run). Minibatch `to`, counted round, gets the first that is drawn.
fn deal_out(columns: Range<usize>, to: usize, deal: Deal) -> Vec<Vec<usize>> {
    let Deal { minibatches, seed, rollout, first_column } = deal;
    let drawn = |column: usize| Key {
        seed,
        purpose: Purpose::Minibatch,
        kitchen: 0,
        environment: (first_column + column) as u32,
        episode: rollout as u32,
        step: 0,
    };
    let mut order: Vec<(u32, usize)> = columns.map(|column| (drawn(column).stream().next_u32(), column)).collect();
    order.sort_unstable();
    let mut dealt = vec![Vec::new(); minibatches as usize];
    for (rank, (_, column)) in order.into_iter().enumerate() {
        dealt[(to + rank) % minibatches as usize].push(column);
    }
    for columns in &mut dealt {
        columns.sort_unstable();
    }
    dealt
}

impl Deal {
    /// The columns of each minibatch: a list for each shard, with the shard's number.
    pub(crate) fn columns(self, shards: &Shards) -> Vec<Vec<(usize, Vec<usize>)>> {
        let mut minibatches = vec![Vec::new(); self.minibatches as usize];
        for (shard, columns) in shards.columns().iter().enumerate() {
            // Where there are several, one goes on where the last one ended: each may have fewer columns than there are
            // minibatches.
            let to = if shards.are_fixed() { self.first_column + columns.start } else { 0 };
            for (minibatch, columns) in minibatches.iter_mut().zip(deal_out(columns.clone(), to, self)) {
                minibatch.push((shard, columns));
            }
        }
        minibatches
    }
}

impl Chunk {
    /// Divides a minibatch, as its columns by shard, into chunks of at most so many columns; 0 = all of a shard in one.
    pub(crate) fn divide(
        rollout: &Rollout,
        targets: &Targets,
        minibatch: &[(usize, Vec<usize>)],
        columns_each: u32,
    ) -> Vec<Self> {
        let of = |(shard, columns): &(usize, Vec<usize>)| {
            // Otherwise passes are to bound memory.
            let unbounded = columns_each == 0 || columns_each as usize >= rollout.columns();
            Self::of_shard(rollout, targets, *shard, columns, (columns_each, unbounded))
        };
        minibatch.iter().flat_map(of).collect()
    }

    /// `unbounded`: a pass has room for all columns.
    fn of_shard(
        rollout: &Rollout,
        targets: &Targets,
        shard: usize,
        columns: &[usize],
        (columns_each, unbounded): (u32, bool),
    ) -> Vec<Self> {
        let width = match columns_each {
            0 => columns.len(),
            width => width as usize,
        };
        columns
            .chunks(width.max(1))
            .map(|chunk| {
                let packing = rollout.packing(chunk.iter().copied());
                let device = rollout.beliefs_at_start().device();
                let target = |of: &dyn Fn((usize, usize)) -> f32| {
                    let values: Vec<f32> = packing.rows.iter().map(|&row| of(row)).collect();
                    upload(&values, device)
                };
                let experience = Experience {
                    actions: rollout.actions(&packing),
                    log_probs: rollout.gather(&packing, |step| step.log_prob),
                    values: rollout.gather(&packing, |step| step.value),
                    advantages: target(&|row| targets.advantage(row)),
                    returns: target(&|row| targets.value_target(row)),
                };
                let observations = unbounded.then(|| rollout.observations(&packing));
                Self { shard, packing, experience, observations }
            })
            // In a rollout of one step, columns that hold have no rows.
            .filter(|chunk| !chunk.packing.rows.is_empty())
            .collect()
    }

    /// Embeds its observations, to train with them in the update of this number: \[rows, 512 + 32 + 16\].
    pub(crate) fn embed<'a>(&self, network: &'a Network, rollout: &Rollout, update: u64) -> Embedded<'a> {
        match &self.observations {
            Some(observations) => network.embed_to_train(observations, update),
            None => network.embed_to_train(&rollout.observations(&self.packing), update),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::Config;

    fn deal(columns: usize, minibatches: u32, seed: u64, rollout: u64, first_column: usize) -> Vec<Vec<usize>> {
        let dealt = Deal { minibatches, seed, rollout, first_column }.columns(&Shards::one(columns));
        dealt.into_iter().map(|minibatch| minibatch.into_iter().flat_map(|(_, columns)| columns).collect()).collect()
    }

    #[test]
    fn every_column_is_dealt_once_evenly_and_by_chance() {
        let dealt = deal(19, 4, 7, 3, 0);
        assert_eq!(dealt.iter().map(Vec::len).collect::<Vec<_>>(), [5, 5, 5, 4]);
        assert!(dealt.iter().all(|columns| columns.is_sorted()));
        let mut all = dealt.concat();
        all.sort_unstable();
        assert_eq!(all, (0..19).collect::<Vec<_>>());
        assert_eq!(deal(19, 4, 7, 3, 0), dealt);
        for other in [deal(19, 4, 8, 3, 0), deal(19, 4, 7, 4, 0), deal(19, 4, 7, 3, 19)] {
            assert_ne!(other, dealt, "seed, rollout and the learner's place count");
        }
        assert_eq!(deal(19, 1, 7, 3, 0), [(0..19).collect::<Vec<_>>()]);
        assert_eq!(deal(2, 3, 7, 3, 0).concat().len(), 2, "more minibatches than columns");
    }

    /// A shard's columns are dealt alike whichever learner has it, and all minibatches are alike large.
    #[test]
    fn shards_are_dealt_by_themselves() {
        let mut config = Config::default();
        (config.actors.count, config.learner.shards) = (5, 4);
        for environments in [1, 2, 3] {
            config.actors.environments_per_actor = environments;
            let each = environments as usize;
            let dealt = |first: usize, end: usize| {
                let (shards, first_column) = (Shards::of(&config, &(first..end)), first);
                let deal = Deal { minibatches: 3, seed: 7, rollout: 3, first_column };
                let mut all = deal.columns(&shards).into_iter().map(|minibatch| {
                    minibatch.into_iter().flat_map(|(_, columns)| columns).map(|column| column + first).collect()
                });
                [all.next(), all.next(), all.next()].map(|columns: Option<Vec<usize>>| columns.unwrap())
            };
            let whole = dealt(0, 5 * each);
            let [first, second] = [dealt(0, 3 * each), dealt(3 * each, 5 * each)];
            for (minibatch, columns) in whole.iter().enumerate() {
                assert_eq!(*columns, [first[minibatch].clone(), second[minibatch].clone()].concat());
                assert!(columns.len().abs_diff(5 * each / 3) <= 1, "{whole:?}");
            }
        }
    }
}
