//! Which host has which learners and actors, where a run has several hosts.
//!
//! What a run computes knows no hosts: `learner.count` and `actors.count` are totals. Each host has consecutive ranks,
//! divided as learners divide actors, and the actors that those ranks serve. Frames stay on their host.

use crate::shares::Shares;
use std::ops::Range;

/// The variable in which a learner finds what keys in the learners' store begin with, set by the orchestrator: other users
/// cannot read it, as they can a command line.
pub const MEETING_KEY: &str = "STILLROOM_MEETING_KEY";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hosts {
    hosts: u32,
    shares: Shares,
}

impl Hosts {
    /// The learners and actors of `shares` divided among `hosts` hosts. Panics if a host would have no learner.
    pub fn new(hosts: u32, shares: Shares) -> Self {
        assert!((1..=shares.learners()).contains(&hosts), "every host has learners");
        Self { hosts, shares }
    }

    pub fn of_one(shares: Shares) -> Self {
        Self::new(1, shares)
    }

    pub fn count(self) -> u32 {
        self.hosts
    }

    /// The ranks of a host's learners. Panics if there is no such host.
    pub fn ranks_of(self, host: u32) -> Range<u32> {
        assert!(host < self.hosts, "the host is one of the run's");
        // Hosts divide learners as learners divide actors.
        Shares::new(self.shares.learners(), self.hosts).actors_of(host)
    }

    /// The actors of a host. Panics if there is no such host.
    pub fn actors_of(self, host: u32) -> Range<u32> {
        let ranks = self.ranks_of(host);
        self.shares.actors_of(ranks.start).start..self.shares.actors_of(ranks.end - 1).end
    }

    /// The host of the learner with this rank. Panics if there is no such learner.
    pub fn of_learner(self, rank: u32) -> u32 {
        (0..self.hosts).find(|&host| self.ranks_of(host).contains(&rank)).expect("the learner is one of the run's")
    }

    /// The host of an actor. Panics if there is no such actor.
    pub fn of_actor(self, actor: u32) -> u32 {
        self.of_learner(self.shares.learner_of(actor))
    }

    /// Whether this learner is the first of its host: it speaks for that host's recording. Panics if there is no such
    /// learner.
    pub fn leads(self, rank: u32) -> bool {
        self.ranks_of(self.of_learner(rank)).start == rank
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_process_has_one_host_and_each_host_its_learners_actors(
            actors in 1u32..100, learners in 1u32..20, count in 1u32..20,
        ) {
            prop_assume!(count <= learners && learners <= actors);
            let shares = Shares::new(actors, learners);
            let hosts = Hosts::new(count, shares);
            let ranks: Vec<u32> = (0..count).flat_map(|host| hosts.ranks_of(host)).collect();
            prop_assert_eq!(ranks, (0..learners).collect::<Vec<_>>());
            let all: Vec<u32> = (0..count).flat_map(|host| hosts.actors_of(host)).collect();
            prop_assert_eq!(all, (0..actors).collect::<Vec<_>>());
            for actor in 0..actors {
                prop_assert_eq!(hosts.of_actor(actor), hosts.of_learner(shares.learner_of(actor)));
            }
            prop_assert_eq!((0..learners).filter(|&rank| hosts.leads(rank)).count() as u32, count);
        }
    }
}
