//! Waking processes that sleep. Each has a word in a file that all map. Whoever has sent it something rings: that
//! counts the word up, and if the process sleeps, the kernel (futex) wakes it.
//!
//! A ring to a process that is awake is one or two atomic additions, and who wakes has nothing to read and nothing to
//! clear. With iceoryx2's events, which are sockets, both cost system calls: one sent, two or three read, and the waits
//! around them. Who waits for many others, as a learner for its actors, need not be woken by each.
//!
//! Where each process of the run can have a core of its own, one that waits looks for a ring for a while before it
//! sleeps: the kernel takes longer to wake it than a small environment takes for a step.
//!
//! Nothing here depends on who lives. A process can be killed or stopped before it rings, or between taking the mark
//! off and waking the sleeper, when the others' rings find no mark either: so nobody sleeps without a limit. One that
//! is killed asleep leaves its word marked, and a ring for it wakes nobody.

use crate::address::WireAddress;
use crate::dimensions::WireShape;
use crate::error::WireError;
use crate::shm::SharedWords;
use rustix::io::Errno;
use rustix::thread::futex::{self, Flags, Timespec};
use std::cell::Cell;
use std::fmt::Debug;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// The bit of a word that says that its process sleeps, or is about to. The others count rings.
const ASLEEP: u32 = 1;
const RING: u32 = 2;
/// Most rings that can be waited for: more processes than a run has.
const MOST_COUNTED: u32 = 1 << 20;
/// Words of the file for each process: a cache line, so that who rings one does not slow another. After the first come
/// the number of rings at which it is to be woken, and the number of those that wake it at once.
const STRIDE: usize = 8;
const TARGET: usize = 1;
const AT_ONCE: usize = 2;

/// How long one looks for a ring before it sleeps.
const LOOK: Duration = Duration::from_micros(200);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sleeper {
    Recorder,
    Learner(u32),
    Actor(u32),
}

#[derive(Clone)]
pub struct Bells {
    words: Arc<SharedWords>,
    shape: WireShape,
}

impl Debug for Bells {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bells").field("shape", &self.shape).finish_non_exhaustive()
    }
}

impl Bells {
    /// Makes the file: the orchestrator's part.
    pub(crate) fn create(address: &WireAddress, shape: WireShape) -> Result<(), WireError> {
        let path = address.bells();
        SharedWords::create(&path, places(shape) * STRIDE).map_err(|cause| failed(address, cause))
    }

    pub fn open(address: &WireAddress, shape: WireShape) -> Result<Self, WireError> {
        let words = SharedWords::open(&address.bells(), places(shape) * STRIDE, true);
        Ok(Self { words: Arc::new(words.map_err(|cause| failed(address, cause))?), shape })
    }

    /// The bell of these processes.
    ///
    /// # Panics
    /// Here and below, if the run has no such process.
    pub fn bell(&self, sleepers: impl IntoIterator<Item = Sleeper>) -> Bell {
        let places = sleepers.into_iter().map(|sleeper| self.place(sleeper)).collect();
        Bell { words: Arc::clone(&self.words), places }
    }

    pub fn wakeup(&self, sleeper: Sleeper) -> Wakeup {
        let place = self.place(sleeper);
        // As if it had just rung: what was sent before may be there.
        let at_once = self.words.low(place + AT_ONCE).load(Ordering::SeqCst).wrapping_sub(1);
        let seen = Seen { rings: rings(self.words.low(place).load(Ordering::SeqCst)), at_once };
        let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        // The recorder has no turn of its own to wait for.
        let has_core = places(self.shape) - 1 <= cores;
        let look = if has_core { LOOK } else { Duration::ZERO };
        Wakeup { words: Arc::clone(&self.words), place, seen: Cell::new(seen), look }
    }

    fn place(&self, sleeper: Sleeper) -> usize {
        let (learners, actors) = (self.shape.shares.learners(), self.shape.shares.actors());
        let place = match sleeper {
            Sleeper::Recorder => 0,
            Sleeper::Learner(rank) if rank < learners => 1 + rank,
            Sleeper::Actor(actor) if actor < actors => 1 + learners + actor,
            Sleeper::Learner(_) | Sleeper::Actor(_) => panic!("the run has no {sleeper:?}"),
        };
        place as usize * STRIDE
    }
}

fn places(shape: WireShape) -> usize {
    1 + (shape.shares.learners() + shape.shares.actors()) as usize
}

fn failed(address: &WireAddress, cause: std::io::Error) -> WireError {
    WireError::Bells { path: address.bells().display().to_string(), cause }
}

fn rings(word: u32) -> u32 {
    word & !ASLEEP
}

/// Whether a word has reached so many rings. The count wraps around: only the difference matters.
fn has_reached(word: u32, target: u32) -> bool {
    rings(word).wrapping_sub(target).cast_signed() >= 0
}

