//! What is known of every trained rollout: the lines of `metrics.jsonl`, which the orchestrator writes, and of the same
//! list in every checkpoint, which the learner writes.
//!
//! A checkpoint holds the figures of all rollouts before it, so the file can be made from it: after a kill the
//! orchestrator takes from the checkpoint what it never heard, and drops what lies behind it.

use crate::bounded::Lines;
use crate::event::Timing;
use crate::figures::{Figures, KnownNames};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::BufRead;
use std::ops::RangeInclusive;

/// One line.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Trained {
    pub rollout: u64,
    /// Frames trained on, this rollout included.
    pub frames: u64,
    /// Stage, as an index into the configuration's.
    pub stage: u32,
    /// When it was trained, seconds since 1970.
    pub at_unix_s: u64,
    pub incarnation: u32,
    /// How long that had been running then, seconds by a clock that nobody sets. None in a checkpoint, and in lines of
    /// older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_s: Option<f64>,
    pub timing: Timing,
    pub metrics: Figures,
}

impl Trained {
    pub fn encode(&self, lines: &mut Vec<u8>) {
        serde_json::to_writer(&mut *lines, self).expect("numbers and strings always serialise");
        lines.push(b'\n');
    }

    /// Whether both are of the same training: all is equal but the times, and who noted them.
    fn is_as(&self, other: &Self) -> bool {
        (self.rollout, self.frames, self.stage, &self.metrics)
            == (other.rollout, other.frames, other.stage, &other.metrics)
    }
}

/// From so many bytes on, a piece of a history is written.
const PIECE_BYTES: usize = 64 << 10;

/// The rollouts that count, in order.
#[derive(Debug, Clone, Default)]
pub struct History {
    rollouts: BTreeMap<u64, Trained>,
    names: KnownNames,
}

impl PartialEq for History {
    fn eq(&self, other: &Self) -> bool {
        self.rollouts == other.rollouts
    }
}

impl History {
    /// What lines of JSON say, and how many of them are damaged. Of several lines with the same rollout number the last
    /// is valid, and a line makes all earlier ones with higher numbers void: so a file is read that was only ever
    /// appended to. The last line may be cut off, by a kill or because it is being written.
    pub fn decode(bytes: &[u8]) -> (Self, usize) {
        Self::read(bytes).expect("memory can be read")
    }

    /// The same from a file, line by line.
    pub fn read(file: impl BufRead) -> std::io::Result<(Self, usize)> {
        let (mut history, mut damaged) = (Self::default(), 0);
        let mut lines = Lines::of(file);
        while let Some(line) = lines.read()? {
            if !history.insert_line(line) {
                damaged += usize::from(line.ends_with(b"\n") && line != b"\n");
            }
        }
        Ok((history, damaged))
    }

    /// A line of JSON for each.
    pub fn encode(&self) -> Vec<u8> {
        self.pieces().flatten().collect()
    }

    /// The same in pieces of whole lines, each of little more than 64 KiB: a long run has tens of megabytes of them.
    pub fn pieces(&self) -> impl Iterator<Item = Vec<u8>> {
        let mut rollouts = self.iter().peekable();
        std::iter::from_fn(move || {
            rollouts.peek()?;
            let mut piece = Vec::new();
            while piece.len() < PIECE_BYTES
                && let Some(trained) = rollouts.next()
            {
                trained.encode(&mut piece);
            }
            Some(piece)
        })
    }

    /// Takes in the newest line of a file; false where it is damaged: no figures, or more names than a run has.
    pub fn insert_line(&mut self, line: &[u8]) -> bool {
        let Ok(mut trained) = serde_json::from_slice::<Trained>(line) else { return false };
        let is_plausible = self.names.share(&mut trained.metrics);
        if is_plausible {
            self.insert(trained);
        }
        is_plausible
    }

    pub fn insert(&mut self, trained: Trained) {
        self.rewind_to(trained.rollout);
        self.keep(trained);
    }

    fn keep(&mut self, mut trained: Trained) {
        self.names.share(&mut trained.metrics);
        self.rollouts.insert(trained.rollout, trained);
    }

    /// A learner begins with `rollout` again: what came after its checkpoint is void.
    pub fn rewind_to(&mut self, rollout: u64) {
        drop(self.rollouts.split_off(&rollout));
    }

    /// Takes over whatever `truth` holds and this does not, or holds otherwise; the number of rollouts changed by that.
    pub fn correct(&mut self, truth: &Self) -> usize {
        let wrong: Vec<&Trained> = truth
            .iter()
            .filter(|trained| !self.rollouts.get(&trained.rollout).is_some_and(|own| own.is_as(trained)))
            .collect();
        for trained in &wrong {
            self.keep((*trained).clone());
        }
        wrong.len()
    }

    /// Takes over whatever `other` holds and this does not; how many rollouts that are.
    pub fn fill(&mut self, other: &Self) -> usize {
        let before = self.len();
        for trained in other.iter() {
            if !self.rollouts.contains_key(&trained.rollout) {
                self.keep(trained.clone());
            }
        }
        self.len() - before
    }

