//! The batch, divided by columns or by rows: into minibatches, of which each is a step of the optimiser, and these into
//! chunks, which only bound memory. Each shard is divided by itself: a chunk has columns of one.

use super::gae::{self, Targets};
use super::loss::Experience;
use crate::network::{Embedded, Network, Observations, Packing};
use crate::peers::{PeerError, Peers};
use crate::rollout::{Rollout, StepTable};
use crate::shards::Shards;
use proto::random::{Key, Purpose};
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use tch::Tensor;

/// A rollout with its targets on its device, of which minibatches are parts.
#[derive(Debug)]
pub(crate) struct Whole<'a> {
    rollout: &'a Rollout,
    table: StepTable,
    /// `A_t` and `R_t` of each row of the table.
    advantages: Tensor,
    returns: Tensor,
}

/// Rows of a minibatch that go through the network in one pass.
#[derive(Debug)]
pub(crate) struct Chunk {
    /// No other chunk of this process has it, and a chunk's numbers stay as they are while passes go over it.
    pub(super) id: u64,
    /// Which of this learner's shards its rows are of.
    pub shard: usize,
    /// Which (step, column) each row is.
    pub packing: Packing,
    /// The same as rows of the rollout, i64 on the device.
    rows: Tensor,
    /// What the loss compares the network's output with.
    pub experience: Experience,
    /// What was seen, where chunks outlast an epoch and nothing bounds the memory of a pass: then it is gathered once.
    /// Otherwise each pass gathers its own.
    observations: Option<Observations>,
}

/// How a rollout is dealt out, by columns or by frames.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deal {
    pub minibatches: u32,
    pub seed: u64,
    pub rollout: u64,
    /// Number, in the whole run, of the learner's first column.
    pub first_column: usize,
}

/// What each minibatch is dealt: a list for each shard, with the shard's number.
type Dealt<T> = Vec<Vec<(usize, Vec<T>)>>;

impl Deal {
    pub(crate) fn columns(self, shards: &Shards) -> Dealt<usize> {
        let mut dealt = self.out(shards, 0, |columns| columns.map(|column| (0, column)).collect());
        dealt.iter_mut().flatten().for_each(|(_, cells)| cells.sort_unstable());
        let column = |(_, column): (usize, usize)| column;
        let columns = |(shard, cells): (usize, Vec<_>)| (shard, cells.into_iter().map(column).collect());
        dealt.into_iter().map(|minibatch| minibatch.into_iter().map(columns).collect()).collect()
    }

    /// The frames, (step, column), of each minibatch of an epoch, in the order in which they are drawn. Column n has
    /// `steps(n)`.
    pub(crate) fn rows(self, shards: &Shards, epoch: u32, steps: impl Fn(usize) -> usize) -> Dealt<(usize, usize)> {
        let of = |column: usize| (0..steps(column)).map(move |t| (t, column));
        self.out(shards, epoch, |columns| columns.flat_map(of).collect())
    }

    /// Deals the cells of each shard out among minibatches, as evenly as can be. Neighbours are alike, such as the
    /// environments of one kitchen, so chance deals: a function of (seed, rollout, epoch, column of the whole run,
    /// step).
    fn out(
        self,
        shards: &Shards,
        epoch: u32,
        cells: impl Fn(Range<usize>) -> Vec<(usize, usize)>,
    ) -> Dealt<(usize, usize)> {
        let Self { minibatches, seed, rollout, first_column } = self;
        let drawn = |(t, column): (usize, usize)| Key {
            seed,
            purpose: Purpose::Minibatch,
            // The key has no field for the epoch, and no kitchen applies here.
            kitchen: epoch,
            environment: (first_column + column) as u32,
            episode: rollout as u32,
            step: t as u32,
        };
        let mut dealt = vec![Vec::new(); minibatches as usize];
        for (shard, columns) in shards.columns().iter().enumerate() {
            // Where there are several, one goes on where the last one ended: each may have fewer columns than there are
            // minibatches.
            let to = if shards.are_fixed() { first_column + columns.start } else { 0 };
            // By chance, then by place: as one number, which sorts several times as fast as three.
            let place = |(t, column): (usize, usize)| (t * columns.end + column) as u64;
            let ranked = |cell| u64::from(drawn(cell).stream().next_u32()) << 32 | place(cell);
            let mut order: Vec<u64> = cells(columns.clone()).into_iter().map(ranked).collect();
            order.sort_unstable();
            for minibatch in &mut dealt {
                minibatch.push((shard, vec![]));
            }
            for (rank, ranked) in order.into_iter().enumerate() {
                let place = ranked as u32 as usize;
                let cell = (place / columns.end, place % columns.end);
                dealt[(to + rank) % minibatches as usize][shard].1.push(cell);
            }
        }
        dealt
    }
}

/// Of the next chunk.
static NEXT_ID: AtomicU64 = AtomicU64::new(0);

impl<'a> Whole<'a> {
    pub(crate) fn new(rollout: &'a Rollout, targets: &Targets) -> Self {
        let table = rollout.table();
        let [advantages, returns] = targets.to_device(table.values.device());
        Self { rollout, table, advantages, returns }
    }

    fn experience(&self, rows: &Tensor) -> Experience {
        let Self { table: StepTable { actions, masks, log_probs, values, .. }, advantages, returns, .. } = self;
        let of = |part: &Tensor| part.index_select(0, rows);
        Experience {
            actions: of(actions),
            masks: masks.as_ref().map(of),
            log_probs: of(log_probs),
            values: of(values),
            advantages: of(advantages),
            returns: of(returns),
        }
    }

    fn observations(&self, chunk: &Chunk) -> Observations {
        self.rollout.observations(&self.table, &chunk.rows)
    }
}

