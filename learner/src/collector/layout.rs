//! Which column of the batch is which environment.

use proto::episode::EnvironmentId;
use proto::kitchen::Kitchens;
use proto::message::Halves;
use std::ops::Range;

/// The environments of one learner, as columns: column n = a · E + e for actor a and its environment e.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    first_actor: u32,
    actors: u32,
    environments_per_actor: u32,
    kitchens: Kitchens,
}

impl Layout {
    /// The layout of `actors` actors with `environments_per_actor` environments each. `first_actor` is the number
    /// of this learner's actor 0 in the whole run: not 0 on the second machine.
    ///
    /// # Panics
    /// If there would be no environment.
    pub fn new(first_actor: u32, actors: u32, environments_per_actor: u32) -> Self {
        assert!(actors > 0 && environments_per_actor > 0, "a learner has environments");
        Self { first_actor, actors, environments_per_actor, kitchens: Kitchens::TRAINING }
    }

    /// The same in other kitchens than those of training.
    #[must_use]
    pub fn in_kitchens(self, kitchens: Kitchens) -> Self {
        Self { kitchens, ..self }
    }

    /// Actors of this learner.
    pub fn actors(self) -> u32 {
        self.actors
    }

    /// Columns: environments of this learner.
    pub fn columns(self) -> usize {
        self.actors as usize * self.environments_per_actor as usize
    }

    /// Halves that each actor's environments are divided into: 1 or 2.
    pub fn halves(self) -> u32 {
        Halves::of(self.environments_per_actor).count()
    }

    /// Environment indices of a half, the same for every actor.
    pub fn half(self, half: u32) -> Range<usize> {
        Halves::of(self.environments_per_actor).range(half)
    }

    /// Columns of one actor's half.
    pub fn columns_of(self, actor: u32, half: u32) -> Range<usize> {
        let first = actor as usize * self.environments_per_actor as usize;
        let range = self.half(half);
        first + range.start..first + range.end
    }

    /// Columns of all of an actor's environments.
    pub fn columns_of_actor(self, actor: u32) -> Range<usize> {
        let first = actor as usize * self.environments_per_actor as usize;
        first..first + self.environments_per_actor as usize
    }

    /// Columns of a half over all actors, ascending: the order of its batch.
    pub fn batch(self, half: u32) -> impl Iterator<Item = usize> {
        (0..self.actors).flat_map(move |actor| self.columns_of(actor, half))
    }

    /// Actor and environment index of a column.
    pub fn place(self, column: usize) -> (u32, u32) {
        let (actor, index) =
            (column / self.environments_per_actor as usize, column % self.environments_per_actor as usize);
        (actor as u32, index as u32)
    }

    /// The environment in a column, as randomness counts it.
    pub fn environment(self, column: usize) -> EnvironmentId {
        let (actor, index) = self.place(column);
        EnvironmentId::among(self.kitchens, self.first_actor + actor, index, self.environments_per_actor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_batches_of_both_halves_are_all_columns_once() {
        for environments in 1..=5 {
            let layout = Layout::new(0, 3, environments);
            let mut columns: Vec<usize> = (0..layout.halves()).flat_map(|half| layout.batch(half)).collect();
            for half in 0..layout.halves() {
                assert!(layout.batch(half).collect::<Vec<_>>().is_sorted());
            }
            columns.sort_unstable();
            assert_eq!(columns, (0..layout.columns()).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_second_machine_holds_other_environments() {
        let (first, second) = (Layout::new(0, 19, 2), Layout::new(19, 19, 2));
        assert_eq!(first.environment(3).kitchen, second.environment(3).kitchen);
        assert_ne!(first.environment(3), second.environment(3));
    }
}
