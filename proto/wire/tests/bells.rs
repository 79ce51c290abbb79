//! No ring is lost when several processes ring at once.

use proto::config::Config;
use proto::shares::Shares;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use wire::{Bells, Sleeper, WireAddress, WireHost, WireShape};

const RINGERS: u32 = 5;
const ROUNDS: u32 = 20_000;
/// Longer than any turn on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);
/// So short that the end of a wait meets rings.
const SHORT: Duration = Duration::from_micros(50);

/// Each ringer goes on when all were heard, so a ring that is lost stops all that follow. Who sleeps waits for half of
/// those that have not rung in this round, as a learner does for its actors.
#[test]
fn every_ring_wakes_who_sleeps() {
    let shape = WireShape::new(Shares::of_one(RINGERS), 1, Config::default().spec());
    let address = WireAddress::new(&format!("testrings{}", std::process::id()), 1);
    let host = WireHost::create(&address, shape).unwrap();
    {
        let wakeup = host.wire().bells().wakeup(Sleeper::Learner(0));
        let (said, heard) = ([(); RINGERS as usize].map(|()| AtomicU32::new(0)), AtomicU32::new(0));
        std::thread::scope(|scope| {
            for (ringer, said) in (0..).zip(&said) {
                let (address, heard) = (&address, &heard);
                scope.spawn(move || {
                    // A mapping of its own, as a process has.
                    let bell = Bells::open(address, shape).unwrap().bell([Sleeper::Learner(0)]);
                    for round in 1..=ROUNDS {
                        said.store(round, Ordering::SeqCst);
                        // One of them is not counted now and then.
                        if ringer == 0 && round % 3 == 0 {
                            bell.ring();
                        } else {
                            bell.ring_counted();
                        }
                        while heard.load(Ordering::SeqCst) < round {
                            std::thread::yield_now();
                        }
                    }
                });
            }
            for round in 1..=ROUNDS {
                let mut lost = false;
                loop {
                    let missing = said.iter().filter(|said| said.load(Ordering::SeqCst) < round).count() as u32;
                    if missing == 0 || lost {
                        break;
                    }
                    let longest = if round % 4 == 0 { SHORT } else { PATIENCE };
                    let began = Instant::now();
                    wakeup.wait_for(missing.div_ceil(2), longest);
                    lost = began.elapsed() >= PATIENCE;
                }
                // Not an assertion yet: the ringers must be let go.
                heard.store(if lost { ROUNDS } else { round }, Ordering::SeqCst);
                assert!(!lost, "a ring was lost");
            }
        });
    }
    drop(host);
    address.sweep().unwrap();
}
