//! The batch, divided by columns: into minibatches, of which each is a step of the optimiser, and these into chunks, which
//! only bound memory.

use super::gae::Targets;
use super::loss::Experience;
use crate::device::upload;
use crate::network::{Embedded, Network, Observations, Packing};
use crate::rollout::Rollout;
use proto::random::{Key, Purpose};

/// Rows of a minibatch that go through the network in one pass: those of some columns.
#[derive(Debug)]
pub(crate) struct Chunk {
    /// Which (step, column) each row is.
    pub packing: Packing,
    /// What the loss compares the network's output with.
    pub experience: Experience,
    /// What was seen, if nothing bounds the memory of a pass: then it is gathered once, not in every epoch. Otherwise each
    /// chunk gathers its own anew.
    observations: Option<Observations>,
}

/// Deals a learner's columns out among so many minibatches, as evenly as can be: one list of columns each, in order.
/// Neighbours are alike, such as the environments of one kitchen, so chance deals: a function of (seed, rollout, column
/// of the whole run).
pub(crate) fn deal(columns: usize, minibatches: u32, seed: u64, rollout: u64, first_column: usize) -> Vec<Vec<usize>> {
    let drawn = |column: usize| Key {
        seed,
        purpose: Purpose::Minibatch,
        kitchen: 0,
        environment: (first_column + column) as u32,
        episode: rollout as u32,
        step: 0,
    };
    let mut order: Vec<(u32, usize)> = (0..columns).map(|column| (drawn(column).stream().next_u32(), column)).collect();
    order.sort_unstable();
    let mut dealt = vec![Vec::new(); minibatches as usize];
    for (rank, (_, column)) in order.into_iter().enumerate() {
        dealt[rank % minibatches as usize].push(column);
    }
    for columns in &mut dealt {
        columns.sort_unstable();
    }
    dealt
}

impl Chunk {
    /// Divides the minibatch of these columns into chunks of so many; 0 = all in one.
    pub(crate) fn divide(rollout: &Rollout, targets: &Targets, columns: &[usize], columns_each: u32) -> Vec<Self> {
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
                    actions: rollout.gather(&packing, |step| step.action),
                    log_probs: rollout.gather(&packing, |step| step.log_prob),
                    values: rollout.gather(&packing, |step| step.value),
                    advantages: target(&|row| targets.advantage(row)),
                    returns: target(&|row| targets.value_target(row)),
                };
                let observations =
                    (columns_each == 0 || width >= rollout.columns()).then(|| rollout.observations(&packing));
                Self { packing, experience, observations }
            })
            // In a rollout of one step, columns that hold have no rows.
            .filter(|chunk| !chunk.packing.rows.is_empty())
            .collect()
    }

    /// Embeds its observations, to train: \[rows, 512 + 32 + 16\].
    pub(crate) fn embed<'a>(&self, network: &'a Network, rollout: &Rollout) -> Embedded<'a> {
        match &self.observations {
            Some(observations) => network.embed_to_train(observations),
            None => network.embed_to_train(&rollout.observations(&self.packing)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
