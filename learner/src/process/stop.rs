//! Why a learner stops before its budget is reached.

use anyhow::{Context, Result};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use wire::{Bell, lifeline};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    Announced,
    /// The orchestrator is gone: its lifeline or the pipe of events has closed.
    OrchestratorGone,
}

/// Set once, by any thread, when the orchestrator is gone. Whoever waits then wakes.
#[derive(Debug, Clone)]
pub struct OrchestratorGone(Arc<Noted>);

#[derive(Debug)]
struct Noted {
    gone: OnceLock<()>,
    /// Of who is to be woken then.
    bell: OnceLock<Bell>,
}

impl OrchestratorGone {
    /// Set by nobody but the caller.
    pub fn new() -> Self {
        Self(Arc::new(Noted { gone: OnceLock::new(), bell: OnceLock::new() }))
    }

    /// Set when standard input closes, if it is a lifeline; otherwise only by the caller.
    pub fn watched(lifeline: bool) -> Result<Self> {
        let gone = Self::new();
        if lifeline {
            let watched = gone.clone();
            lifeline::hold(move || watched.set()).context("cannot watch the lifeline")?;
        }
        Ok(gone)
    }

    /// Calls `end` on a thread of its own `patience` after it was noted, if this process still runs then. A learner
    /// blocked in an all-reduce on a GPU cannot notice it; without an orchestrator nobody else would end it.
    pub fn end_after(&self, patience: Duration, end: impl FnOnce() + Send + 'static) -> Result<()> {
        let noted = Arc::clone(&self.0);
        let watch = move || {
            noted.gone.wait();
            // The time itself is what is waited for.
            std::thread::sleep(patience);
            end();
        };
        std::thread::Builder::new().name("deadline".into()).spawn(watch).context("cannot start a thread")?;
        Ok(())
    }

    /// Starts a thread that calls `end` when the orchestrator is gone, unless the returned guard was dropped before. For
    /// a wait that nothing else ends, in a process that has nothing to save.
    pub fn end_while_held(&self, end: impl FnOnce() + Send + 'static) -> Result<Arc<()>> {
        let held = Arc::new(());
        let (noted, is_held) = (Arc::clone(&self.0), Arc::downgrade(&held));
        let watch = move || {
            noted.gone.wait();
            if is_held.upgrade().is_some() {
                end();
            }
        };
        std::thread::Builder::new().name("joining".into()).spawn(watch).context("cannot start a thread")?;
        Ok(held)
    }

    pub fn set(&self) {
        let _ = self.0.gone.set(());
        self.0.bell.get().into_iter().for_each(Bell::ring);
    }

    pub fn is_set(&self) -> bool {
        self.0.gone.get().is_some()
    }

    /// Rings this bell when it is noted, at once if it was. The first one that is given counts.
    pub fn wakes(&self, bell: Bell) {
        let bell = self.0.bell.get_or_init(|| bell);
        // It may have been noted before there was a bell.
        if self.is_set() {
            bell.ring();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::shares::Shares;
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::time::Instant;
    use wire::{Sleeper, WireAddress, WireHost, WireShape};

    #[test]
    fn only_who_has_no_orchestrator_is_ended() {
        let gone = OrchestratorGone::new();
        let (sender, ended) = channel();
        gone.end_after(Duration::ZERO, move || sender.send(()).unwrap()).unwrap();
        assert_eq!(ended.recv_timeout(Duration::from_millis(100)), Err(RecvTimeoutError::Timeout));
        gone.set();
        assert_eq!(ended.recv_timeout(Duration::from_secs(10)), Ok(()));
    }

    #[test]
    fn whoever_sleeps_wakes_whether_it_was_noted_before_there_was_a_bell_or_after() {
        let shape = WireShape::new(Shares::of_one(1), 1, proto::config::Config::default().spec());
        let address = WireAddress::new(&format!("testgone{}", std::process::id()), 1);
        let host = WireHost::create(&address, shape).unwrap();
        {
            let bells = host.wire().bells();
            let wakes = |order: [&dyn Fn(); 2]| {
                let wakeup = bells.wakeup(Sleeper::Learner(0));
                wakeup.wait(Duration::ZERO);
                let began = Instant::now();
                for step in order {
                    step();
                }
                wakeup.wait(Duration::from_secs(20)) && began.elapsed() < Duration::from_secs(10)
            };
            for set_first in [true, false] {
                let gone = OrchestratorGone::new();
                let (set, given) = (|| gone.set(), || gone.wakes(bells.bell([Sleeper::Learner(0)])));
                assert!(wakes(if set_first { [&set, &given] } else { [&given, &set] }), "{set_first}");
            }
        }
        drop(host);
        address.sweep().unwrap();
    }

    #[test]
    fn who_waits_for_others_is_ended_and_who_has_joined_them_is_not() {
        let gone = OrchestratorGone::new();
        let (sender, ended) = channel();
        let end = |name| {
            let sender = sender.clone();
            move || sender.send(name).unwrap()
        };
        let waits = gone.end_while_held(end("waits")).unwrap();
        drop(gone.end_while_held(end("has joined")).unwrap());
        gone.set();
        assert_eq!(ended.recv_timeout(Duration::from_secs(10)), Ok("waits"));
        assert_eq!(ended.recv_timeout(Duration::from_millis(100)), Err(RecvTimeoutError::Timeout));
        drop(waits);
    }
}
