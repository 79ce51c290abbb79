use crate::environment::consent;
use crate::output::terminal;
use crate::run::identity::Identity;
use anyhow::{Result, bail};
use proto::config::{Config, EnvironmentConfig};
use proto::run_folder::RunFolder;
use std::path::PathBuf;

/// Allow the command that simulates a run's environments
///
/// A run folder can come from anybody. So `resume`, `replay` and the others start its command only if you have named it
/// on a command line of `up` before, or allow it here. Look at it first: it can do whatever you can.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator allow runs/a-friends-run")]
pub struct AllowArgs {
    /// Run folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
}

pub fn run(args: &AllowArgs) -> Result<()> {
    Identity::read(&RunFolder::new(&args.run))?;
    let config = Config::of_run(&RunFolder::new(&args.run))?;
    let Some(EnvironmentConfig { command, .. }) = &config.environment else {
        bail!("{} has built-in environments: there is nothing to allow", args.run.display())
    };
    consent::allow(command)?;
    terminal::out(&format!("allowed: {}", consent::shown(command)));
    Ok(())
}
