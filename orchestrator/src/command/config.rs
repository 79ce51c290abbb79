//! `orchestrator config`: the effective configuration.

use super::overrides::{Overrides, default_preset};
use crate::preflight::tools::Tools;
use crate::showing::terminal;
use anyhow::Result;

/// Print the effective configuration as TOML, every default included
///
/// The output is itself a valid configuration file. It is, later over earlier: the preset, --config, --set, the other
/// flags.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator config paper
  orchestrator config demo --config mine.toml --frames 20000 > effective.toml
  orchestrator config demo --set ppo.epochs=2 --json | jq .ppo")]
pub struct ConfigArgs {
    /// Preset [default: the one that `up` would take]
    #[arg(value_name = "PRESET")]
    preset: Option<String>,
    /// The same, as other commands take it
    #[arg(long = "preset", value_name = "P", conflicts_with = "preset")]
    named: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
    /// Print one JSON object instead
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &ConfigArgs) -> Result<()> {
    // Without a learner that starts there is no CUDA either.
    let default = || Ok(Tools::find().map_or("demo", |tools| default_preset(&tools.torch)));
    let preset = args.overrides.preset(args.preset.as_deref().or(args.named.as_deref()), default)?;
    let config = args.overrides.resolve(&preset)?;
    let text = if args.json { serde_json::to_string(&config)? } else { config.to_toml() };
    terminal::out(text.trim_end());
    Ok(())
}