/// Wakes one or several processes. Any thread may ring.
#[derive(Clone)]
pub struct Bell {
    words: Arc<SharedWords>,
    places: Vec<usize>,
}

impl Debug for Bell {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bell").field("places", &self.places).finish_non_exhaustive()
    }
}

impl Bell {
    pub fn ring(&self) {
        for &place in &self.places {
            self.words.low(place + AT_ONCE).fetch_add(1, Ordering::SeqCst);
            self.add(place, |_| true);
        }
    }

    /// Rings once of many: who sleeps wakes when it has been rung as often as it waits for ([`Wakeup::wait_for`]).
    pub fn ring_counted(&self) {
        for &place in &self.places {
            self.add(place, |word| has_reached(word, self.words.low(place + TARGET).load(Ordering::SeqCst)));
        }
    }

    fn add(&self, place: usize, is_due: impl Fn(u32) -> bool) {
        let word = self.words.low(place);
        // Who sleeps compares the whole word, in the kernel: after this it does not fall asleep.
        let before = word.fetch_add(RING, Ordering::SeqCst);
        if before & ASLEEP != 0 && is_due(before.wrapping_add(RING)) {
            // The others that ring until it runs need not wake it, too.
            word.fetch_and(!ASLEEP, Ordering::SeqCst);
            if let Err(error) = futex::wake(word, Flags::empty(), i32::MAX.unsigned_abs()) {
                tracing::debug!("a bell does not ring: {error}");
            }
        }
    }
}

/// Where a process sleeps until a bell of its own rings. One thread of it does.
pub struct Wakeup {
    words: Arc<SharedWords>,
    place: usize,
    seen: Cell<Seen>,
    look: Duration,
}

/// The rings up to the last return.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Seen {
    rings: u32,
    at_once: u32,
}

impl Debug for Wakeup {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Wakeup").field("place", &self.place).finish_non_exhaustive()
    }
}

impl Wakeup {
    /// Sleeps until it has rung since the last return, at most for `longest`; returns whether it has. It may return
    /// early. What a bell announces was there before it rang: look for all of it afterwards.
    pub fn wait(&self, longest: Duration) -> bool {
        self.wait_for(1, longest)
    }

    /// The same, but so many counted rings ([`Bell::ring_counted`]) are needed to wake it. Every other ring does.
    pub fn wait_for(&self, counted: u32, longest: Duration) -> bool {
        let [word, target, at_once] = [0, TARGET, AT_ONCE].map(|offset| self.words.low(self.place + offset));
        let seen = self.seen.get();
        let until = seen.rings.wrapping_add(RING.saturating_mul(counted.clamp(1, MOST_COUNTED)));
        // Before the mark, which whoever rings finds first.
        target.store(until, Ordering::SeqCst);
        let is_due = |word| has_reached(word, until) || at_once.load(Ordering::SeqCst) != seen.at_once;
        let began = Instant::now();
        while !is_due(word.load(Ordering::SeqCst)) && began.elapsed() < self.look.min(longest) {
            std::hint::spin_loop();
        }
        if !is_due(word.load(Ordering::SeqCst)) {
            // A ring that is not enough yet can keep it from falling asleep.
            while let Some(left) = longest.checked_sub(began.elapsed()).filter(|left| !left.is_zero()) {
                let marked = word.fetch_or(ASLEEP, Ordering::SeqCst) | ASLEEP;
                if is_due(marked) || sleep(word, marked, left) {
                    break;
                }
            }
            word.fetch_and(!ASLEEP, Ordering::SeqCst);
        }
        // First the rings at once: each is counted among all after it.
        let at_once = at_once.load(Ordering::SeqCst);
        let now = Seen { rings: rings(word.load(Ordering::SeqCst)), at_once };
        self.seen.replace(now) != now
    }
}

