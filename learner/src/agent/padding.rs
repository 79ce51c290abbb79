//! Batches of one size, whoever is ready.
//!
//! What the network makes of a row depends, to the last bits, on how many rows go through it together, because other
//! numbers of rows have other kernels. On a GPU it did not depend on which they are or where the row stands among them,
//! wherever that was looked at: 10, 16, 19, 152 and 304 rows on H100s (`choosing.rs` has the test). So a batch that is
//! short of some rows gets others, of which nothing is kept, and the actors need not wait for each other.

use super::acting::parts_are_alike;
use super::step::{Batch, StepInput};
use crate::shards::Shards;
use proto::config::Config;

/// Rows of a batch, of every shard; none where they differ, so that batches are what they are.
pub(super) fn batch_rows(config: &Config, shards: &Shards) -> Option<usize> {
    let each = config.actors.environments_per_actor as usize;
    let [first, others @ ..] = shards.columns() else { return None };
    let alike = others.iter().all(|shard| shard.len() == first.len());
    let rows = match each {
        1 => Some(first.len()),
        _ => each.is_multiple_of(2).then_some(first.len() / 2),
    };
    rows.filter(|&rows| alike && parts_are_alike(rows))
}

/// A step of columns at these rows of the rollout, and the first column again until there are `count`.
pub(super) fn padded<'a>(input: &StepInput<'a>, rows: &[usize], count: usize) -> Batch<'a> {
    fn again<T: Clone>(values: &[T], count: usize) -> Vec<T> {
        let mut values = values.to_vec();
        if let Some(first) = values.first().cloned() {
            values.resize(count, first);
        }
        values
    }
    fn more<T: Copy>(rows: &[T], input: &StepInput, count: usize) -> Vec<T> {
        let first = &rows[..rows.len() / input.columns.len()];
        [rows, &first.repeat(count - input.columns.len())].concat()
    }
    let draws = input.gumbel.len() / input.columns.len();
    let mut gumbel = input.gumbel.to_vec();
    gumbel.resize(count * draws, 0.0);
    Batch {
        columns: again(input.columns, count),
        at: rows.to_vec(),
        frames: again(input.frames, count),
        // Kernels take batches without images alone.
        images: vec![],
        numbers: more(input.numbers, input, count),
        previous_action: again(input.previous_action, count),
        episode_start: again(input.episode_start, count),
        masks: more(input.masks, input, count),
        gumbel,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_are_of_one_size_where_halves_and_shards_are() {
        let rows = |actors, environments, shards, columns| {
            let mut config = Config::default();
            (config.actors.count, config.actors.environments_per_actor, config.learner.shards) =
                (actors, environments, shards);
            batch_rows(&config, &Shards::of(&config, &columns))
        };
        assert_eq!(rows(19, 16, 0, 0..304), Some(152));
        assert_eq!(rows(38, 16, 0, 304..608), Some(152));
        assert_eq!((rows(19, 1, 0, 0..19), rows(128, 1, 0, 0..128)), (Some(19), Some(128)));
        assert_eq!(rows(77, 1, 0, 0..77), None, "its parts differ");
        assert_eq!(rows(4, 3, 0, 0..12), None);
        assert_eq!((rows(8, 16, 4, 0..128), rows(8, 16, 4, 64..128)), (Some(16), Some(16)));
        assert_eq!(rows(5, 2, 4, 0..10), None);
    }
}
