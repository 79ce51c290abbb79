//! Why a learner stops before its budget is reached.

use anyhow::{Context, Result};
use proto::lifeline;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How often a deadline is looked at.
const LOOK: Duration = Duration::from_secs(1);

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

    /// Ends this process `patience` after it was noted, whatever else it is doing. A learner that waits for others in a
    /// sum on a GPU cannot look; without an orchestrator nobody else would end it.
    pub fn end_after(&self, patience: Duration) -> Result<()> {
        let gone = self.clone();
        let watch = move || {
            let mut since = None;
            loop {
                std::thread::sleep(LOOK);
                if gone.is_set() && since.get_or_insert_with(Instant::now).elapsed() >= patience {
                    tracing::error!("has not saved within {} s: ends", patience.as_secs());
                    std::process::exit(1);
                }
            }
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
