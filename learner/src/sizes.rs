//! Which passes of training are recorded as CUDA graphs: those over as many frames as come update after update.
//!
//! An update has several epochs with passes of the same few sizes, so how often a size comes says little; in how many
//! updates it comes says whether it will come again. That of a stage's last, cut rollout does not, and with
//! `ppo.preemption_share` nearly every rollout that is ended early has one of its own.

use std::collections::BTreeMap;

/// Sizes that are recorded at a time; others go kernel by kernel. Minibatches of one shard have one of two.
const MOST_RECORDED: usize = 4;
// One is dropped when another one comes, and libtorch takes no shared memory of which no graph is left.
const _: () = assert!(MOST_RECORDED > 1);
/// Updates for which a size is remembered.
const REMEMBERED: u64 = 8;

#[derive(Debug, Default)]
pub(crate) struct Sizes {
    /// What the caller calls the present update; none before the first.
    name: Option<u64>,
    /// Updates that have begun.
    updates: u64,
    /// Passes that have come.
    passes: u64,
    /// By number of frames.
    known: BTreeMap<i64, Size>,
}

#[derive(Debug, Clone, Copy)]
struct Size {
    /// The last pass, and the update that it was of.
    pass: u64,
    update: u64,
    is_recorded: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Due {
    /// The size whose recording is dropped before.
    pub in_place_of: Option<i64>,
}

impl Sizes {
    /// Counts a pass over as many frames. `update` tells updates apart. What is due counts as recorded.
    pub(crate) fn count(&mut self, frames: i64, update: u64) -> Option<Due> {
        if self.name.replace(update) != Some(update) {
            self.updates += 1;
            let oldest = self.updates.saturating_sub(REMEMBERED);
            self.known.retain(|_, size| size.is_recorded || size.update >= oldest);
        }
        self.passes += 1;
        let before = self.known.get(&frames).copied();
        let comes_again = before.is_some_and(|size| !size.is_recorded && size.update < self.updates);
        let due = if comes_again { self.room() } else { None };
        if let Some(dropped) = due.and_then(|due| due.in_place_of).and_then(|frames| self.known.get_mut(&frames)) {
            dropped.is_recorded = false;
        }
        let is_recorded = due.is_some() || before.is_some_and(|size| size.is_recorded);
        self.known.insert(frames, Size { pass: self.passes, update: self.updates, is_recorded });
        due
    }

