//! Which column of the batch is which environment.

use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::{KitchenId, Kitchens};
use std::ops::Range;
use wire::message::Halves;

/// The environments of one learner, as columns: column n = a · E + e for actor a and its environment e.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColumnMap {
    first_actor: u32,
    actors: u32,
    environments_per_actor: u32,
    kitchens: Kitchens,
}

impl ColumnMap {
    /// The map of `actors` actors with `environments_per_actor` environments each. `first_actor` is the number in the
    /// whole run of this learner's first one. Panics if there would be no environment.
    pub fn new(first_actor: u32, actors: u32, environments_per_actor: u32) -> Self {
        assert!(actors > 0 && environments_per_actor > 0, "a learner has environments");
        Self { first_actor, actors, environments_per_actor, kitchens: Kitchens::TRAINING }
    }

    pub fn of(rank: u32, config: &Config) -> Self {
        let actors = config.shares().actors_of(rank);
        Self::new(actors.start, actors.len() as u32, config.actors.environments_per_actor)
            .in_kitchens(config.kitchens())
    }

    #[must_use]
    pub(crate) fn in_kitchens(self, kitchens: Kitchens) -> Self {
        Self { kitchens, ..self }
    }

    pub fn actors(self) -> u32 {
        self.actors
    }

    /// Columns: environments of this learner.
    pub fn columns(self) -> usize {
        self.actors as usize * self.environments_per_actor as usize
    }

    pub fn halves(self) -> u32 {
        Halves::of(self.environments_per_actor).count()
    }

    pub fn half(self, half: u32) -> Range<usize> {
        Halves::of(self.environments_per_actor).range(half)
    }

    pub fn actor(self, index: u32) -> u32 {
        self.first_actor + index
    }

    /// Which of this learner's actors the run's actor `actor` is; none if it is another learner's.
    pub(crate) fn index_of(self, actor: u32) -> Option<u32> {
        actor.checked_sub(self.first_actor).filter(|&index| index < self.actors)
    }

    pub(crate) fn columns_of(self, index: u32, half: u32) -> Range<usize> {
        let first = index as usize * self.environments_per_actor as usize;
        let range = self.half(half);
        first + range.start..first + range.end
    }

    pub(crate) fn columns_of_actor(self, index: u32) -> Range<usize> {
        let first = index as usize * self.environments_per_actor as usize;
        first..first + self.environments_per_actor as usize
    }

    /// Columns of a half over all actors, ascending: the order of its batch.
    pub fn batch(self, half: u32) -> impl Iterator<Item = usize> {
        (0..self.actors).flat_map(move |index| self.columns_of(index, half))
    }

    /// Actor, by its number in the whole run, and environment index of a column.
    pub fn place(self, column: usize) -> (u32, u32) {
        let each = self.environments_per_actor as usize;
        (self.actor((column / each) as u32), (column % each) as u32)
    }

    /// The kitchen of a column's environment; none where environments are not built in.
    pub(super) fn kitchen(self, column: usize) -> Option<KitchenId> {
        (self.kitchens != Kitchens::Elsewhere).then(|| self.environment(column).kitchen)
    }

    pub fn environment(self, column: usize) -> EnvironmentId {
        let (actor, index) = self.place(column);
        EnvironmentId::among(self.kitchens, actor, index, self.environments_per_actor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_batches_of_both_halves_are_all_columns_once() {
        for environments in 1..=5 {
            let map = ColumnMap::new(0, 3, environments);
            let mut columns: Vec<usize> = (0..map.halves()).flat_map(|half| map.batch(half)).collect();
            for half in 0..map.halves() {
                assert!(map.batch(half).collect::<Vec<_>>().is_sorted());
            }
            columns.sort_unstable();
            assert_eq!(columns, (0..map.columns()).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_second_learner_holds_other_environments() {
        let (first, second) = (ColumnMap::new(0, 19, 2), ColumnMap::new(19, 19, 2));
        assert_eq!(first.environment(3).kitchen, second.environment(3).kitchen);
        assert_ne!(first.environment(3), second.environment(3));
        assert_eq!(second.place(3), (20, 1));
        assert_eq!([18, 19, 37, 38].map(|actor| second.index_of(actor)), [None, Some(0), Some(18), None]);
    }
}
