//! Rings actors' bells on threads of their own.
//!
//! A ring to a process that sleeps is a system call, which wakes it. With dozens of actors, twice a step, that adds up.
//! Here the learner goes on meanwhile.

use anyhow::{Context, Result};
use std::ops::Range;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use wire::{Bell, Bells, Sleeper};

const MOST_THREADS: u32 = 4;
/// The fewest actors for which another thread is worth its start.
const ACTORS_A_THREAD: u32 = 24;

/// The threads, each with consecutive actors.
pub struct Ringers(Vec<Ringer>);

struct Ringer {
    actors: Range<u32>,
    /// Actors to be woken, as the run numbers them. Closed to end the thread.
    due: Option<Sender<Range<u32>>>,
    thread: Option<JoinHandle<()>>,
}

impl Ringers {
    pub fn start(bells: &Bells, actors: Range<u32>) -> Result<Self> {
        parts(&actors).into_iter().map(|actors| Ringer::start(bells, actors)).collect::<Result<_>>().map(Self)
    }

    /// Has these actors woken, soon. What they are woken for must have been sent.
    pub fn ring(&self, actors: Range<u32>) {
        for ringer in &self.0 {
            let due = ringer.actors.start.max(actors.start)..ringer.actors.end.min(actors.end);
            if let (false, Some(sender)) = (due.is_empty(), &ringer.due) {
                // It can only fail if the thread has panicked; actors look a few times a second.
                let _ = sender.send(due);
            }
        }
    }
}

impl Ringer {
    fn start(bells: &Bells, actors: Range<u32>) -> Result<Self> {
        let (due, orders) = channel();
        let first = actors.start;
        let bells: Vec<_> = actors.clone().map(|actor| bells.bell([Sleeper::Actor(actor)])).collect();
        let run = move || ring_all(&bells, first, &orders);
        let thread = std::thread::Builder::new().name("bells".into()).spawn(run).context("cannot start a thread")?;
        Ok(Self { actors, due: Some(due), thread: Some(thread) })
    }
}

impl Drop for Ringer {
    /// Returns when all that is due has rung.
    fn drop(&mut self) {
        self.due = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn ring_all(bells: &[Bell], first: u32, orders: &Receiver<Range<u32>>) {
    for actor in orders.iter().flatten() {
        bells[(actor - first) as usize].ring();
    }
}

/// Consecutive actors, divided evenly among the threads.
fn parts(actors: &Range<u32>) -> Vec<Range<u32>> {
    let count = actors.end - actors.start;
    let threads = (count / ACTORS_A_THREAD).clamp(1, MOST_THREADS);
    let place = |thread: u32| actors.start + count * thread / threads;
    (0..threads).map(|thread| place(thread)..place(thread + 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::shares::Shares;
    use std::time::Duration;
    use wire::{WireAddress, WireHost, WireShape};

    #[test]
    fn every_actor_has_one_thread() {
        for (actors, threads) in [(0..1, 1), (5..24, 1), (0..48, 2), (38..114, 3), (0..400, MOST_THREADS as usize)] {
            let parts = parts(&actors);
            assert_eq!(parts.len(), threads, "{actors:?}");
            assert!(parts.iter().cloned().flatten().eq(actors), "{parts:?}");
        }
    }

    #[test]
    fn those_that_are_due_are_woken_and_no_others() {
        let shape = WireShape::new(Shares::of_one(50), 1, proto::config::Config::default().spec());
        let address = WireAddress::new(&format!("testringers{}", std::process::id()), 1);
        let host = WireHost::create(&address, shape).unwrap();
        {
            let bells = Bells::open(&address, shape).unwrap();
            let wakeups: Vec<_> = (0..50).map(|actor| bells.wakeup(Sleeper::Actor(actor))).collect();
            let ringers = Ringers::start(&bells, 0..50).unwrap();
            assert_eq!(ringers.0.len(), 2);
            let woken = |longest: Duration| -> Vec<u32> {
                (0..50).filter(|&actor: &u32| wakeups[actor as usize].wait(longest)).collect()
            };
            assert_eq!(woken(Duration::ZERO).len(), 50, "the first wait returns at once");
            ringers.ring(20..30);
            ringers.ring(49..50);
            // Whoever ends them has had all bells rung.
            drop(ringers);
            assert_eq!(woken(Duration::from_millis(1)), [(20..30).collect(), vec![49]].concat());
        }
        drop(host);
        address.sweep().unwrap();
    }
}