    /// Room for another recording: that of the one used longest ago if it has come neither in this update nor in the
    /// last one. More sizes than there is room for, in each update, would otherwise drop one another for ever.
    fn room(&self) -> Option<Due> {
        let recorded = || self.known.iter().filter(|(_, size)| size.is_recorded);
        if recorded().count() < MOST_RECORDED {
            return Some(Due { in_place_of: None });
        }
        let (&frames, oldest) = recorded().min_by_key(|(_, size)| size.pass)?;
        (oldest.update + 1 < self.updates).then_some(Due { in_place_of: Some(frames) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    const EPOCHS: usize = 4;

    /// Counts an update's passes: those of its minibatches in each epoch. What was recorded, with what was dropped.
    fn update(sizes: &mut Sizes, number: u64, minibatches: &[i64]) -> Vec<(i64, Option<i64>)> {
        let passes = minibatches.repeat(EPOCHS);
        let due = passes.into_iter().map(|frames| (frames, sizes.count(frames, number)));
        due.filter_map(|(frames, due)| Some((frames, due?.in_place_of))).collect()
    }

    #[test]
    fn a_size_is_recorded_in_its_second_update_however_many_passes_one_has() {
        for minibatches in [vec![3800], vec![1216; 16], vec![950, 950, 949, 949], vec![38, 19]] {
            let mut sizes = Sizes::default();
            assert_eq!(update(&mut sizes, 7, &minibatches), [], "{minibatches:?}: once");
            let recorded = update(&mut sizes, 8, &minibatches);
            let expected: BTreeSet<_> = minibatches.iter().map(|&frames| (frames, None)).collect();
            assert_eq!(recorded.len(), expected.len(), "each once");
            assert_eq!(recorded.into_iter().collect::<BTreeSet<_>>(), expected);
            for number in 9..100 {
                assert_eq!(update(&mut sizes, number, &minibatches), [], "{minibatches:?}");
            }
        }
    }

    /// As `Update::run` makes one again where a gradient was not finite; numbers that go back are of other updates.
    #[test]
    fn an_update_that_is_made_again_is_one() {
        for (numbers, expected) in
            [([0, 0, 1], [vec![], vec![], vec![(38, None)]]), ([9, 3, 4], [vec![], vec![(38, None)], vec![]])]
        {
            let mut sizes = Sizes::default();
            assert_eq!(numbers.map(|number| update(&mut sizes, number, &[38])), expected, "{numbers:?}");
        }
    }

    #[test]
    fn a_stages_cut_rollout_is_not_recorded_and_drops_nothing() {
        let mut sizes = Sizes::default();
        let mut recorded = vec![];
        for number in 0..300 {
            let cut = number % 100 == 99;
            recorded.extend(update(&mut sizes, number, if cut { &[700, 699] } else { &[3800, 3799] }));
        }
        assert_eq!(recorded, [(3800, None), (3799, None)]);
    }

    #[test]
    fn a_new_stages_sizes_take_the_places_of_those_that_come_no_more() {
        let mut sizes = Sizes::default();
        let (first, second) = ([10, 11, 12, 13], [20, 21, 22, 23]);
        let mut recorded = vec![];
        for number in 0..10 {
            recorded.push(update(&mut sizes, number, if number < 5 { &first } else { &second }));
        }
        let expected = |of: [i64; 4], before: [Option<i64>; 4]| of.into_iter().zip(before).collect::<Vec<_>>();
        assert_eq!(recorded[1], expected(first, [None; 4]));
        assert_eq!(recorded[6], expected(second, first.map(Some)), "the one used longest ago first");
        assert_eq!(recorded.concat().len(), 8);
    }

    #[test]
    fn more_sizes_than_there_is_room_for_do_not_drop_one_another() {
        let mut sizes = Sizes::default();
        let recorded: Vec<_> = (0..100).flat_map(|number| update(&mut sizes, number, &[1, 2, 3, 4, 5, 6])).collect();
        assert_eq!(recorded, [1, 2, 3, 4].map(|frames| (frames, None)));
    }

    #[test]
    fn sizes_that_come_once_are_never_recorded_and_soon_forgotten() {
        let mut sizes = Sizes::default();
        let mut recorded = vec![];
        for number in 0..1000u64 {
            // Every third rollout is not ended early.
            let frames = if number % 3 == 0 { 7600 } else { 1000 + number.cast_signed() };
            recorded.extend(update(&mut sizes, number, &[frames]));
            assert!(sizes.known.len() <= REMEMBERED as usize + 1 + MOST_RECORDED);
        }
        assert_eq!(recorded, [(7600, None)]);
    }

    /// Sizes that come again by chance are recorded now and then, and the one that comes all the time keeps its place.
    #[test]
    fn chance_records_seldom() {
        let mut sizes = Sizes::default();
        let (mut recorded, mut state) = (vec![], 1u64);
        for number in 0..1000u64 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            // Ended early somewhere from 50 to 199 of 200 steps, with 38 environments.
            let steps = if number % 2 == 0 { 200 } else { 50 + ((state >> 33) % 150).cast_signed() };
            recorded.extend(update(&mut sizes, number, &[38 * steps]));
        }
        assert_eq!(recorded.iter().filter(|&&(frames, _)| frames == 7600).count(), 1, "{recorded:?}");
        assert!((2..50).contains(&recorded.len()), "{}", recorded.len());
        assert!(recorded.iter().all(|&(_, dropped)| dropped != Some(7600)));
    }
}
