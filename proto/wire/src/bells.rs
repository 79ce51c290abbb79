//! Waiting for several things at once: bells of other processes, and a bell between threads of this one. Who waits
//! sleeps until one of them rings, and need not look now and then.

use crate::error::WireError;
use crate::services::{Ipc, Wakeup};
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::prelude::{
    CallbackProgression, FileDescriptor, FileDescriptorBased, SignalHandlingMode, SynchronousMultiplexing, WaitSet,
    WaitSetAttachmentId, WaitSetBuilder, WaitSetGuard,
};
use rustix::event::{EventfdFlags, eventfd};
use std::fmt::Debug;
use std::os::fd::{AsRawFd, OwnedFd};
use std::time::Duration;

/// Wakes the thread that waits for it among [`Bells`]; any thread of the process may ring it. An eventfd.
#[derive(Debug)]
pub struct ThreadBell {
    event: OwnedFd,
    /// The same descriptor, as iceoryx2 wants it; closed by the field above.
    descriptor: FileDescriptor,
}

impl ThreadBell {
    /// A bell that has not rung. Errors if the process has no descriptor left.
    pub fn new() -> std::io::Result<Self> {
        let event = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        let descriptor = FileDescriptor::non_owning_new(event.as_raw_fd()).expect("just opened");
        Ok(Self { event, descriptor })
    }

    /// Rings. Before anybody waits is early enough.
    pub fn ring(&self) {
        // It can only fail because 2^64 - 2 rings are still pending; then it rings anyway.
        let _ = rustix::io::write(&self.event, &1_u64.to_ne_bytes());
    }

    /// Makes it quiet, however often it has rung.
    fn hush(&self) {
        // It can only fail because it is quiet.
        let _ = rustix::io::read(&self.event, &mut [0_u8; 8]);
    }
}

impl FileDescriptorBased for ThreadBell {
    fn file_descriptor(&self) -> &FileDescriptor {
        &self.descriptor
    }
}

impl SynchronousMultiplexing for ThreadBell {}

/// What one thread waits with; [`Bells::attach`] adds what it waits for.
#[derive(Debug)]
pub struct Bells(WaitSet<Ipc>);

impl Bells {
    /// Errors if the process has no descriptor left.
    pub fn new() -> Result<Self, WireError> {
        // Signals belong to the program, not to the transport.
        let set = WaitSetBuilder::new().signal_handling_mode(SignalHandlingMode::Disabled).create();
        set.map(Self).map_err(|cause| failed(&cause))
    }

    /// Waiting for bells of other processes and one of this process's threads.
    pub fn attach<'a>(
        &'a self,
        wakeups: impl IntoIterator<Item = &'a Wakeup>,
        thread: &'a ThreadBell,
    ) -> Result<Waiting<'a>, WireError> {
        let attach = |wakeup| match self.0.attach_notification(wakeup) {
            Ok(guard) => Ok((guard, wakeup)),
            Err(cause) => Err(failed(&cause)),
        };
        let wakeups = wakeups.into_iter().map(attach).collect::<Result<_, _>>()?;
        let in_process = self.0.attach_notification(thread).map_err(|cause| failed(&cause))?;
        Ok(Waiting { set: &self.0, wakeups, thread: (in_process, thread) })
    }
}

/// Bells that are attached.
pub struct Waiting<'a> {
    set: &'a WaitSet<Ipc>,
    wakeups: Vec<(WaitSetGuard<'a, 'a, Ipc>, &'a Wakeup)>,
    thread: (WaitSetGuard<'a, 'a, Ipc>, &'a ThreadBell),
}

impl Debug for Waiting<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Waiting").field("wakeups", &self.wakeups.len()).finish_non_exhaustive()
    }
}

impl Waiting<'_> {
    /// Sleeps until something has rung since the last call, at most for `longest` and an hour, rounded up to
    /// milliseconds. What a bell announces was there before it rang: look for all of it afterwards.
    pub fn wait(&self, longest: Duration) -> Result<(), WireError> {
        // A wakeup can have been rung while it was being hushed, which takes the ring but leaves it marked as rung: its
        // socket is then empty, and later rings are saved. Hushing it again finds the mark, unless another ring falls
        // into that moment, too: so nobody waits without a limit.
        let mut rung = 0;
        for (_, wakeup) in &self.wakeups {
            rung += hush(wakeup)?;
        }
        if rung > 0 {
            return Ok(());
        }
        let mut hushed = Ok(0);
        let rings = |id: WaitSetAttachmentId<Ipc>| {
            if id.has_event_from(&self.thread.0) {
                self.thread.1.hush();
            }
            if let Some((_, wakeup)) = self.wakeups.iter().find(|(guard, _)| id.has_event_from(guard)) {
                hushed = hush(wakeup);
            }
            CallbackProgression::Continue
        };
        // iceoryx2 counts milliseconds in 32 bits.
        let longest = longest.min(Duration::from_hours(1));
        self.set.wait_and_process_once_with_timeout(rings, longest).map_err(|cause| failed(&cause))?;
        hushed.map(|_| ())
    }
}

/// Clears a wakeup; returns the number of its rings.
fn hush(wakeup: &Wakeup) -> Result<u64, WireError> {
    match wakeup.try_wait(|_| {}) {
        Ok(rings) => Ok(rings),
        // Whoever handles the signal will do so; the ring is still there.
        Err(ListenerWaitError::InterruptSignal) => Ok(0),
        Err(cause) => Err(failed(&cause)),
    }
}

fn failed(cause: &dyn Debug) -> WireError {
    WireError::Wait(format!("{cause:?}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Wire, WireAddress, WireHost, WireShape};
    use proto::shares::Shares;
    use std::time::Instant;

    const LONG: Duration = Duration::from_secs(20);

    #[test]
    fn whichever_rings_ends_the_wait_and_a_quiet_set_waits_its_time() {
        let shape = WireShape { shares: Shares::of_one(2), environments_per_actor: 1 };
        let address = WireAddress::new(&format!("testbells{}", std::process::id()), 1);
        let host = WireHost::create(&address, shape).unwrap();
        {
            let learner = Wire::join(&address, shape, "learner-0").unwrap();
            let (observations, stage) = (learner.observations_wakeup(0).unwrap(), learner.stage_wakeup().unwrap());
            let (bells, thread) = (Bells::new().unwrap(), ThreadBell::new().unwrap());
            let waiting = bells.attach([&observations, &stage], &thread).unwrap();
            let waited = |longest: Duration| {
                let began = Instant::now();
                waiting.wait(longest).unwrap();
                began.elapsed()
            };
            let quiet = Duration::from_millis(30);
            assert!(waited(quiet) >= quiet);

            let actor = learner.observations_bell(1).unwrap();
            let announcer = host.wire().announcer().unwrap();
            for ring in [&|| assert!(actor.notify().is_ok()), &|| announcer.update().unwrap(), &|| thread.ring()]
                as [&dyn Fn(); 3]
            {
                // Twice is once; and it makes no difference whether somebody waits already.
                ring();
                ring();
                assert!(waited(LONG) < LONG);
                // A ring can wake it twice, but the set comes to rest.
                assert!((0..3).any(|_| waited(quiet) >= quiet));
            }
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    std::thread::sleep(quiet);
                    thread.ring();
                });
                assert!(waited(LONG) < LONG);
            });
        }
        drop(host);
        address.sweep().unwrap();
    }
}
