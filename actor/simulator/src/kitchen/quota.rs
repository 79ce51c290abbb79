//! Stratified sampling over the 29 kitchens: which kitchen has what, how many of it, and how large.
//!
//! If sixteen of thirty kitchens have a dining table, sixteen thirtieths of ours shall have one, not about as many as
//! independent coins give. So every question ("has it a table?", "how wide is it?") ranks the kitchens by a random
//! number of their own, and the answer follows from the rank. This is stratified sampling, and each kitchen can still
//! be generated alone.

use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use xxhash_rust::xxh3::xxh3_64;

/// Seed of everything that is drawn about kitchens.
pub(super) const SEED: u64 = 0;
/// Draws about the whole set have this episode number in their key; those within one kitchen have 0.
const WHOLE_SET: u32 = 1;

/// The kitchen's place, from 0, among all in a random order that belongs to `question`.
pub(super) fn rank(kitchen: KitchenId, question: &str) -> usize {
    let score = |kitchen: KitchenId| {
        let key = Key {
            seed: SEED,
            purpose: Purpose::Kitchen,
            kitchen: kitchen.number(),
            environment: xxh3_64(question.as_bytes()) as u32,
            episode: WHOLE_SET,
            step: 0,
        };
        (key.stream().next_u32(), kitchen)
    };
    let own = score(kitchen);
    KitchenId::all().filter(|&other| score(other) < own).count()
}

/// The kitchen's rank as a share in (0, 1).
pub(super) fn quantile(kitchen: KitchenId, question: &str) -> f32 {
    (rank(kitchen, question) as f32 + 0.5) / kitchens()
}

/// Whether the kitchen is among the `share` of kitchens that have it.
pub(super) fn among(kitchen: KitchenId, question: &str, share: f32) -> bool {
    rank(kitchen, question) < holders(share)
}

/// How many a kitchen has, if a `share` of the kitchens has any and those have `mean` on average. Holders differ by
/// one at most.
pub(super) fn count(kitchen: KitchenId, question: &str, share: f32, mean: f32) -> u32 {
    count_of_rank(rank(kitchen, question), share, mean)
}

/// As [`count`], for the kitchen with this place in an order of the caller's.
pub(super) fn count_of_rank(rank: usize, share: f32, mean: f32) -> u32 {
    let holders = holders(share);
    let whole = libm::floorf(mean);
    let with_one_more = libm::roundf((mean - whole) * holders as f32) as usize;
    match rank {
        _ if rank >= holders => 0,
        _ if rank < with_one_more => whole as u32 + 1,
        _ => whole as u32,
    }
}

/// How many kitchens a share is.
pub(super) fn holders(share: f32) -> usize {
    libm::roundf(share * kitchens()) as usize
}

fn kitchens() -> f32 {
    KitchenId::all().count() as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_an_order_and_questions_are_independent() {
        let ranks = |question| KitchenId::all().map(|id| rank(id, question)).collect::<Vec<_>>();
        let (width, depth) = (ranks("width"), ranks("depth"));
        assert_ne!(width, depth);
        let mut sorted = width;
        sorted.sort_unstable();
        assert_eq!(sorted, (0..29).collect::<Vec<_>>());
    }

    #[test]
    fn shares_and_means_are_met_over_the_set() {
        let counts: Vec<u32> = KitchenId::all().map(|id| count(id, "Vase", 0.2, 2.67)).collect();
        assert_eq!(counts.iter().filter(|&&count| count > 0).count(), 6);
        assert_eq!(counts.iter().sum::<u32>(), 16);
        assert_eq!(KitchenId::all().filter(|&id| among(id, "Kettle", 0.5)).count(), 15);
        assert!(KitchenId::all().all(|id| (0.0..1.0).contains(&quantile(id, "width"))));
    }
}
