//! The harness's dice: every throw follows from the seed and the case's number.

use proto::random::{Key, Purpose, Random};
use std::ops::RangeInclusive;

/// Draws for one case.
pub struct Draw(Random);

impl Draw {
    /// Of case `case` under `seed`.
    pub fn new(seed: u64, case: u32) -> Self {
        let purpose = Purpose::Chaos;
        Self(Key { seed, purpose, kitchen: 0, environment: 0, episode: case, step: 0 }.stream())
    }

    pub fn within(&mut self, range: RangeInclusive<u64>) -> u64 {
        let (low, high) = range.into_inner();
        low + u64::from(self.0.below((high - low + 1) as u32))
    }

    pub fn of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.0.below(choices.len() as u32) as usize]
    }

    /// One of these, each as often as its weight says.
    pub fn weighed<T: Copy>(&mut self, choices: &[(u32, T)]) -> T {
        let mut place = self.0.below(choices.iter().map(|(weight, _)| weight).sum());
        for &(weight, choice) in choices {
            if place < weight {
                return choice;
            }
            place -= weight;
        }
        unreachable!("the place is below the sum of the weights")
    }
}
