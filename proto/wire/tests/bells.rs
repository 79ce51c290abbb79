//! No ring is lost when several processes ring at once.

use proto::shares::Shares;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use wire::{Bells, Sleeper, WireAddress, WireHost, WireShape};

const RINGERS: u32 = 3;
const ROUNDS: u32 = 20_000;
/// Longer than any turn on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

#[test]
fn every_ring_wakes_who_sleeps() {
    let shape = WireShape { shares: Shares::of_one(RINGERS), environments_per_actor: 1 };
    let address = WireAddress::new(&format!("testrings{}", std::process::id()), 1);
    let host = WireHost::create(&address, shape).unwrap();
    {
        let wakeup = host.wire().bells().wakeup(Sleeper::Learner(0));
        let [said, heard] = [(); 2].map(|()| (0..RINGERS).map(|_| AtomicU32::new(0)).collect::<Vec<_>>());
        std::thread::scope(|scope| {
            for (said, heard) in said.iter().zip(&heard) {
                let address = &address;
                scope.spawn(move || {
                    // A mapping of its own, as a process has.
                    let bell = Bells::open(address, shape).unwrap().bell([Sleeper::Learner(0)]);
                    for round in 1..=ROUNDS {
                        said.store(round, Ordering::SeqCst);
                        // Of every kind, also where one is enough.
                        if round % 2 == 0 {
                            bell.ring();
                        } else {
                            bell.ring_counted();
                        }
                        // It goes on when it was heard, so a ring that is lost stops all that follow.
                        while heard.load(Ordering::SeqCst) < round {
                            std::thread::yield_now();
                        }
                    }
                });
            }
            while heard.iter().any(|heard| heard.load(Ordering::SeqCst) < ROUNDS) {
                let began = Instant::now();
                wakeup.wait(PATIENCE);
                // Not an assertion yet: the ringers must be let go.
                let lost = began.elapsed() >= PATIENCE;
                for (said, heard) in said.iter().zip(&heard) {
                    heard.store(if lost { ROUNDS } else { said.load(Ordering::SeqCst) }, Ordering::SeqCst);
                }
                assert!(!lost, "a ring was lost");
            }
        });
    }
    drop(host);
    address.sweep().unwrap();
}
