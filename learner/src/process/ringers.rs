//! Rings actors' bells on threads of their own.
//!
//! A ring is a system call that wakes a sleeping process: about 10 µs, ten times as long as all else of sending. With
//! dozens of actors, twice a step, that is longer than inference on a GPU. Here the learner goes on meanwhile.

use anyhow::{Context, Result, anyhow};
use std::ops::Range;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use wire::{Bell, LEARNER_THREADS, Wire, WireAddress, WireShape};

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
    /// For the actors of a learner.
    pub fn start(address: &WireAddress, shape: WireShape, rank: u32) -> Result<Self> {
        let actors = shape.shares.actors_of(rank);
        let ringer = |(number, actors): (usize, Range<u32>)| {
            let (address, name, bells) = (address.clone(), format!("learner-{rank}-bells-{number}"), actors.clone());
            // Ports stay on the thread that made them.
            let open = move || {
                let wire = Wire::join(&address, shape, &name)?;
                let bells = bells.map(|actor| wire.actions_bell(actor)).collect::<Result<Vec<_>, _>>()?;
                anyhow::Ok((bells, wire))
            };
            Ringer::start(actors, open)
        };
        parts(&actors).into_iter().enumerate().map(ringer).collect::<Result<_>>().map(Self)
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
    fn start(actors: Range<u32>, open: impl FnOnce() -> Result<(Vec<Bell>, Wire)> + Send + 'static) -> Result<Self> {
        let (due, orders) = channel();
        let (opened, is_open) = channel();
        let first = actors.start;
        let run = move || match open() {
            Ok((bells, _wire)) => {
                let _ = opened.send(Ok(()));
                ring_all(&bells, first, &orders);
            }
            Err(error) => {
                let _ = opened.send(Err(error));
            }
        };
        let thread = std::thread::Builder::new().name("bells".into()).spawn(run).context("cannot start a thread")?;
        is_open.recv().map_err(|_| anyhow!("the thread of the bells has ended"))??;
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
        // A bell that does not ring is no loss: actors look a few times a second.
        if let Err(cause) = bells[(actor - first) as usize].notify() {
            tracing::debug!("the bell of actor {actor} does not ring: {cause:?}");
        }
    }
}

/// Consecutive actors, divided evenly among the threads.
fn parts(actors: &Range<u32>) -> Vec<Range<u32>> {
    let count = actors.end - actors.start;
    let threads = (count / ACTORS_A_THREAD).clamp(1, LEARNER_THREADS as u32);
    let place = |thread: u32| actors.start + count * thread / threads;
    (0..threads).map(|thread| place(thread)..place(thread + 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::shares::Shares;
    use std::time::Duration;
    use wire::WireHost;

    #[test]
    fn every_actor_has_one_thread() {
        for (actors, threads) in [(0..1, 1), (5..24, 1), (0..48, 2), (38..114, 3), (0..400, LEARNER_THREADS)] {
            let parts = parts(&actors);
            assert_eq!(parts.len(), threads, "{actors:?}");
            assert!(parts.iter().cloned().flatten().eq(actors), "{parts:?}");
        }
    }

    #[test]
    fn those_that_are_due_are_woken_and_no_others() {
        let shape = WireShape { shares: Shares::of_one(50), environments_per_actor: 1 };
        let address = WireAddress::new(&format!("testringers{}", std::process::id()), 1);
        let host = WireHost::create(&address, shape).unwrap();
        {
            let actors = Wire::join(&address, shape, "actors").unwrap();
            let wakeups: Vec<_> = (0..50).map(|actor| actors.actions_wakeup(actor).unwrap()).collect();
            let ringers = Ringers::start(&address, shape, 0).unwrap();
            assert_eq!(ringers.0.len(), 2);
            let woken = |longest: Duration| -> Vec<u32> {
                let rings = |actor: &u32| wakeups[*actor as usize].timed_wait(|_| {}, longest).unwrap() > 0;
                (0..50).filter(rings).collect()
            };
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
