//! Why a learner stops before its budget is reached.

use anyhow::{Context, Result};
use proto::lifeline;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

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

    /// Notes it.
    pub fn set(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// True once it was noted.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}
