//! The recorder's receipts: which observations it has taken, and how much of the recording it has handed to the
//! operating system.
//!
//! Actors send each observation once, to learner and recorder. An actor can be killed after the one and before the
//! other has it; its successor rebuilds only what the learner has not answered yet. So a learner answers when the
//! recorder, too, has what it answers, and an update begins when the recording of its rollout is written: otherwise a
//! step could be trained on and missing in the recording.
//!
//! Receipts are words in a file that all map: the recorder writes, learners and actors read. They cost neither a
//! message nor an open file. A learner's bell rings when there is something new for it.

use crate::address::WireAddress;
use crate::error::WireError;
use crate::shm::SharedWords;
use rustix::time::{ClockId, clock_gettime};
use std::fmt::Debug;
use std::time::{Duration, Instant};

/// A receipt of one half of an actor's environments: everything up to an exchange was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Receipt {
    /// The learner incarnation that these exchanges belong to.
    pub learner_incarnation: u32,
    pub step: u64,
}

/// How far the recording has been handed to the operating system: a killed orchestrator takes nothing of it along.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    pub learner_incarnation: u32,
    /// First rollout that is not in it.
    pub rollout: u64,
}

/// A recorder that has something to do, or nothing, gets on at least once a second. One that has not for so long stands
/// still: its disk is slow or hangs, or its process is stopped. It is less than the two seconds after which a learner
/// names an actor.
const STANDSTILL: Duration = Duration::from_millis(1_800);

/// For how long a process has seen the recorder stand still: the sum of the times between its looks. A process that was
/// stopped itself saw nothing meanwhile.
#[derive(Debug, Clone, Copy, Default)]
pub struct Standstill {
    seen: Duration,
    looked: Option<Instant>,
}

impl Standstill {
    /// How long others wait for a recorder that stands still before they give up.
    pub const DEADLINE: Duration = Duration::from_mins(10);
    /// More than this between two looks does not count.
    const LONGEST_TURN: Duration = Duration::from_secs(1);

    /// Looks again. Returns for how long it has been seen to stand still; none while it gets on.
    pub fn look(&mut self, receipts: &Receipts) -> Option<Duration> {
        self.see(receipts.stands_still(), Instant::now())
    }

    fn see(&mut self, stands_still: bool, now: Instant) -> Option<Duration> {
        if !stands_still {
            *self = Self::default();
            return None;
        }
        let turn =
            self.looked.map_or(STANDSTILL, |before| now.saturating_duration_since(before).min(Self::LONGEST_TURN));
        (self.seen, self.looked) = (self.seen + turn, Some(now));
        Some(self.seen)
    }
}

/// Bits of the number in a word; the learner incarnation has the others.
const NUMBER_BITS: u32 = 40;
const WRITTEN: usize = 0;
/// Word that is not 0 once the recording has failed.
const FAILED: usize = 1;
/// Word of the moment at which the recorder last got on, milliseconds of the machine's monotonic clock; 0 before that.
const BEAT: usize = 2;
/// First word of the first actor: its incarnation that the recorder has met, then a receipt for each half.
const ACTORS: usize = 3;
const WORDS_PER_ACTOR: usize = 3;

fn words(actors: u32) -> usize {
    ACTORS + actors as usize * WORDS_PER_ACTOR
}

fn met_word(actor: u32) -> usize {
    ACTORS + actor as usize * WORDS_PER_ACTOR
}

fn receipt_word(actor: u32, half: u32) -> usize {
    assert!(half < 2, "an actor has at most two halves");
    met_word(actor) + 1 + half as usize
}

/// Both numbers change together, so they share a word. None if they do not fit: 16 million starts of a learner, a
/// million million exchanges.
fn pack(learner_incarnation: u32, number: u64) -> Option<u64> {
    let fits = learner_incarnation < 1 << (u64::BITS - NUMBER_BITS) && number < 1 << NUMBER_BITS;
    fits.then_some(u64::from(learner_incarnation) << NUMBER_BITS | number)
}

/// Learner incarnations count from 1, so 0 is a word that was not written yet.
fn unpack(word: u64) -> Option<(u32, u64)> {
    (word != 0).then_some(((word >> NUMBER_BITS) as u32, word & ((1 << NUMBER_BITS) - 1)))
}

/// The same for all processes of a machine.
fn now_ms() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1000 + now.tv_nsec as u64 / 1_000_000
}

fn map(address: &WireAddress, actors: u32, writable: bool) -> Result<SharedWords, WireError> {
    let path = address.receipts();
    SharedWords::open(&path, words(actors), writable)
        .map_err(|cause| WireError::Receipts { path: path.display().to_string(), cause })
}

/// Makes the file: the orchestrator's part.
pub(crate) fn create(address: &WireAddress, actors: u32) -> Result<(), WireError> {
    let path = address.receipts();
    SharedWords::create(&path, words(actors))
        .map_err(|cause| WireError::Receipts { path: path.display().to_string(), cause })
}

pub struct Receipts(SharedWords);

impl Debug for Receipts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Receipts").field("written", &self.written()).finish_non_exhaustive()
    }
}

impl Receipts {
    /// The receipts of an orchestrator incarnation with this many actors.
    pub fn open(address: &WireAddress, actors: u32) -> Result<Self, WireError> {
        map(address, actors, false).map(Self)
    }

