//! `orchestrator config`: the effective configuration.

use super::overrides::{Overrides, default_preset};
use crate::session::Tools;
use crate::terminal;
use anyhow::Result;

/// Print the effective configuration as TOML, every default included
///
/// The output is itself a valid configuration file.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator config paper
  orchestrator config demo --config mine.toml --frames 20000 > effective.toml")]
pub struct ConfigArgs {
    /// Preset [default: the one that `up` would take]
    #[arg(value_name = "PRESET")]
    preset: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
}

/// Runs the command.
pub fn run(args: &ConfigArgs) -> Result<()> {
    // Without a learner that starts there is no CUDA either.
    let default = || Ok(Tools::find().map_or("demo", |tools| default_preset(&tools.torch)));
    let preset = args.overrides.preset(args.preset.as_deref(), default)?;
    terminal::out(args.overrides.resolve(&preset)?.to_toml().trim_end());
    Ok(())
}
