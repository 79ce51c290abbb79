//! Why a learner stops before its budget is reached.

use anyhow::{Context, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use wire::lifeline;

/// How often a deadline is looked at.
const LOOK: Duration = Duration::from_millis(250);

/// Why to save and leave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The orchestrator announced it.
    Announced,
    /// The orchestrator is gone: its lifeline or the pipe of events has closed.
    OrchestratorGone,
}

/// Set once, by any thread, when the orchestrator is gone.
#[derive(Debug, Clone, Default)]
pub struct OrchestratorGone(Arc<AtomicBool>);

impl OrchestratorGone {
    /// Set when standard input closes, if that is a lifeline; else by nobody but the caller.
    pub fn watched(lifeline: bool) -> Result<Self> {
        let gone = Self::default();
        if lifeline {
            let watched = gone.clone();
            lifeline::hold(move || watched.set()).context("cannot watch the lifeline")?;
        }
        Ok(gone)
    }

    /// Calls `end` on a thread of its own `patience` after it was noted, if this process still runs then. A learner that
    /// waits for others in a sum on a GPU cannot look; without an orchestrator nobody else would end it.
    pub fn end_after(&self, patience: Duration, end: impl FnOnce() + Send + 'static) -> Result<()> {
        let gone = self.clone();
        let watch = move || {
            while !gone.is_set() {
                std::thread::sleep(LOOK);
            }
            std::thread::sleep(patience);
            end();
        };
        std::thread::Builder::new().name("deadline".into()).spawn(watch).context("cannot start a thread")?;
        Ok(())
    }

    /// Notes it.
    pub fn set(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// True once it was noted.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{RecvTimeoutError, channel};

    #[test]
    fn only_who_has_no_orchestrator_is_ended() {
        let gone = OrchestratorGone::default();
        let (sender, ended) = channel();
        gone.end_after(Duration::ZERO, move || sender.send(()).unwrap()).unwrap();
        assert_eq!(ended.recv_timeout(2 * LOOK), Err(RecvTimeoutError::Timeout));
        gone.set();
        assert_eq!(ended.recv_timeout(Duration::from_secs(10)), Ok(()));
    }
}