    /// The incarnation of an actor that the recorder has heard last; 0 before the first.
    ///
    /// # Panics
    /// Here and below, if there is no such actor or half.
    pub fn met(&self, actor: u32) -> u32 {
        self.0.load(met_word(actor)) as u32
    }

    pub fn of(&self, actor: u32, half: u32) -> Option<Receipt> {
        unpack(self.0.load(receipt_word(actor, half)))
            .map(|(learner_incarnation, step)| Receipt { learner_incarnation, step })
    }

    pub fn written(&self) -> Option<Written> {
        unpack(self.0.load(WRITTEN)).map(|(learner_incarnation, rollout)| Written { learner_incarnation, rollout })
    }

    /// True once nothing more can be recorded.
    pub fn failed(&self) -> bool {
        self.0.load(FAILED) != 0
    }

    /// Whether the recorder stands still. One that has not begun does not.
    fn stands_still(&self) -> bool {
        let beat = self.0.load(BEAT);
        beat != 0 && Duration::from_millis(now_ms().saturating_sub(beat)) > STANDSTILL
    }
}

pub struct ReceiptBook(SharedWords);

impl Debug for ReceiptBook {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ReceiptBook").finish_non_exhaustive()
    }
}

impl ReceiptBook {
    /// The book of an orchestrator incarnation with this many actors.
    pub fn open(address: &WireAddress, actors: u32) -> Result<Self, WireError> {
        map(address, actors, true).map(Self)
    }

    /// Something of this incarnation of an actor was received: from now on none of its samples passes the recorder by.
    ///
    /// # Panics
    /// Here and below, if there is no such actor or half.
    pub fn meet(&self, actor: u32, incarnation: u32) {
        self.0.store(met_word(actor), u64::from(incarnation));
    }

    /// Everything up to this exchange was taken.
    pub fn take(&self, actor: u32, half: u32, Receipt { learner_incarnation, step }: Receipt) {
        if let Some(word) = pack(learner_incarnation, step) {
            self.0.store(receipt_word(actor, half), word);
        }
    }

    pub fn write(&self, Written { learner_incarnation, rollout }: Written) {
        if let Some(word) = pack(learner_incarnation, rollout) {
            self.0.store(WRITTEN, word);
        }
    }

    /// The recorder gets on: it writes, or waits for something to write.
    pub fn beat(&self) {
        self.0.store(BEAT, now_ms().max(1));
    }

    /// Nothing more is recorded.
    pub fn fail(&self) {
        self.0.store(FAILED, 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_writes_all_read_and_nothing_is_written_at_first() {
        let address = WireAddress::new(&format!("testreceipts{}", std::process::id()), 1);
        std::fs::create_dir(address.root()).unwrap();
        create(&address, 2).unwrap();
        assert!(create(&address, 2).is_err(), "one incarnation has one book");
        let (book, receipts) = (ReceiptBook::open(&address, 2).unwrap(), Receipts::open(&address, 2).unwrap());
        let all = || (receipts.met(1), receipts.of(1, 0), receipts.of(1, 1), receipts.written(), receipts.failed());
        assert_eq!(all(), (0, None, None, None, false));
        let taken = Receipt { learner_incarnation: 2, step: 0 };
        book.meet(1, 7);
        book.take(1, 1, taken);
        assert_eq!(all(), (7, None, Some(taken), None, false));
        assert_eq!((receipts.met(0), receipts.of(0, 1)), (0, None));
        let last = Receipt { learner_incarnation: (1 << 24) - 1, step: (1 << 40) - 1 };
        book.take(1, 1, last);
        // What does not fit is no receipt: nobody takes it for another one.
        book.take(1, 1, Receipt { learner_incarnation: 1 << 24, step: 0 });
        book.take(1, 1, Receipt { learner_incarnation: 1, step: 1 << 40 });
        let written = Written { learner_incarnation: 3, rollout: 9 };
        book.write(written);
        book.fail();
        assert_eq!(all(), (7, None, Some(last), Some(written), true));
        let mut standstill = Standstill::default();
        assert_eq!(standstill.look(&receipts), None, "it has not begun");
        book.beat();
        assert_eq!(standstill.look(&receipts), None);
        book.0.store(BEAT, 1);
        assert_eq!(standstill.look(&receipts), Some(STANDSTILL), "once since the machine started");
        let message = Receipts::open(&address, 3).unwrap_err().to_string();
        assert!(message.contains("has 72 bytes of 96"), "{message}");
        drop((book, receipts));
        address.sweep().unwrap();
    }

    #[test]
    fn a_process_that_was_stopped_has_seen_no_standstill() {
        let (mut standstill, begun) = (Standstill::default(), Instant::now());
        let mut see = |stands_still, ms| standstill.see(stands_still, begun + Duration::from_millis(ms));
        let ms = Duration::from_millis;
        assert_eq!([see(true, 0), see(true, 250)], [Some(STANDSTILL), Some(STANDSTILL + ms(250))]);
        assert_eq!(see(true, 3_600_000), Some(STANDSTILL + ms(1250)), "an hour without a look");
        assert_eq!([see(false, 3_600_100), see(true, 3_600_200)], [None, Some(STANDSTILL)]);
    }

    #[test]
    #[should_panic(expected = "words that were mapped for reading are not written")]
    fn a_reader_cannot_write() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("words");
        SharedWords::create(&path, 1).unwrap();
        SharedWords::open(&path, 1, false).unwrap().store(0, 1);
    }
}
