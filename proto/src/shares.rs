//! Which learner serves which actors.
//!
//! A run's actors are divided into shards: consecutive actors each, and if the number does not divide evenly, the first
//! shards have one more. Each learner has consecutive shards, as many as the others. So the columns of all learners, in
//! the order of ranks, are the columns that a single learner would have.
//!
//! Without `learner.shards` every learner is one shard. With it the shards are the same whatever the number of learners.

use std::ops::Range;

/// A run's actors, divided among its learners.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shares {
    actors: u32,
    learners: u32,
    shards: u32,
}

impl Shares {
    /// `actors` actors divided among `learners` learners, each a shard. Panics if a learner would have no actor.
    pub fn new(actors: u32, learners: u32) -> Self {
        Self::in_shards(actors, learners, learners)
    }

    /// `actors` actors in `shards` shards, which are divided among `learners` learners. Panics if a shard would have no
    /// actor, or the shards cannot be divided evenly among the learners.
    pub(crate) fn in_shards(actors: u32, learners: u32, shards: u32) -> Self {
        assert!(learners > 0 && shards > 0, "there are learners, and each has shards");
        assert!(shards <= actors, "every shard has actors");
        assert!(shards.is_multiple_of(learners), "every learner has as many shards as the others");
        Self { actors, learners, shards }
    }

    /// All actors of one learner. Panics if there are none.
    pub fn of_one(actors: u32) -> Self {
        Self::new(actors, 1)
    }

    pub fn actors(self) -> u32 {
        self.actors
    }

    pub fn learners(self) -> u32 {
        self.learners
    }

    pub fn shards(self) -> u32 {
        self.shards
    }

    fn shards_of(self, rank: u32) -> Range<u32> {
        let each = self.shards / self.learners;
        rank * each..(rank + 1) * each
    }

    pub fn actors_in(self, shard: u32) -> Range<u32> {
        self.first_actor_in(shard)..self.first_actor_in(shard + 1)
    }

    pub fn actors_of(self, rank: u32) -> Range<u32> {
        let shards = self.shards_of(rank);
        self.first_actor_in(shards.start)..self.first_actor_in(shards.end)
    }

    /// The rank of the learner that serves this actor. Panics if there is no such actor.
    pub fn learner_of(self, actor: u32) -> u32 {
        (0..self.learners).find(|&rank| self.actors_of(rank).contains(&actor)).expect("the actor is one of the run's")
    }

    fn first_actor_in(self, shard: u32) -> u32 {
        let (each, more) = (self.actors / self.shards, self.actors % self.shards);
        shard * each + shard.min(more)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_actor_has_one_learner(actors in 1u32..200, learners in 1u32..20) {
            prop_assume!(learners <= actors);
            let shares = Shares::new(actors, learners);
            let all: Vec<u32> = (0..learners).flat_map(|rank| shares.actors_of(rank)).collect();
            prop_assert_eq!(all, (0..actors).collect::<Vec<_>>());
            for rank in 0..learners {
                let own = shares.actors_of(rank);
                prop_assert!(own.len() as u32 == actors / learners || own.len() as u32 == actors / learners + 1);
                prop_assert!(own.clone().all(|actor| shares.learner_of(actor) == rank));
            }
        }

        /// Whatever the number of learners, the shards are the same, and each learner has whole ones.
        #[test]
        fn shards_do_not_know_the_number_of_learners(actors in 1u32..200, shards in 0u32..7, learners in 0u32..7) {
            let [shards, learners] = [shards, learners].map(|exponent| 1 << exponent);
            prop_assume!(learners <= shards && shards <= actors);
            let shares = Shares::in_shards(actors, learners, shards);
            let alone = Shares::in_shards(actors, 1, shards);
            let of_all: Vec<u32> = (0..learners).flat_map(|rank| shares.shards_of(rank)).collect();
            prop_assert_eq!(of_all, (0..shards).collect::<Vec<_>>());
            for rank in 0..learners {
                let of_shards: Vec<u32> = shares.shards_of(rank).flat_map(|shard| alone.actors_in(shard)).collect();
                prop_assert_eq!(shares.actors_of(rank).collect::<Vec<_>>(), of_shards);
                prop_assert!(shares.actors_of(rank).all(|actor| shares.learner_of(actor) == rank));
            }
            for shard in 0..shards {
                let width = alone.actors_in(shard).len() as u32;
                prop_assert!(width == actors / shards || width == actors / shards + 1);
            }
        }
    }
}
