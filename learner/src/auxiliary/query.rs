//! The queries of an auxiliary task in one epoch. A query is a pair of rows of the same episode, some steps apart.
//!
//! Rows near the end of their episode or of the rollout have no later row and no query. A task may use a random share
//! of the other queries (subsampling). The choice is a function of (seed, rollout, epoch, step, column). So it depends
//! neither on the division of columns into passes nor on earlier draws.

use crate::network::Packing;
use crate::peers::{PeerError, Peers};
use proto::random::{Key, Purpose};

/// Valid queries below which none is left out (reference).
const SUBSAMPLE_LEAST: u64 = 10;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Epoch {
    pub seed: u64,
    pub rollout: u64,
    pub epoch: u32,
    /// Number, in the whole run, of the passes' column 0. With it the draws do not depend on the division of columns
    /// among learners.
    pub first_column: usize,
}

/// One query: predict row `later`, `offset` steps ahead, from the belief of `row`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Query {
    pub row: i64,
    /// Steps ahead, from 1.
    pub offset: i64,
    /// The packing's row of that step.
    pub later: i64,
    /// Row of the negative sample of a contrastive task; `later` itself where there is none.
    pub negative: i64,
}

impl Epoch {
    /// The queries of each of these passes: up to `horizon` steps ahead, a random `share` of all valid ones, or all of
    /// them if all learners together have fewer than 10.
    pub(crate) fn queries(
        self,
        packings: &[&Packing],
        horizon: usize,
        share: f64,
        peers: &Peers,
    ) -> Result<Vec<Vec<Query>>, PeerError> {
        let valid: Vec<Vec<Query>> = packings.iter().map(|packing| all(packing, horizon)).collect();
        if share >= 1.0 || peers.total(count(&valid))? < SUBSAMPLE_LEAST {
            return Ok(valid);
        }
        let asked = packings
            .iter()
            .zip(valid)
            .map(|(packing, queries)| {
                let draws: Vec<Vec<f64>> =
                    packing.rows.iter().map(|&row| self.draws(Purpose::AuxiliarySubsample, row, horizon)).collect();
                queries
                    .into_iter()
                    .filter(|query| draws[query.row as usize][query.offset as usize - 1] < share)
                    .collect()
            })
            .collect();
        Ok(asked)
    }

    /// A random permutation of a pass's rows.
    pub(crate) fn permutation(self, packing: &Packing) -> Vec<i64> {
        let keys: Vec<f64> =
            packing.rows.iter().map(|&row| self.draws(Purpose::AuxiliaryNegatives, row, 1)[0]).collect();
        let mut order: Vec<i64> = (0..keys.len() as i64).collect();
        order.sort_by(|&a, &b| keys[a as usize].total_cmp(&keys[b as usize]));
        order
    }

    /// Numbers in (0, 1) that belong to one step of one column.
    fn draws(self, purpose: Purpose, (step, column): (usize, usize), count: usize) -> Vec<f64> {
        let key = Key {
            seed: self.seed,
            purpose,
            // The key has no field for the epoch, and no kitchen applies here: the epoch uses the kitchen's field.
            kitchen: self.epoch,
            environment: (self.first_column + column) as u32,
            episode: self.rollout as u32,
            step: step as u32,
        };
        let mut random = key.stream();
        (0..count).map(|_| random.uniform_open()).collect()
    }
}

pub(crate) fn count(queries: &[Vec<Query>]) -> u64 {
    queries.iter().map(|queries| queries.len() as u64).sum()
}

/// Every valid query, by offset and then by row.
fn all(packing: &Packing, horizon: usize) -> Vec<Query> {
    (1..=horizon)
        .flat_map(|offset| {
            (0i64..).zip(packing.later(offset)).filter_map(move |(row, later)| {
                later.map(|later| Query { row, offset: offset as i64, later, negative: later })
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    const EPOCH: Epoch = Epoch { seed: 5, rollout: 3, epoch: 1, first_column: 0 };

    fn ask(epoch: Epoch, packings: &[&Packing], horizon: usize, share: f64) -> Vec<Vec<Query>> {
        epoch.queries(packings, horizon, share, &Peers::Alone).unwrap()
    }

    fn packing(columns: std::ops::Range<usize>) -> Packing {
        Packing::new(columns, |_| 60, |t, n| (t + 7 * n) % 23 == 0)
    }

    #[test]
    fn a_share_of_the_valid_queries_is_asked_whatever_the_passes() {
        let whole = packing(0..20);
        let valid = ask(EPOCH, &[&whole], 16, 1.0).remove(0);
        let asked = ask(EPOCH, &[&whole], 16, 0.2).remove(0);
        assert!(asked.iter().all(|query| valid.contains(query)));
        let share = asked.len() as f64 / valid.len() as f64;
        assert!((share - 0.2).abs() < 0.02, "{share}");

        let name = |packing: &Packing, query: &Query| (packing.rows[query.row as usize], query.offset);
        let of_whole: BTreeSet<_> = asked.iter().map(|query| name(&whole, query)).collect();
        let parts = [packing(0..7), packing(7..20)];
        let of_parts = ask(EPOCH, &[&parts[0], &parts[1]], 16, 0.2);
        let of_parts: BTreeSet<_> = parts
            .iter()
            .zip(&of_parts)
            .flat_map(|(part, queries)| queries.iter().map(|query| name(part, query)))
            .collect();
        assert_eq!(of_whole, of_parts);

        for other in [Epoch { epoch: 0, ..EPOCH }, Epoch { rollout: 4, ..EPOCH }, Epoch { seed: 6, ..EPOCH }] {
            assert_ne!(ask(other, &[&whole], 16, 0.2).remove(0), asked);
            assert_ne!(other.permutation(&whole), EPOCH.permutation(&whole));
        }
        // Columns 7 to 19, as a learner's own.
        let moved = Packing::new(0..13, |_| 60, |t, n| (t + 7 * (n + 7)) % 23 == 0);
        let of_moved = ask(Epoch { first_column: 7, ..EPOCH }, &[&moved], 16, 0.2).remove(0);
        let of_last: Vec<_> = ask(EPOCH, &[&parts[1]], 16, 0.2).remove(0);
        assert_eq!(of_moved, of_last);

        let mut permutation = EPOCH.permutation(&whole);
        permutation.sort_unstable();
        assert!(permutation.into_iter().eq(0..1200));
    }

    #[test]
    fn few_queries_are_all_asked() {
        let few = Packing::new(0..3, |_| 4, |_, _| false);
        assert_eq!(ask(EPOCH, &[&few], 1, 0.2)[0].len(), 9);
        let more = Packing::new(0..30, |_| 4, |_, _| false);
        assert!(ask(EPOCH, &[&more], 1, 0.2)[0].len() < 40);
    }
}
