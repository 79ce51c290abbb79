//! Without a subcommand: one rollout actor of a run.

use actor::process;
use anyhow::{Context, Result};
use std::path::PathBuf;
use wire::{WireAddress, lifeline};

/// Which actor, of which run.
#[derive(Debug, clap::Args)]
pub struct RolloutArgs {
    /// Number among the run's actors, from 0.
    #[arg(long, required = true, value_name = "N")]
    actor: Option<u32>,
    /// Where the run's shared-memory services are.
    #[arg(long, required = true, value_name = "PREFIX@FOLDER")]
    wire: Option<WireAddress>,
    /// The run's effective configuration.
    #[arg(long, required = true, value_name = "RUN/config.toml")]
    config: Option<PathBuf>,
    /// How often this actor has been started in this incarnation of the run.
    #[arg(long, default_value_t = 1, value_name = "N")]
    incarnation: u32,
    /// Exit when standard input closes, and leave Ctrl-C to whoever holds its other end.
    #[arg(long)]
    lifeline: bool,
}

impl RolloutArgs {
    pub fn run(self) -> Result<()> {
        if self.lifeline {
            // Leaves no clean-up undone: what a process holds in shared memory is swept by the next orchestrator.
            lifeline::hold(|| std::process::exit(0)).context("cannot watch standard input")?;
        }
        let settings = process::Settings {
            actor: self.actor.context("--actor is missing")?,
            incarnation: self.incarnation,
            wire: self.wire.context("--wire is missing")?,
            config: self.config.context("--config is missing")?,
        };
        match process::run(&settings)? {}
    }
}
