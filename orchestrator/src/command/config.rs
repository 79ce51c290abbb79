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
    let asked = match &args.preset {
        Some(preset) => Some(preset.clone()),
        None => args.overrides.preset_in_file()?,
    };
    let preset = asked.unwrap_or_else(|| {
        // Without a learner that starts there is no CUDA either.
        Tools::find().map_or("demo", |tools| default_preset(&tools.torch)).to_owned()
    });
    terminal::out(args.overrides.resolve(&preset)?.to_toml().trim_end());
    Ok(())
}
