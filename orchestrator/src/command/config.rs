use super::overrides::{Overrides, default_preset};
use super::up::needs_environment;
use crate::output::terminal;
use crate::preflight::programs::Tools;
use crate::run::identity::{Identity, perhaps};
use crate::wrong::{demand, demand_folder, reject};
use anyhow::{Context, Result};
use proto::config::Config;
use proto::run_folder::{RunFolder, write_atomically};
use std::path::{Path, PathBuf};

/// Print the effective configuration as TOML, every default included
///
/// The output is itself a valid configuration file. It is, later over earlier: the preset, --config, --set, the other
/// flags. With --of it is what a run was saved under.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator config paper
  orchestrator config demo --config mine.toml --frames 20000 --out all.toml
  orchestrator config demo --set ppo.epochs=2 --json | jq .ppo
  # that file is gone, or nobody understands it any more
  orchestrator config --of runs/a --out runs/a/config.toml")]
pub struct ConfigArgs {
    /// Preset [default: the one that `up` would take]
    #[arg(value_name = "PRESET")]
    preset: Option<String>,
    /// The same, as other commands take it
    #[arg(long = "preset", value_name = "P", conflicts_with = "preset")]
    named: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
    /// The configuration that the newest checkpoint of this run was saved under
    #[arg(long, value_name = "RUN", conflicts_with_all = ["preset", "named", "Overrides"])]
    of: Option<PathBuf>,
    /// Write it to this file instead, whole or not at all; a file that is there is replaced
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    out: Option<PathBuf>,
    /// Print one JSON object instead
    #[arg(long)]
    json: bool,
}

pub fn run(args: &ConfigArgs) -> Result<()> {
    let config = match &args.of {
        Some(run) if !run.exists() => reject!("{} does not exist{}", run.display(), perhaps(run)),
        Some(run) => {
            let folder = RunFolder::new(run);
            let saved = Config::saved_under(&folder);
            if saved.is_none() {
                Identity::read(&folder)?;
            }
            saved.with_context(|| {
                format!("{} has no checkpoint that holds a configuration which this version reads", run.display())
            })?
        }
        None => configured(args)?,
    };
    match &args.out {
        Some(file) => write(file, &config)?,
        None if args.json => terminal::out(&serde_json::to_string(&config)?),
        None => terminal::out(config.to_toml().trim_end()),
    }
    if needs_environment(&config.preset, &config) {
        terminal::note("with `up --env` the task is the environment's, without kitchens, simulation and encoder");
    }
    Ok(())
}

fn write(file: &Path, config: &Config) -> Result<()> {
    // What is written whole takes the place of what was there: not that of a folder, or of /dev/stdout.
    let other = std::fs::metadata(file).is_ok_and(|found| !found.is_file());
    demand!(!other, "{} is no file: name another one with --out", file.display());
    demand_folder(file)?;
    write_atomically(file, config.to_toml().as_bytes()).with_context(|| format!("cannot write {}", file.display()))
}

fn configured(args: &ConfigArgs) -> Result<Config> {
    // Without a learner that starts there is no CUDA either.
    let default = || Ok(Tools::find().map_or("demo", |tools| default_preset(&tools.torch)));
    let preset = args.overrides.preset(args.preset.as_deref().or(args.named.as_deref()), default)?;
    args.overrides.resolve(&preset)
}
