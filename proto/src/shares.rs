//! Which learner serves which actors.
//!
//! Each learner has consecutive actors. If the number does not divide evenly, the first learners have one more. So the
//! columns of all learners, in the order of ranks, are the columns that a single learner would have.

use std::ops::Range;

/// A run's actors, divided among its learners.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shares {
    actors: u32,
    learners: u32,
}

impl Shares {
    /// `actors` actors divided among `learners` learners.
    ///
    /// # Panics
    /// If a learner would have no actor.
    pub fn new(actors: u32, learners: u32) -> Self {
        assert!((1..=actors).contains(&learners), "every learner has actors");
        Self { actors, learners }
    }

    /// All actors of one learner.
    ///
    /// # Panics
    /// If there are none.
    pub fn of_one(actors: u32) -> Self {
        Self::new(actors, 1)
    }

    /// Actors in all.
    pub fn actors(self) -> u32 {
        self.actors
    }

    /// Learners.
    pub fn learners(self) -> u32 {
        self.learners
    }

    /// The actors of the learner with this rank.
    pub fn actors_of(self, rank: u32) -> Range<u32> {
        self.first_actor_of(rank)..self.first_actor_of(rank + 1)
    }

    /// The rank of the learner that serves this actor.
    ///
    /// # Panics
    /// If there is no such actor.
    pub fn learner_of(self, actor: u32) -> u32 {
        (0..self.learners).find(|&rank| self.actors_of(rank).contains(&actor)).expect("the actor is one of the run's")
    }

    fn first_actor_of(self, rank: u32) -> u32 {
        let (each, more) = (self.actors / self.learners, self.actors % self.learners);
        rank * each + rank.min(more)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn nineteen_actors_of_two_learners() {
        let shares = Shares::new(19, 2);
        assert_eq!([0, 1].map(|rank| shares.actors_of(rank)), [0..10, 10..19]);
    }

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
    }
}
