//! Which kitchen an environment plays each of its episodes in.
//!
//! In built-in kitchens and scenes an environment stays where it is. Procedural kitchens take turns: a pure function of
//! (seed, environment, episode), as everything random is, so that whoever comes back after a crash, or replays a
//! recording, finds the same kitchen.

use crate::episode::EnvironmentId;
use crate::evaluation::Plan;
use crate::kitchen::KitchenRange;
use crate::random::{Key, Purpose};

/// Which kitchen every environment of a run plays each of its episodes in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KitchenSchedule(Rule);

#[derive(Debug, Clone, PartialEq, Eq)]
enum Rule {
    Settled,
    /// After every so many episodes one of a range, drawn anew.
    Drawn {
        seed: u64,
        range: KitchenRange,
        episodes_each: u32,
    },
    Planned(Plan),
}

impl KitchenSchedule {
    pub(crate) fn settled() -> Self {
        Self(Rule::Settled)
    }

    /// Every environment plays `episodes_each` episodes in a kitchen of the range, then as many in another draw.
    pub(crate) fn drawn(seed: u64, range: KitchenRange, episodes_each: u32) -> Self {
        Self(Rule::Drawn { seed, range, episodes_each })
    }

    pub(crate) fn planned(plan: Plan) -> Self {
        Self(Rule::Planned(plan))
    }

    /// Whether environments go from kitchen to kitchen.
    pub fn moves(&self) -> bool {
        self.0 != Rule::Settled
    }

    /// An environment as it is called in its episode of this number: the kitchen that it is in then, and its number.
    /// `home` is what [`EnvironmentId::among`] calls it.
    pub fn place(&self, home: EnvironmentId, episode: u32) -> EnvironmentId {
        let kitchen = match &self.0 {
            Rule::Settled => home.kitchen,
            Rule::Drawn { seed, range, episodes_each } => {
                let key = Key {
                    seed: *seed,
                    purpose: Purpose::KitchenVisit,
                    kitchen: 0,
                    environment: home.number,
                    episode: episode / episodes_each,
                    step: 0,
                };
                range.get(key.stream().below(range.count())).unwrap_or(home.kitchen)
            }
            Rule::Planned(plan) => plan.kitchen_of(home, episode).unwrap_or(home.kitchen),
        };
        EnvironmentId { kitchen, ..home }
    }

    /// Where an environment goes on to after its episode of this number, if that is known to be another kitchen, and
    /// its first episode there.
    pub fn next_move(&self, home: EnvironmentId, episode: u32) -> Option<(u32, EnvironmentId)> {
        let now = self.place(home, episode);
        let later = match &self.0 {
            Rule::Settled => return None,
            Rule::Drawn { episodes_each, .. } => (episode / episodes_each + 1).checked_mul(*episodes_each)?,
            Rule::Planned(plan) => plan.next_kitchen(home, episode)?,
        };
        Some((later, self.place(home, later))).filter(|(_, next)| *next != now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, KitchenSource};
    use crate::kitchen::{KitchenId, Kitchens};
    use std::collections::{BTreeMap, BTreeSet};

    fn config(count: u32) -> Config {
        let mut config = Config::default();
        config.kitchens.source = KitchenSource::Procedural;
        config.kitchens.count = count;
        config.kitchens.episodes_each = 3;
        config.validate().unwrap();
        config
    }

    #[test]
    fn an_environment_changes_its_kitchen_after_so_many_episodes() {
        let config = config(100);
        let (kitchen_schedule, kitchens) = (config.kitchen_schedule(), config.kitchens());
        let mut visits: BTreeMap<KitchenId, u32> = BTreeMap::new();
        for actor in 0..20 {
            for index in 0..4 {
                let home = EnvironmentId::among(kitchens, actor, index, 4);
                let kitchen = |episode| kitchen_schedule.place(home, episode).kitchen;
                for visit in 0..50 {
                    let first = kitchen(3 * visit);
                    assert!((1..3).all(|more| kitchen(3 * visit + more) == first));
                    *visits.entry(first).or_default() += 1;
                    let next = kitchen(3 * visit + 3);
                    let expected = (next != first).then_some((3 * visit + 3, next));
                    assert_eq!(
                        kitchen_schedule.next_move(home, 3 * visit + 1).map(|(then, place)| (then, place.kitchen)),
                        expected
                    );
                }
                assert_eq!(kitchen_schedule.place(home, 7).number, 4 * actor + index);
            }
        }
        // 4,000 visits to 100 kitchens: each about as often.
        assert_eq!(visits.len(), 100);
        assert!(visits.keys().all(|kitchen| (1000..1100).contains(&kitchen.number())));
        assert!(visits.values().all(|count| (15..=75).contains(count)), "{visits:?}");
    }

    #[test]
    fn seeds_and_environments_go_different_ways() {
        let first = |seed, number| {
            let kitchen_schedule = Config { seed, ..config(1000) }.kitchen_schedule();
            let kitchens = Kitchens::Procedural(KitchenRange::first(1000).unwrap());
            let home = EnvironmentId { number, ..EnvironmentId::among(kitchens, 0, 0, 1) };
            (0..5).map(|visit| kitchen_schedule.place(home, 3 * visit).kitchen).collect::<Vec<_>>()
        };
        let ways: BTreeSet<_> = [first(1, 0), first(1, 1), first(2, 0), first(2, 1)].into();
        assert_eq!(ways.len(), 4);
    }

    #[test]
    fn in_the_training_kitchens_nobody_moves() {
        let kitchen_schedule = Config::default().kitchen_schedule();
        let home = EnvironmentId::of(3, 0, 1);
        assert!(!kitchen_schedule.moves() && kitchen_schedule.next_move(home, 0).is_none());
        assert!((0..200).all(|episode| kitchen_schedule.place(home, episode) == home));
    }
}
