//! How many processes meet, and what their records look like.

use proto::config::Config;
use proto::shares::Shares;
use proto::task::{LINE_BYTES, Spec};

/// How many processes and environments share one machine's services, and the layout of their records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireShape {
    /// Actor processes, divided among learners.
    pub shares: Shares,
    pub environments_per_actor: u32,
    /// Cache lines of a record.
    pub record_lines: usize,
    /// [`Spec::layout_hash`] of the task.
    pub layout_hash: u64,
}

impl WireShape {
    /// The shape of a configuration's processes.
    pub fn of(config: &Config) -> Self {
        Self::new(config.shares(), config.actors.environments_per_actor, config.spec())
    }

    /// The shape of so many processes at a task.
    pub fn new(shares: Shares, environments_per_actor: u32, task: &Spec) -> Self {
        let record_lines = task.layout().bytes / LINE_BYTES;
        Self { shares, environments_per_actor, record_lines, layout_hash: task.layout_hash() }
    }

    /// Cache lines of a sample of so many records.
    pub fn lines(self, records: usize) -> usize {
        records * self.record_lines
    }

    /// Environments of an actor's larger half.
    pub(crate) fn half(self) -> usize {
        crate::message::Halves::of(self.environments_per_actor).range(0).len()
    }
}
