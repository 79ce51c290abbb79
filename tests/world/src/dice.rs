//! All chance of a world: a function of its seed and of how much was drawn before.

use proto::random::{Key, Purpose, Random};

/// Draws from one stream before the next begins: streams are limited.
const DRAWS: u32 = 100_000;

/// A world's dice.
#[derive(Debug)]
pub struct Dice {
    key: Key,
    stream: Random,
    drawn: u32,
}

impl Dice {
    pub fn new(seed: u64) -> Self {
        let key = Key { seed, purpose: Purpose::Schedule, kitchen: 0, environment: 0, episode: 0, step: 0 };
        Self { key, stream: key.stream(), drawn: 0 }
    }

    /// Uniform in 0..n; n is not 0.
    pub fn below(&mut self, n: u32) -> u32 {
        self.drawn += 1;
        if self.drawn == DRAWS {
            self.drawn = 0;
            self.key.step += 1;
            self.stream = self.key.stream();
        }
        self.stream.below(n)
    }

    /// True once in `n` times.
    pub fn once_in(&mut self, n: u32) -> bool {
        self.below(n) == 0
    }

    /// Uniform in low..high.
    pub fn between(&mut self, low: u64, high: u64) -> u64 {
        low + u64::from(self.below((high - low) as u32))
    }

    /// Between `low` and about `high`, every power of two as likely as another.
    pub fn spread(&mut self, low: u64, high: u64) -> u64 {
        let octaves = (high / low).max(1).ilog2() + 1;
        let octave = low << self.below(octaves);
        octave + self.between(0, octave)
    }

    pub fn one_of<T: Copy>(&mut self, choice: &[T]) -> T {
        choice[self.below(choice.len() as u32) as usize]
    }
}
