//! Drawn episodes of an evaluation: as training draws its own, but the same for every policy and every seed.

use super::fixed::category;
use crate::kitchen::Kitchen;
use crate::tasks::arm_point_nav::episode::Episode;
use proto::config::EpisodeConfig;
use proto::random::{Key, Purpose};

/// Seed of all drawn episodes. No run's seed: two policies are compared on the same ones.
const SEED: u64 = 0x4556_414c;

/// The kitchen's drawn episode with this number, within the distances of `config`: a pure function of these three. It
/// is made as training makes its own; like those, it satisfies what a fixed episode must, as the tests of a sample
/// show. Panics if the kitchen has no target of the episode's category.
pub fn drawn(kitchen: &Kitchen, config: &EpisodeConfig, episode: u32) -> Episode {
    let key = Key::episode(SEED, Purpose::EvaluationEpisode, kitchen.id(), 0, episode);
    Episode::about(kitchen, config, category(episode as usize), &mut key.stream())
}
