//! How many processes meet, and what their records look like.

use proto::config::Config;
use proto::episode::MAX_EPISODE_STEPS;
use proto::shares::Shares;
use proto::task::{LINE_BYTES, Spec};

/// How many processes and environments share one machine's services, and the layout of their records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireShape {
    pub shares: Shares,
    pub environments_per_actor: u32,
    pub record_lines: usize,
    pub layout_hash: u64,
    pub max_steps: u32,
    pub action_bytes: usize,
    /// Bytes of a snapshot at most; 0 of a task without.
    pub snapshot_bytes: usize,
}

impl WireShape {
    pub fn of(config: &Config) -> Self {
        Self::with_actors(config, config.shares())
    }

    pub fn with_actors(config: &Config, shares: Shares) -> Self {
        let any = Self::new(shares, config.actors.environments_per_actor, config.spec());
        Self { max_steps: config.episode.max_steps, ..any }
    }

    /// The shape of so many processes at a task whose episodes are as long as any can be.
    pub fn new(shares: Shares, environments_per_actor: u32, task: &Spec) -> Self {
        let record_lines = task.layout().bytes / LINE_BYTES;
        Self {
            shares,
            environments_per_actor,
            record_lines,
            layout_hash: task.layout_hash(),
            action_bytes: task.actions.bytes(),
            max_steps: MAX_EPISODE_STEPS as u32,
            snapshot_bytes: task.layout().snapshot.len(),
        }
    }

    pub fn lines(self, records: usize) -> usize {
        records * self.record_lines
    }

    /// Environments of an actor's larger half.
    pub(crate) fn half(self) -> usize {
        crate::message::Halves::of(self.environments_per_actor).range(0).len()
    }
}
