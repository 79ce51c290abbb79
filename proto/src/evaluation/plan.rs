//! Which environment runs which episode. The assignment is made beforehand, so that results do not depend on timing.

use super::asked::{EvaluationConfig, ObjectSet, SEEDED_EPISODES};
use super::distribution::Distribution;
use crate::episode::EnvironmentId;
use crate::kitchen::{KitchenId, TargetCategory};
use std::ops::Range;

/// Episodes of one object set in one kitchen.
pub const EPISODES_OF_SET: u32 = EPISODES_PER_KITCHEN / 2;
/// Episodes of one category in one kitchen, fixed or drawn.
const EPISODES_PER_CATEGORY: u32 = 60;
pub const EPISODES_PER_KITCHEN: u32 = EPISODES_PER_CATEGORY * TargetCategory::ALL.len() as u32;

/// Category of the episode with this number in its kitchen.
pub fn category_of(episode: u32) -> TargetCategory {
    TargetCategory::ALL[episode as usize % TargetCategory::ALL.len()]
}

/// The episodes of an evaluation and the environments that play them.
///
/// Every kitchen of a split plays the same episode numbers, a scene those of the targets that it has. Its environments,
/// numbered as [`EnvironmentId::number`], take turns: environment n of N plays the list's entries n, n + N, n + 2N, ...
/// as its episodes 0, 1, 2, ...; one that has run out holds.
///
/// Environments that are not built in have one list, as those of one kitchen do.
///
/// Procedural kitchens are dealt with their episodes: of the list of all episodes, by kitchen and number, each
/// environment plays a part of its own, as long as the others' but for one, so that it changes its kitchen seldom.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    kitchens: Vec<(KitchenId, Vec<u32>)>,
    actors: u32,
    environments_per_actor: u32,
    /// Environments go from kitchen to kitchen.
    moving: bool,
}

impl Plan {
    /// Deals an evaluation's episodes to `actors` actors of `environments_per_actor` environments.
    pub fn new(config: &EvaluationConfig, actors: u32, environments_per_actor: u32) -> Self {
        let of_set = |objects: ObjectSet, targets: &[TargetCategory]| -> Vec<u32> {
            let here = |&episode: &u32| {
                let category = category_of(episode);
                objects == ObjectSet::NoTargets || objects.contains(category) && targets.contains(&category)
            };
            let limit = if config.episodes == 0 { usize::MAX } else { config.episodes as usize };
            (0..EPISODES_PER_KITCHEN).filter(here).take(limit).collect()
        };
        let in_kitchen = |targets: &[TargetCategory]| {
            let mut episodes = match config.objects {
                ObjectSet::All => [ObjectSet::Novel, ObjectSet::Seen].map(|objects| of_set(objects, targets)).concat(),
                one => of_set(one, targets),
            };
            episodes.sort_unstable();
            episodes
        };
        let targets = |kitchen: KitchenId| match kitchen.scene_index() {
            Some(index) => config.scene_targets.get(index).map_or(&[][..], Vec::as_slice),
            None => &TargetCategory::ALL,
        };
        let episodes = |kitchen| match (config.distribution, config.episodes) {
            (Distribution::Seeds, 0) => (0..SEEDED_EPISODES).collect(),
            (Distribution::Seeds, episodes) => (0..episodes).collect(),
            _ => in_kitchen(targets(kitchen)),
        };
        let kitchens = config.kitchens().ids().into_iter().map(|kitchen| (kitchen, episodes(kitchen)));
        Self { kitchens: kitchens.collect(), actors, environments_per_actor, moving: config.procedural.is_some() }
    }

    /// Episodes in one kitchen, ascending; none of a kitchen that is not played in.
    pub fn episodes_in(&self, kitchen: KitchenId) -> &[u32] {
        self.kitchens.iter().find(|(id, _)| *id == kitchen).map_or(&[], |(_, episodes)| episodes)
    }

    /// The most that one kitchen has.
    pub fn longest(&self) -> usize {
        self.kitchens.iter().map(|(_, episodes)| episodes.len()).max().unwrap_or(0)
    }

    /// Every episode in the order of the table: by kitchen, then by number.
    pub fn episodes(&self) -> impl Iterator<Item = (KitchenId, u32)> {
        self.kitchens.iter().flat_map(|(kitchen, episodes)| episodes.iter().map(|&episode| (*kitchen, episode)))
    }

