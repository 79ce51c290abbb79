//! How long an episode can be, and which environment is which: the mapping from process-local indices to the
//! coordinates that randomness counts by.

use crate::kitchen::{KitchenId, Kitchens};
use serde::{Deserialize, Serialize};

/// Longest episode a configuration may ask for, steps.
pub const MAX_EPISODE_STEPS: usize = 100_000;

/// One environment of the run, named independently of how actors are spread over machines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct EnvironmentId {
    pub kitchen: KitchenId,
    /// Its number among the environments of that kitchen, over the whole run.
    pub number: u32,
}

impl EnvironmentId {
    /// The environment that actor `actor` holds at `index` in a run in the training kitchens.
    pub fn of(actor: u32, index: u32, environments_per_actor: u32) -> Self {
        Self::among(Kitchens::TRAINING, actor, index, environments_per_actor)
    }

    /// The environment that actor `actor` holds at `index` in a run in these kitchens.
    ///
    /// Actors beyond the kitchens repeat them; their environments continue the numbering. Where every environment has
    /// procedural kitchens of its own, it is called by the first of them all, and its number counts all environments of
    /// the run; `KitchenSchedule` tells which kitchen it is in.
    pub fn among(kitchens: Kitchens, actor: u32, index: u32, environments_per_actor: u32) -> Self {
        match kitchens {
            Kitchens::Procedural(range) => {
                Self { kitchen: range.first_id(), number: actor * environments_per_actor + index }
            }
            Kitchens::Split(_) | Kitchens::One(_) | Kitchens::Scenes(_) | Kitchens::Elsewhere => {
                let ids = kitchens.ids();
                let count = ids.len() as u32;
                let kitchen = ids[(actor % count) as usize];
                Self { kitchen, number: actor / count * environments_per_actor + index }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn environments_are_unique_over_repeated_kitchens() {
        let all: HashSet<_> =
            (0..60).flat_map(|actor| (0..4).map(move |index| EnvironmentId::of(actor, index, 4))).collect();
        assert_eq!(all.len(), 240);
        let all: HashSet<_> = (0..7)
            .flat_map(|actor| (0..4).map(move |index| EnvironmentId::among(Kitchens::Scenes(3), actor, index, 4)))
            .collect();
        assert_eq!(all.len(), 28);
        assert!(all.contains(&EnvironmentId { kitchen: KitchenId::scene(0).unwrap(), number: 11 }));
    }
}
