//! How many processes meet.

use proto::config::Config;
use proto::shares::Shares;

/// How many processes and environments share one machine's services.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireShape {
    /// Actor processes, divided among learners.
    pub shares: Shares,
    pub environments_per_actor: u32,
}

impl WireShape {
    /// The shape of a configuration's processes.
    pub fn of(config: &Config) -> Self {
        Self { shares: config.shares(), environments_per_actor: config.actors.environments_per_actor }
    }
}