    pub fn len(&self) -> usize {
        self.kitchens.iter().map(|(_, episodes)| episodes.len()).sum()
    }

    /// Episodes of each kitchen, where all have equally many: where environments move.
    fn episodes_each(&self) -> usize {
        self.kitchens.first().map_or(0, |(_, episodes)| episodes.len())
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number, in its kitchen, of the episode that an environment plays as its episode number `number`; none when it
    /// has run out.
    pub fn dealt(&self, environment: EnvironmentId, number: u32) -> Option<u32> {
        if self.moving {
            return self.dealt_on_the_way(environment.number, number).map(|(_, episode)| episode);
        }
        let place = self.kitchens.iter().position(|(kitchen, _)| *kitchen == environment.kitchen)?;
        let episodes = &self.kitchens[place].1;
        // Actors take kitchens in turn: this many have this one.
        let kitchens = self.kitchens.len() as u32;
        let actors = self.actors / kitchens + u32::from((place as u32) < self.actors % kitchens);
        let environments = u64::from(actors) * u64::from(self.environments_per_actor);
        let index = u64::from(environment.number) + u64::from(number) * environments;
        episodes.get(usize::try_from(index).ok()?).copied()
    }

    /// Which kitchen an environment is in for its episode number `number`: its own, or where it moves that of the
    /// episode dealt, when it has run out that of its last one. None of an environment that plays nothing at all.
    pub fn kitchen_of(&self, environment: EnvironmentId, number: u32) -> Option<KitchenId> {
        if !self.moving {
            return Some(environment.kitchen);
        }
        let part = self.part(environment.number);
        let last = part.end.checked_sub(1).filter(|last| *last >= part.start)?;
        let index = part.start.saturating_add(number as usize).min(last);
        self.entry(index).map(|(kitchen, _)| kitchen)
    }

    /// The first number after `number` that an environment plays in another kitchen than that one.
    pub(crate) fn next_kitchen(&self, environment: EnvironmentId, number: u32) -> Option<u32> {
        if !self.moving {
            return None;
        }
        let (part, each) = (self.part(environment.number), self.episodes_each().max(1));
        let next = (part.start.checked_add(number as usize)? / each + 1) * each;
        (next < part.end).then(|| (next - part.start) as u32)
    }

    /// Kitchen and number of the episode that a moving environment plays as its episode number `number`.
    fn dealt_on_the_way(&self, environment: u32, number: u32) -> Option<(KitchenId, u32)> {
        let part = self.part(environment);
        let index = part.start.checked_add(number as usize).filter(|index| part.contains(index))?;
        self.entry(index)
    }

    /// The part of all episodes that a moving environment plays.
    fn part(&self, environment: u32) -> Range<usize> {
        let all = (self.kitchens.len() * self.episodes_each()) as u64;
        let environments = u64::from(self.actors) * u64::from(self.environments_per_actor);
        let bound = |environment: u64| (environment.min(environments) * all / environments.max(1)) as usize;
        bound(environment.into())..bound(u64::from(environment) + 1)
    }

    /// An entry of the list of all episodes, where kitchens have equally many.
    fn entry(&self, index: usize) -> Option<(KitchenId, u32)> {
        let each = self.episodes_each().max(1);
        let (kitchen, episodes) = self.kitchens.get(index / each)?;
        Some((*kitchen, *episodes.get(index % each)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kitchen::{Kitchens, Split};
    use proptest::prelude::*;
    use std::collections::{BTreeMap, BTreeSet};

    fn config(objects: ObjectSet, episodes: u32) -> EvaluationConfig {
        EvaluationConfig::fixed(Split::Test, objects, episodes)
    }

    #[test]
    fn a_scene_plays_the_targets_that_it_has() {
        let scene_targets = vec![vec![TargetCategory::Mug, TargetCategory::Cup], vec![], vec![TargetCategory::Apple]];
        let of = |objects, episodes| {
            let config = config(objects, episodes);
            let config = EvaluationConfig { split: Split::Train, scene_targets: scene_targets.clone(), ..config };
            Plan::new(&config, 3, 2)
        };
        let scene = |index| KitchenId::scene(index).unwrap();
        let plan = of(ObjectSet::All, 0);
        assert_eq!((plan.len(), plan.longest()), (3 * 60, 120));
        assert_eq!(
            (plan.episodes_in(scene(0))[..4].to_vec(), plan.episodes_in(scene(1)).len()),
            (vec![5, 11, 17, 23], 0)
        );
        assert!(plan.episodes_in(scene(2)).iter().all(|&episode| category_of(episode) == TargetCategory::Apple));
        let environment = |index, number| EnvironmentId { kitchen: scene(index), number };
        assert_eq!((plan.dealt(environment(0, 1), 1), plan.dealt(environment(1, 0), 0)), (Some(23), None));
        // The first two of each object set, of those that are there.
        assert_eq!(of(ObjectSet::All, 2).episodes_in(scene(0)), [5, 11, 17, 23]);
        assert_eq!((of(ObjectSet::Novel, 0).len(), of(ObjectSet::Seen, 3).len()), (60, 6));
    }

    #[test]
    fn the_splits_have_the_papers_numbers_of_episodes() {
        for (objects, count) in
            [(ObjectSet::Novel, 360), (ObjectSet::Seen, 360), (ObjectSet::All, 720), (ObjectSet::NoTargets, 720)]
        {
            assert_eq!(Plan::new(&config(objects, 0), 5, 1).len(), 5 * count);
        }
        let first: Vec<u32> = (0..7).collect();
        let plan = Plan::new(&config(ObjectSet::NoTargets, 7), 5, 1);
        assert_eq!(plan.episodes_in(KitchenId::new(2).unwrap()), first);
        // The first 12 of the novel ones have each category twice.
        let plan = Plan::new(&config(ObjectSet::Novel, 12), 5, 1);
        let mut categories: BTreeMap<TargetCategory, u32> = BTreeMap::new();
        for (_, episode) in plan.episodes() {
            *categories.entry(category_of(episode)).or_default() += 1;
        }
        assert_eq!(categories.len(), 6);
        assert!(categories.values().all(|&count| count == 2 * 5));
    }

    #[test]
    fn procedural_kitchens_are_dealt_with_their_episodes() {
        for (actors, environments) in [(1, 1), (2, 3), (5, 8), (40, 32)] {
            let procedural = Some("1000..1007".parse().unwrap());
            let config = EvaluationConfig {
                split: Split::Train,
                procedural,
                distribution: Distribution::Run,
                ..config(ObjectSet::All, 12)
            };
            let plan = Plan::new(&config, actors, environments);
            let mut dealt = BTreeSet::new();
            let mut lengths = BTreeSet::new();
            for actor in 0..actors {
                for index in 0..environments {
                    let home = EnvironmentId::among(config.kitchens(), actor, index, environments);
                    let (mut number, mut changes) = (0, 0);
                    while let Some(episode) = plan.dealt(home, number) {
                        let kitchen = plan.kitchen_of(home, number).unwrap();
                        assert!(dealt.insert((kitchen, episode)));
                        let other = (number + 1..=number + plan.len() as u32)
                            .take_while(|&later| plan.dealt(home, later).is_some())
                            .find(|&later| plan.kitchen_of(home, later) != Some(kitchen));
                        assert_eq!(plan.next_kitchen(home, number), other);
                        changes += u32::from(plan.kitchen_of(home, number + 1) != Some(kitchen));
                        number += 1;
                    }
                    lengths.insert(number);
                    assert!(changes <= number / 24 + 1, "{changes} changes in {number} episodes");
                    // One that has run out stays in its last kitchen.
                    assert_eq!(plan.kitchen_of(home, number), plan.kitchen_of(home, number.saturating_sub(1)));
                }
            }
            assert_eq!(dealt.into_iter().collect::<Vec<_>>(), plan.episodes().collect::<Vec<_>>());
            assert!(lengths.len() <= 2, "{lengths:?}");
        }
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
                    while let Some(episode) = plan.dealt(id, number) {
                        prop_assert!(dealt.insert((id.kitchen, episode)));
                        number += 1;
                    }
                    prop_assert_eq!(plan.dealt(id, number + 1), None);
                }
            }
            prop_assert_eq!(dealt.into_iter().collect::<Vec<_>>(), plan.episodes().collect::<Vec<_>>());
        }
    }
}
