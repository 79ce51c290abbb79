//! Stratified sampling over a set of 29 kitchens: which kitchen has what, how many of it, and how large.
//!
//! If sixteen of thirty kitchens have a dining table, sixteen thirtieths of ours shall have one, not about as many as
//! independent coins give. So every question ("has it a table?", "how wide is it?") ranks the kitchens by a random
//! number of their own, and the answer follows from the rank. This is stratified sampling, and each kitchen can still
//! be generated alone.

use super::kitchen_key::{KitchenKey, SET};
use xxhash_rust::xxh3::xxh3_64;

/// The kitchen's place, from 0, among its set in a random order that belongs to `question`.
pub(super) fn rank(kitchen: KitchenKey, question: &str) -> usize {
    let question = xxh3_64(question.as_bytes()) as u32;
    let score = |kitchen: KitchenKey| (kitchen.place(question).stream().next_u32(), kitchen.id());
    let own = score(kitchen);
    kitchen.set().into_iter().filter(|&other| score(other) < own).count()
}

/// The kitchen's rank as a share in (0, 1).
pub(super) fn quantile(kitchen: KitchenKey, question: &str) -> f32 {
    (rank(kitchen, question) as f32 + 0.5) / kitchens()
}

/// The kitchen's rank as a share in 0..=1 of what is measured and not counted. One of the 29 lies at the middle of its
/// place, a procedural one anywhere in it: with all sets together every size occurs.
pub(super) fn measure(kitchen: KitchenKey, question: &str) -> f32 {
    let rank = rank(kitchen, question) as f32;
    if !kitchen.id().is_procedural() {
        return rank / (kitchens() - 1.0);
    }
    let within = kitchen.within(xxh3_64(question.as_bytes()) as u32).stream().uniform();
    (rank + within) / kitchens()
}

pub(super) fn among(kitchen: KitchenKey, question: &str, share: f32) -> bool {
    rank(kitchen, question) < holders(share)
}

/// How many a kitchen has, if a `share` of the kitchens has any and those have `mean` on average. Holders differ by
/// one at most.
pub(super) fn count(kitchen: KitchenKey, question: &str, share: f32, mean: f32) -> u32 {
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
    SET as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::kitchen::KitchenId;

    fn sets() -> Vec<Vec<KitchenKey>> {
        let set = |number| KitchenKey::new(KitchenId::new(number).unwrap(), 3).set();
        vec![set(1), set(1000), set(1029)]
    }

    #[test]
    fn ranks_are_an_order_and_questions_are_independent() {
        for set in sets() {
            let ranks = |question| set.iter().map(|&id| rank(id, question)).collect::<Vec<_>>();
            let (width, depth) = (ranks("width"), ranks("depth"));
            assert_ne!(width, depth);
            let mut sorted = width;
            sorted.sort_unstable();
            assert_eq!(sorted, (0..29).collect::<Vec<_>>());
        }
        let other_seed = KitchenKey::new(KitchenId::new(1000).unwrap(), 4).set();
        let ranks = |set: &[KitchenKey]| set.iter().map(|&id| rank(id, "width")).collect::<Vec<_>>();
        assert_ne!(ranks(&other_seed), ranks(&sets()[1]));
    }

    #[test]
    fn shares_and_means_are_met_over_each_set() {
        for set in sets() {
            let counts: Vec<u32> = set.iter().map(|&id| count(id, "Vase", 0.2, 2.67)).collect();
            assert_eq!(counts.iter().filter(|&&count| count > 0).count(), 6);
            assert_eq!(counts.iter().sum::<u32>(), 16);
            assert_eq!(set.iter().filter(|&&id| among(id, "Kettle", 0.5)).count(), 15);
            assert!(set.iter().all(|&id| (0.0..1.0).contains(&quantile(id, "width"))));
            let mut sizes: Vec<f32> = set.iter().map(|&id| measure(id, "width")).collect();
            sizes.sort_by(f32::total_cmp);
            let even = |(place, size): (usize, &f32)| (size * 29.0 - place as f32).abs() <= 1.05;
            assert!(sizes.iter().enumerate().all(even), "{sizes:?}");
        }
    }
}