    /// In order of their numbers.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Trained> {
        self.rollouts.values()
    }

    pub fn len(&self) -> usize {
        self.rollouts.len()
    }

    pub fn is_empty(&self) -> bool {
        self.rollouts.is_empty()
    }

    pub fn frames(&self) -> u64 {
        self.rollouts.values().next_back().map_or(0, |last| last.frames)
    }

    /// The rollouts before `end` of which nothing is known.
    pub fn gaps(&self, end: u64) -> Vec<RangeInclusive<u64>> {
        let mut gaps = Vec::new();
        let mut next = 0;
        for rollout in self.rollouts.range(..end).map(|(&rollout, _)| rollout).chain([end]) {
            if next < rollout {
                gaps.push(next..=rollout - 1);
            }
            next = rollout + 1;
        }
        gaps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trained(rollout: u64, mark: u64) -> Trained {
        Trained {
            rollout,
            frames: (rollout + 1) * 10,
            at_unix_s: mark,
            incarnation: 1,
            metrics: BTreeMap::from([("a".to_owned(), 0.1 + 0.2 + rollout as f64 / 3.0)]).into(),
            ..Trained::default()
        }
    }

    fn history(rollouts: impl IntoIterator<Item = u64>) -> History {
        let mut history = History::default();
        rollouts.into_iter().for_each(|rollout| history.insert(trained(rollout, 1)));
        history
    }

    #[test]
    fn later_lines_hold_and_void_what_lay_ahead() {
        let mut bytes = history(0..5).encode();
        // A crash in the middle of a line, then a learner that goes on from rollout 2.
        bytes.extend(&serde_json::to_vec(&trained(5, 1)).unwrap()[..20]);
        let (cut, damaged) = History::decode(&bytes);
        assert_eq!((cut.len(), damaged), (5, 0), "the last line may be cut off");
        bytes.push(b'\n');
        for rollout in 2..4 {
            bytes.extend(serde_json::to_vec(&trained(rollout, 2)).unwrap());
            bytes.push(b'\n');
        }
        let (history, damaged) = History::decode(&bytes);
        let kept: Vec<_> = history.iter().map(|trained| (trained.rollout, trained.at_unix_s)).collect();
        assert_eq!(kept, [(0, 1), (1, 1), (2, 2), (3, 2)]);
        assert_eq!((history.frames(), damaged), (40, 1));
    }

    #[test]
    fn lines_with_more_names_than_a_run_has_are_damaged() {
        let line = |rollout: u64| {
            let name = if rollout.is_multiple_of(2) { "a".to_owned() } else { rollout.to_string() };
            let metrics = BTreeMap::from([(name, 1.0)]).into();
            serde_json::to_string(&Trained { metrics, ..trained(rollout, 1) }).unwrap() + "\n"
        };
        let (history, damaged) = History::decode((0..2_000).map(line).collect::<String>().as_bytes());
        assert_eq!((history.len(), damaged), (1_000 + 511, 1_000 - 511));
    }

    #[test]
    fn figures_come_back_bit_for_bit() {
        let history = history(0..300);
        let (again, damaged) = History::decode(&history.encode());
        assert_eq!((&again, damaged), (&history, 0));
        assert_eq!(again.encode(), history.encode());
    }

    #[test]
    fn its_pieces_are_small_and_of_whole_lines() {
        let history = history(0..2_000);
        let pieces: Vec<_> = history.pieces().collect();
        assert!(pieces.len() > 3, "{}", pieces.len());
        assert!(pieces.iter().all(|piece| piece.ends_with(b"\n") && piece.len() < PIECE_BYTES + 1_000));
        assert_eq!(History::decode(&pieces.concat()), (history, 0));
        assert_eq!(History::default().pieces().count(), 0);
    }

    #[test]
    fn what_a_checkpoint_says_otherwise_is_corrected_and_times_are_kept() {
        let truth = history(0..4);
        let mut own = history([0, 1]);
        own.insert(Trained { at_unix_s: 9, ..trained(0, 9) });
        own.insert(Trained { frames: 7, ..trained(2, 1) });
        assert_eq!(own.correct(&truth), 3);
        let kept: Vec<_> = own.iter().map(|trained| (trained.rollout, trained.at_unix_s, trained.frames)).collect();
        assert_eq!(kept, [(0, 9, 10), (1, 1, 20), (2, 1, 30), (3, 1, 40)]);
        assert_eq!(own.correct(&truth), 0);
        let mut own = history([1]);
        own.insert(Trained { frames: 7, ..trained(2, 1) });
        assert_eq!((own.fill(&truth), own.len()), (2, 4));
        assert_eq!(own.iter().map(|trained| trained.frames).collect::<Vec<_>>(), [10, 20, 7, 40]);
    }

    #[test]
    fn gaps_are_named() {
        assert_eq!(history([]).gaps(0), []);
        assert_eq!(history([]).gaps(2), [0..=1]);
        assert_eq!(history(0..5).gaps(5), []);
        assert_eq!(history([1, 2, 5]).gaps(8), [0..=0, 3..=4, 6..=7]);
        assert_eq!(history([1, 2, 5]).gaps(3), [0..=0], "what lies behind does not count");
    }
}