/// Until the word is another one than `expected` and somebody says so, at most for `longest`. Returns false if it was
/// another one already: then it may be slept again.
fn sleep(word: &AtomicU32, expected: u32, longest: Duration) -> bool {
    let longest = Timespec::try_from(longest).ok();
    match futex::wait(word, Flags::empty(), expected, longest.as_ref()) {
        Err(Errno::AGAIN) => false,
        // Woken, interrupted by a signal, or the time is over.
        Ok(()) | Err(Errno::INTR | Errno::TIMEDOUT) => true,
        Err(error) => {
            tracing::debug!("cannot sleep: {error}");
            std::thread::sleep(Duration::from_millis(1));
            true
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::WireHost;
    use proto::config::Config;
    use proto::shares::Shares;

    const LONG: Duration = Duration::from_secs(20);
    const QUIET: Duration = Duration::from_millis(30);

    fn with_bells(name: &str, test: impl FnOnce(&Bells)) {
        let shape = WireShape::new(Shares::new(3, 2), 1, Config::default().spec());
        let address = WireAddress::new(&format!("test{name}{}", std::process::id()), 1);
        let host = WireHost::create(&address, shape).unwrap();
        test(&Bells::open(&address, shape).unwrap());
        drop(host);
        address.sweep().unwrap();
        assert!(Bells::open(&address, shape).is_err(), "nothing is left");
    }

    impl Wakeup {
        /// Whether it wakes long before its time is over.
        fn wakes(&self, counted: u32) -> bool {
            let began = Instant::now();
            self.wait_for(counted, LONG) && began.elapsed() < LONG / 2
        }

        /// Whether it sleeps all of its time.
        fn sleeps(&self, counted: u32) -> bool {
            let began = Instant::now();
            self.wait_for(counted, QUIET);
            began.elapsed() >= QUIET
        }
    }

    /// Rings while somebody is about to sleep.
    fn meanwhile(ring: impl FnOnce() + Send, sleep: impl FnOnce() -> bool) -> bool {
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(QUIET);
                ring();
            });
            sleep()
        })
    }

    #[test]
    fn whoever_rings_ends_the_wait_and_a_quiet_one_waits_its_time() {
        with_bells("bells", |bells| {
            let wakeup = bells.wakeup(Sleeper::Learner(1));
            assert!(wakeup.wakes(1), "what was sent before it came may be there");
            assert!(wakeup.sleeps(1));
            // Twice is once; and it makes no difference whether somebody waits already.
            let bell = bells.bell([Sleeper::Recorder, Sleeper::Learner(1)]);
            bell.ring();
            bell.ring();
            assert!(wakeup.wakes(1) && wakeup.sleeps(1));
            assert!(meanwhile(|| bell.ring(), || wakeup.wakes(1)));
            assert!(meanwhile(|| bell.ring_counted(), || wakeup.wakes(1)));
            // Nobody else's wakes it.
            let others =
                [Sleeper::Recorder, Sleeper::Learner(0), Sleeper::Actor(0), Sleeper::Actor(1), Sleeper::Actor(2)];
            bells.bell(others).ring();
            assert!(wakeup.sleeps(1));
            for other in others {
                assert!(bells.wakeup(other).wakes(1));
            }
        });
    }

    #[test]
    fn counted_rings_wake_when_they_are_enough_and_any_other_at_once() {
        with_bells("counted", |bells| {
            let (wakeup, bell) = (bells.wakeup(Sleeper::Learner(0)), bells.bell([Sleeper::Learner(0)]));
            let counted = |count| (0..count).for_each(|_| bell.ring_counted());
            assert!(wakeup.wakes(3), "what was sent before it came may be there");
            assert!(wakeup.sleeps(3));
            counted(2);
            assert!(wakeup.sleeps(3), "too few, before it sleeps");
            for enough in [3, 7] {
                counted(enough);
                assert!(wakeup.wakes(3));
            }
            bell.ring();
            assert!(wakeup.wakes(3), "one that is not counted, before it sleeps");
            assert!(meanwhile(|| counted(3), || wakeup.wakes(3)), "enough, while it sleeps");
            assert!(meanwhile(|| bell.ring(), || wakeup.wakes(3)), "one that is not counted, while it sleeps");
            let slept_through = || {
                let began = Instant::now();
                wakeup.wait_for(3, 20 * QUIET) && began.elapsed() >= 20 * QUIET
            };
            assert!(meanwhile(|| counted(2), slept_through), "too few, while it sleeps");
        });
    }

    #[test]
    fn rings_are_counted_around() {
        for word in [0, 2, u32::MAX - 1, u32::MAX - 5] {
            assert!(has_reached(word, word) && has_reached(word | ASLEEP, word));
            assert!(has_reached(word.wrapping_add(4), word) && !has_reached(word, word.wrapping_add(4)));
        }
    }

    /// One that was killed asleep has left its word marked.
    #[test]
    fn a_successor_of_a_killed_sleeper_sleeps_and_wakes() {
        with_bells("asleep", |bells| {
            let (wakeup, bell) = (bells.wakeup(Sleeper::Actor(2)), bells.bell([Sleeper::Actor(2)]));
            let word = bells.words.low(bells.place(Sleeper::Actor(2)));
            assert!(wakeup.wakes(1) && wakeup.sleeps(1));
            word.fetch_or(ASLEEP, Ordering::SeqCst);
            bell.ring();
            assert!(wakeup.wakes(1) && wakeup.sleeps(1));
            word.fetch_or(ASLEEP, Ordering::SeqCst);
            let successor = bells.wakeup(Sleeper::Actor(2));
            assert!(successor.wakes(1) && successor.sleeps(1));
            assert!(meanwhile(|| bell.ring(), || successor.wakes(1)));
        });
    }
}
