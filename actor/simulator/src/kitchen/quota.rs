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
