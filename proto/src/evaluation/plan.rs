//! Which fixed episode is played where: dealt out beforehand, so that no result depends on who is faster.

use super::{EvaluationConfig, ObjectSet};
use crate::episode::EnvironmentId;
use crate::kitchen::{KitchenId, TargetCategory};

/// Fixed episodes of one category in one kitchen.
pub const EPISODES_PER_CATEGORY: u32 = 60;
/// Fixed episodes in one kitchen.
pub const EPISODES_PER_KITCHEN: u32 = EPISODES_PER_CATEGORY * TargetCategory::ALL.len() as u32;

/// Category of the fixed episode with this number.
pub fn category_of(episode: u32) -> TargetCategory {
    TargetCategory::ALL[episode as usize % TargetCategory::ALL.len()]
}

/// The episodes of an evaluation and the environments that play them.
///
/// Every kitchen of the split plays the same episode numbers. Its environments, numbered as
/// [`EnvironmentId::number`], take turns: environment n of N plays the list's entries n, n + N, n + 2N, ... as its
/// episodes 0, 1, 2, ...; one that has run out holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    kitchens: Vec<KitchenId>,
    episodes: Vec<u32>,
    actors: u32,
    environments_per_actor: u32,
}

impl Plan {
    /// Deals an evaluation's episodes to `actors` actors of `environments_per_actor` environments.
    pub fn new(config: &EvaluationConfig, actors: u32, environments_per_actor: u32) -> Self {
        let of_set = |objects: ObjectSet| {
            let chosen = (0..EPISODES_PER_KITCHEN).filter(move |&episode| objects.contains(category_of(episode)));
            chosen.take(if config.episodes == 0 { usize::MAX } else { config.episodes as usize })
        };
        let mut episodes: Vec<u32> = match config.objects {
            ObjectSet::All => of_set(ObjectSet::Novel).chain(of_set(ObjectSet::Seen)).collect(),
            one => of_set(one).collect(),
        };
        episodes.sort_unstable();
        Self { kitchens: KitchenId::of_split(config.split), episodes, actors, environments_per_actor }
    }

    /// Kitchens, ascending.
    pub fn kitchens(&self) -> &[KitchenId] {
        &self.kitchens
    }

    /// Every episode in the order of the table: by kitchen, then by number.
    pub fn episodes(&self) -> impl Iterator<Item = (KitchenId, u32)> {
        self.kitchens.iter().flat_map(|&kitchen| self.episodes.iter().map(move |&episode| (kitchen, episode)))
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.kitchens.len() * self.episodes.len()
    }

    /// True when nothing is asked.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The fixed episode that an environment plays as its episode number `number`; none when it has run out.
    pub fn fixed(&self, environment: EnvironmentId, number: u32) -> Option<u32> {
        let place = self.kitchens.iter().position(|&kitchen| kitchen == environment.kitchen)? as u32;
        // Actors take kitchens in turn: this many have this one.
        let kitchens = self.kitchens.len() as u32;
        let actors = self.actors / kitchens + u32::from(place < self.actors % kitchens);
        let environments = u64::from(actors) * u64::from(self.environments_per_actor);
        let index = u64::from(environment.number) + u64::from(number) * environments;
        self.episodes.get(usize::try_from(index).ok()?).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kitchen::{Kitchens, Split};
    use proptest::prelude::*;
    use std::collections::{BTreeMap, BTreeSet};

    fn config(objects: ObjectSet, episodes: u32) -> EvaluationConfig {
        EvaluationConfig { split: Split::Test, objects, episodes, deterministic: false, checkpoint: None }
    }

    #[test]
    fn the_splits_have_the_papers_numbers_of_episodes() {
        for (objects, count) in [(ObjectSet::Novel, 360), (ObjectSet::Seen, 360), (ObjectSet::All, 720)] {
            assert_eq!(Plan::new(&config(objects, 0), 5, 1).len(), 5 * count);
        }
        // The first 12 of the novel ones have each category twice.
        let plan = Plan::new(&config(ObjectSet::Novel, 12), 5, 1);
        let mut categories: BTreeMap<TargetCategory, u32> = BTreeMap::new();
        for (_, episode) in plan.episodes() {
            *categories.entry(category_of(episode)).or_default() += 1;
        }
        assert_eq!(categories.len(), 6);
        assert!(categories.values().all(|&count| count == 2 * 5));
    }

    proptest! {
        /// Whatever the numbers of actors and environments: every episode is played exactly once, by an environment
        /// of its kitchen, and no environment plays on after a gap.
        #[test]
        fn every_episode_is_dealt_once(actors in 5u32..17, environments in 1u32..9, episodes in 0u32..30, all: bool) {
            let objects = if all { ObjectSet::All } else { ObjectSet::Seen };
            let plan = Plan::new(&config(objects, episodes), actors, environments);
            let mut dealt = BTreeSet::new();
            for actor in 0..actors {
                for index in 0..environments {
                    let id = EnvironmentId::among(Kitchens::Split(Split::Test), actor, index, environments);
                    let mut number = 0;
                    while let Some(episode) = plan.fixed(id, number) {
                        prop_assert!(dealt.insert((id.kitchen, episode)));
                        number += 1;
                    }
                    prop_assert_eq!(plan.fixed(id, number + 1), None);
                }
            }
            prop_assert_eq!(dealt.into_iter().collect::<Vec<_>>(), plan.episodes().collect::<Vec<_>>());
        }
    }
}
