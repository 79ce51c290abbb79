//! The shards that a learner trains on: consecutive columns, computed by themselves.
//!
//! Floating-point sums depend on their order, and results of the network on what is computed together. Without
//! `learner.shards` a learner's columns are one shard, so both depend on the number of learners. With it the shards are
//! the same whatever that number: each is inferred and trained on by itself, and what all give is added in an order that
//! knows only shards. Gradients are added by [`crate::ppo`], as a tree; all other sums by [`Shards::sum`].

use crate::peers::{PeerError, Peers};
use proto::config::Config;
use std::iter::repeat_n;
use std::ops::Range;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shards {
    /// The columns of each, numbered as this learner's; together they are all that it has.
    columns: Vec<Range<usize>>,
    /// Its first one's number in the run, and shards of the run; none without `learner.shards`.
    fixed: Option<[usize; 2]>,
}

impl Shards {
    /// So many columns as one shard, whose sums depend on the number of learners.
    pub fn one(columns: usize) -> Self {
        Self { columns: std::iter::once(0..columns).collect(), fixed: None }
    }

    /// Those of a learner that has these of the run's columns. Panics if they are not whole shards.
    pub fn of(config: &Config, columns: &Range<usize>) -> Self {
        if config.learner.shards == 0 {
            return Self::one(columns.len());
        }
        let (shares, each) = (config.shares(), config.actors.environments_per_actor as usize);
        let of_run = (0..shares.shards()).map(|shard| {
            let actors = shares.actors_in(shard);
            actors.start as usize * each..actors.end as usize * each
        });
        let own = of_run.enumerate().filter(|(_, shard)| columns.start <= shard.start && shard.end <= columns.end);
        let own: Vec<(usize, Range<usize>)> = own.collect();
        let first = own.first().expect("a learner has whole shards").0;
        let own: Vec<_> =
            own.into_iter().map(|(_, shard)| shard.start - columns.start..shard.end - columns.start).collect();
        assert_eq!(own.iter().map(Range::len).sum::<usize>(), columns.len(), "a learner has whole shards alone");
        Self { columns: own, fixed: Some([first, shares.shards() as usize]) }
    }

    /// The columns of each, numbered as this learner's.
    pub fn columns(&self) -> &[Range<usize>] {
        &self.columns
    }

    pub(crate) fn of_columns(&self) -> Vec<usize> {
        self.columns.iter().enumerate().flat_map(|(shard, columns)| repeat_n(shard, columns.len())).collect()
    }

    /// Whether they are the same whatever the number of learners.
    pub(crate) fn are_fixed(&self) -> bool {
        self.fixed.is_some()
    }

    /// Sums over all shards of the run, as many numbers as each of this learner's shards gives. Panics if there is not
    /// one list for each shard, all of one length.
    pub fn sum(&self, own: &[Vec<f64>], peers: &Peers) -> Result<Vec<f64>, PeerError> {
        assert_eq!(own.len(), self.columns.len(), "one list for each shard");
        let width = own[0].len();
        assert!(own.iter().all(|numbers| numbers.len() == width), "lists of one length");
        let Some([first, shards]) = self.fixed else {
            let mut sums = own[0].clone();
            peers.sum(&mut sums)?;
            return Ok(sums);
        };
        // Each learner fills the places of its own: to add zeros changes nothing.
        let mut places = vec![0.0; shards * width];
        places[first * width..(first + own.len()) * width].copy_from_slice(&own.concat());
        peers.sum(&mut places)?;
        let in_order = |number: usize| places.iter().skip(number).step_by(width).fold(0.0, |sum, part| sum + part);
        Ok((0..width).map(in_order).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(actors: u32, shards: u32) -> Config {
        let mut config = Config::default();
        (config.actors.count, config.actors.environments_per_actor) = (actors, 3);
        config.learner.shards = shards;
        config
    }

    #[test]
    fn a_learner_has_the_whole_shards_among_its_columns() {
        let config = config(5, 4);
        let all = Shards::of(&config, &(0..15));
        assert_eq!((all.columns(), all.fixed), (&[0..6, 6..9, 9..12, 12..15][..], Some([0, 4])));
        assert_eq!(all.of_columns(), [0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]);
        let second = Shards::of(&config, &(9..15));
        assert_eq!((second.columns(), second.fixed), (&[0..3, 3..6][..], Some([2, 4])));
        assert_eq!(Shards::of(&self::config(5, 0), &(6..15)), Shards::one(9));
    }

    #[test]
    fn shards_are_added_in_their_order_and_nothing_else_is() {
        let shards = Shards::of(&config(4, 4), &(0..12));
        let own = [[1e100, 1.0], [1.0, -0.0], [-1e100, 2.0], [0.5, -3.0]].map(Vec::from);
        assert_eq!(shards.sum(&own, &Peers::Alone).unwrap(), [0.5, 0.0]);
        let one = Shards::one(12).sum(&[vec![-0.0, 7.0]], &Peers::Alone).unwrap();
        assert!(one[0].is_sign_negative() && one[1] == 7.0, "one learner's numbers stay as they are");
    }
}
