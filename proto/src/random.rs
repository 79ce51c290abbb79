//! Counter-based randomness: Philox4x32-10 (Salmon et al., *Parallel Random Numbers: As Easy as 1, 2, 3*, SC 2011).
//!
//! Every random draw in the system is a pure function of (run seed, purpose, kitchen, environment, episode, step),
//! so nothing depends on timing, on the order of processes, or on what was drawn before. There is no generator
//! state to save in a checkpoint.
//!
//! Written out here and not taken from a crate: it is thirty lines, and no later version may draw other numbers.

use crate::kitchen::KitchenId;

/// Bits of a step beside a kitchen's number beyond 255.
const STEP_BITS: u32 = 12;

/// What a draw is for. Two draws with different purposes are independent. The numbers are part of every key and stay as
/// they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Purpose {
    /// Layout and contents of a kitchen (seeded by the kitchen alone, not by the run).
    Kitchen = 1,
    /// Target, start, goal and robot pose of an episode.
    Episode = 2,
    /// Gumbel noise that turns logits into a sampled action.
    ActionNoise = 3,
    /// Initial weights; `environment` is the parameter's number, `episode` counts blocks of draws.
    Weights = 4,
    /// Which steps an auxiliary loss looks at; `environment` is the column, `episode` the rollout, `kitchen` the epoch.
    AuxiliarySubsample = 5,
    Recording = 7,
    /// Actions of random policies in benchmarks and checks.
    RandomPolicy = 8,
    /// Gumbel noise of an evaluation: `environment` is 0, `episode` the episode's number in its kitchen.
    Evaluation = 9,
    /// Drawn episodes of an evaluation, seeded by none: `environment` is 0, `episode` its number in its kitchen.
    EvaluationEpisode = 10,
    /// Which procedural kitchen an environment is in next: `environment` is its number over the whole run, `episode`
    /// counts its kitchens.
    KitchenVisit = 11,
    /// Which environments are in a minibatch together; `environment` is the column, `episode` the rollout.
    Minibatch = 12,
    /// The seed that an environment which is not built in begins an episode with.
    EpisodeSeed = 13,
    /// What a contrastive auxiliary loss shows as not seen; keyed as [`Purpose::AuxiliarySubsample`].
    AuxiliaryNegatives = 16,
    /// Resamples behind the intervals of a report; `environment` is the number of seeds, `episode` the resample.
    Bootstrap = 24,
    /// What happens when in the simulated world of the tests; `step` counts its streams.
    Schedule = 32,
    /// Which faults the chaos harness lets happen, and when; `episode` is the number of the case.
    Chaos = 33,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key {
    pub seed: u64,
    pub purpose: Purpose,
    /// Kitchen number, or 0 where none applies.
    pub kitchen: u32,
    /// Environment number within the kitchen, over the whole run.
    pub environment: u32,
    pub episode: u32,
    pub step: u32,
}

/// A short stream of random numbers for one [`Key`]: at most 262,140 words.
#[derive(Debug, Clone)]
pub struct Random {
    key: [u32; 2],
    counter: [u32; 4],
    block: [u32; 4],
    used: usize,
}

impl Key {
    pub fn episode(seed: u64, purpose: Purpose, kitchen: KitchenId, environment: u32, episode: u32) -> Self {
        Self { seed, purpose, kitchen: kitchen.number(), environment, episode, step: 0 }
    }

    /// The seed of an episode of an environment that is not built in: 31 bits, which every generator of seeds takes.
    pub fn episode_seed(run_seed: u64, environment: u32, episode: u32) -> u32 {
        let key = Self { seed: run_seed, purpose: Purpose::EpisodeSeed, kitchen: 0, environment, episode, step: 0 };
        key.stream().next_u32() >> 1
    }

    /// The stream of this key. Panics if the kitchen is beyond 255, as procedural ones are, and the step beyond 4095:
    /// the kitchen's higher bits take the step's place in the counter.
    pub fn stream(self) -> Random {
        let (low, high) = (self.kitchen & 0xff, self.kitchen >> 8);
        assert!(high < 1 << 20 && (high == 0 || self.step < 1 << STEP_BITS), "kitchen and step share a word");
        Random {
            key: [self.seed as u32, (self.seed >> 32) as u32],
            counter: [
                (self.purpose as u32) << 24 | low << 16,
                self.environment,
                self.episode,
                self.step | high << STEP_BITS,
            ],
            block: [0; 4],
            used: 4,
        }
    }
}

impl Random {
    pub fn next_u32(&mut self) -> u32 {
        if self.used == 4 {
            self.block = philox4x32_10(self.counter, self.key);
            assert!(self.counter[0] & 0xffff != 0xffff, "a random stream is limited to 262,140 words");
            self.counter[0] += 1;
            self.used = 0;
        }
        let word = self.block[self.used];
        self.used += 1;
        word
    }

    /// Uniform in [0, 1) with 24 bits.
    pub fn uniform(&mut self) -> f32 {
        (self.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in (0, 1), never an end point: safe under a logarithm.
    pub fn uniform_open(&mut self) -> f64 {
        (f64::from(self.next_u32()) + 0.5) * (1.0 / 4_294_967_296.0)
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in 0..n without bias (Lemire's multiplication method). Panics if `n` is 0.
    pub fn below(&mut self, n: u32) -> u32 {
        assert!(n > 0, "below(0) has no value to return");
        let threshold = n.wrapping_neg() % n;
        loop {
            let product = u64::from(self.next_u32()) * u64::from(n);
            if product as u32 >= threshold {
                return (product >> 32) as u32;
            }
        }
    }
}

fn philox4x32_10(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        let p0 = u64::from(counter[0]) * 0xD251_1F53;
        let p1 = u64::from(counter[2]) * 0xCD9E_8D57;
        counter =
            [(p1 >> 32) as u32 ^ counter[1] ^ key[0], p1 as u32, (p0 >> 32) as u32 ^ counter[3] ^ key[1], p0 as u32];
        key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
    }
    counter
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers published with Random123 (`kat_vectors`, philox4x32 10).
    #[test]
    fn matches_random123_known_answers() {
        assert_eq!(philox4x32_10([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox4x32_10([u32::MAX; 4], [u32::MAX; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
        assert_eq!(
            philox4x32_10([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }
}