impl Chunk {
    /// Divides a minibatch, as its columns by shard, into chunks of at most so many columns; 0 = all of a shard in one.
    pub(crate) fn divide(whole: &Whole, minibatch: &[(usize, Vec<usize>)], columns_each: u32) -> Vec<Self> {
        let of = |(shard, columns): &(usize, Vec<usize>)| {
            // Otherwise passes are to bound memory.
            let unbounded = columns_each == 0 || columns_each as usize >= whole.rollout.columns();
            Self::of_shard(whole, *shard, columns, (columns_each, unbounded))
        };
        minibatch.iter().flat_map(of).collect()
    }

    /// The same of a minibatch of frames, in chunks of at most so many; 0 = all of a shard in one.
    pub(crate) fn of_rows(whole: &Whole, minibatch: Vec<(usize, Vec<(usize, usize)>)>, rows_each: usize) -> Vec<Self> {
        let dealt = minibatch.into_iter().filter(|(_, rows)| !rows.is_empty());
        let of = |(shard, rows): (usize, Vec<(usize, usize)>)| -> Vec<Self> {
            let width = if rows_each == 0 { rows.len() } else { rows_each };
            let packings = rows.chunks(width).map(|chunk| Packing::of_rows(chunk.to_vec()));
            packings.map(|packing| Self::new(whole, shard, (packing, false))).collect()
        };
        dealt.flat_map(of).collect()
    }

    /// `unbounded`: a pass has room for all columns.
    fn of_shard(whole: &Whole, shard: usize, columns: &[usize], (columns_each, unbounded): (u32, bool)) -> Vec<Self> {
        let width = match columns_each {
            0 => columns.len(),
            width => width as usize,
        };
        columns
            .chunks(width.max(1))
            .map(|chunk| whole.rollout.packing(chunk.iter().copied()))
            // In a rollout of one step, columns that hold have no rows.
            .filter(|packing| !packing.rows.is_empty())
            .map(|packing| Self::new(whole, shard, (packing, unbounded)))
            .collect()
    }

    fn new(whole: &Whole, shard: usize, (packing, unbounded): (Packing, bool)) -> Self {
        let rows = whole.rollout.rows(&packing);
        let experience = whole.experience(&rows);
        let id = NEXT_ID.fetch_add(1, Ordering::Relaxed);
        let mut chunk = Self { id, shard, packing, rows, experience, observations: None };
        chunk.observations = unbounded.then(|| whole.observations(&chunk));
        chunk
    }

    /// Normalises the advantages of a minibatch: mean 0 and deviation 1 over the frames of all learners. 1e-8 is added to
    /// the deviation (`CleanRL`, Stable-Baselines3).
    pub(crate) fn normalize(
        minibatch: &mut [Self],
        targets: &Targets,
        shards: &Shards,
        peers: &Peers,
    ) -> Result<(), PeerError> {
        let mut advantages = vec![vec![]; shards.columns().len()];
        for Self { shard, packing, .. } in &*minibatch {
            advantages[*shard].extend(packing.rows.iter().map(|&row| f64::from(targets.advantage(row))));
        }
        let (mean, deviation) = gae::moments(&advantages, shards, peers)?;
        for Self { experience, .. } in minibatch {
            experience.advantages = (&experience.advantages - mean) / (deviation + 1e-8);
        }
        Ok(())
    }

    /// A copy with observations of its own.
    pub(super) fn copy(&self, whole: &Whole) -> Self {
        let Self { id, shard, packing, rows, experience, observations } = self;
        let gathered = observations.is_none().then(|| whole.observations(self));
        let observations = observations.as_ref().or(gathered.as_ref()).map(Observations::copy);
        let experience = experience.copy();
        Self { id: *id, shard: *shard, packing: packing.clone(), rows: rows.copy(), experience, observations }
    }

    /// Takes another chunk's numbers in place of its own, which are as many, unless it has them. Panics unless it is a copy.
    pub(super) fn take(&mut self, other: &Self, whole: &Whole) {
        if std::mem::replace(&mut self.id, other.id) == other.id {
            return;
        }
        let own = self.observations.as_ref().expect("a copy has observations");
        match &other.observations {
            Some(observations) => own.take(observations),
            None => own.take(&whole.observations(other)),
        }
        self.experience.take(&other.experience);
    }

    /// Embeds its observations, to train with them in the update of this number: \[rows, width\].
    pub(crate) fn embed<'a>(&self, network: &'a Network, whole: &Whole, update: u64) -> Embedded<'a> {
        match &self.observations {
            Some(observations) => network.embed_to_train(observations, update),
            None => network.embed_to_train(&whole.observations(self), update),
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

    #[test]
    fn every_frame_is_dealt_once_in_an_epoch_evenly_and_by_chance() {
        let deal = Deal { minibatches: 4, seed: 7, rollout: 3, first_column: 0 };
        // The last two columns hold in the last step.
        let rows = |epoch: u32| deal.rows(&Shards::one(5), epoch, |column| 8 - usize::from(column > 2));
        let dealt: Vec<Vec<(usize, usize)>> = rows(0).into_iter().map(|mut own| own.remove(0).1).collect();
        assert_eq!(dealt.iter().map(Vec::len).collect::<Vec<_>>(), [10, 10, 9, 9]);
        let mut all = dealt.concat();
        assert!(!all.is_sorted());
        all.sort_unstable();
        let cells = (0..8).flat_map(|t| (0..5).map(move |column| (t, column)));
        assert_eq!(all, cells.filter(|&(t, column)| t < 7 || column < 3).collect::<Vec<_>>());
        assert_eq!(rows(0), rows(0));
        assert_ne!(rows(1), rows(0));
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
