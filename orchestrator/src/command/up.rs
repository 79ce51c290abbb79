//! `orchestrator up`: a new run.

use super::overrides::{Overrides, default_preset};
use crate::evaluation::subject::{Found, find, network_differences, read_manifest};
use crate::format;
use crate::identity::{Held, Identity, RunLock, holder, is_evaluation, unix_now};
use crate::scenes;
use crate::session::{Session, Tools, preflight};
use crate::terminal;
use anyhow::{Context, Result, bail};
use proto::checkpoint::Manifest;
use proto::config::{Config, FromConfig};
use proto::run_folder::{RunFolder, write_atomically};
use proto::stage::total_frames;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Start a new run: learner, actors, recording
///
/// Ctrl-C saves and stops everything (`orchestrator resume RUN` goes on from there, exit status 0); a second Ctrl-C ends
/// it at once (exit status 130). The last two lines on standard output are `weights: ` and the SHA-256 of the weights,
/// `frames: ` and the number of frames trained on.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator up                                  the demonstration on a CPU, the two-stage curriculum on a GPU
  orchestrator up --preset paper --seed 2          the paper's exact shape
  orchestrator up --preset demo --actors 4 --envs-per-actor 2 --frames 20000 --run runs/small
  orchestrator up --preset two-stage --actors 38 --learners 2               a learner on each of two GPUs
  orchestrator up --config mine.toml               some settings of your own over the default preset
  orchestrator up --preset demo --set ppo.learning_rate=1e-3 --set network.encoder=resnet      single settings
  orchestrator up --preset disturb-stage2-25m --from runs/stage-1           stage II as a run of its own

The configuration, later over earlier: the preset, --config, --set, the other flags. `orchestrator config` prints it.")]
pub struct UpArgs {
    /// Named configuration (`orchestrator presets`) [default: demo without a CUDA device, two-stage with one]
    #[arg(long, value_name = "P")]
    preset: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
    /// Begin with the weights of another run: its folder (the newest checkpoint), RUN/best, or a checkpoint's manifest.
    /// Optimiser, environments and frame count begin anew; the networks must be the same
    #[arg(long, value_name = "RUN|CHECKPOINT")]
    from: Option<PathBuf>,
    /// Run folder, new or empty [default: runs/TIME-PRESET-SEED]
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &UpArgs) -> Result<ExitCode> {
    // What the user wrote is judged before anything is started.
    if let Some(run) = &args.run {
        check_free(&RunFolder::new(run))?;
    }
    let mut found = None;
    let default = || Ok(default_preset(&found.insert(Tools::find()?).torch));
    let mut config = args.overrides.resolve(&args.overrides.preset(args.preset.as_deref(), default)?)?;
    if let Some(from) = &args.from {
        config.from = Some(begin_from(&find(from)?, &config)?);
    }
    // The default was needed: nobody asked for a preset, on the command line or in a file.
    let asked = found.is_none();
    let tools = match found {
        Some(tools) => tools,
        None => Tools::find()?,
    };
    let folder = RunFolder::new(args.run.clone().unwrap_or_else(|| default_folder(&config)));
    preflight(&config, &folder, &tools)?;
    scenes::check(&config)?;
    introduce(&config, asked);
    if let Some(FromConfig { checkpoint, frames, .. }) = &config.from {
        terminal::note(&format!("begins with the weights of {checkpoint}, {} frames", format::count(*frames)));
    }
    let (identity, lock) = create(&folder, &mut config)?;
    Session { folder, config, identity, lock, tools }.run()
}

/// Whose weights the run begins with; refused where the networks differ.
fn begin_from(found: &Found, config: &Config) -> Result<FromConfig> {
    let differences = network_differences(&found.config, config)?;
    if !differences.is_empty() {
        bail!("{} holds another network: {}", found.manifest.display(), differences.join("; "));
    }
    let Manifest { frames, weights, .. } = read_manifest(&found.manifest)?;
    let checkpoint = found.manifest.to_str().context("the checkpoint has a name that is not text")?.to_owned();
    Ok(FromConfig { checkpoint, frames, weights })
}

fn default_folder(config: &Config) -> PathBuf {
    Path::new("runs").join(format!("{}-{}-{}", format::timestamp(unix_now()), config.preset, config.seed))
}

/// Refuses a folder that holds anything.
pub fn check_free(folder: &RunFolder) -> Result<()> {
    let root = folder.root().display();
    match std::fs::read_dir(folder.root()) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error).with_context(|| format!("run folder {root}")),
        Ok(mut entries) => {
            if entries.next().is_none() {
                return Ok(());
            }
        }
    }
    if let Held::By(holder) = holder(folder)? {
        bail!("run folder {root} is already in use: pid {} on {} runs it", holder.pid, holder.host);
    }
    if folder.identity().exists() && is_evaluation(folder) {
        bail!("folder {root} is already in use: it holds an evaluation");
    }
    if folder.identity().exists() {
        bail!("run folder {root} is already in use: it holds a run, and `orchestrator resume {root}` goes on with it");
    }
    bail!("run folder {root} is not empty, and it is no run: choose another with --run")
}

/// Makes the folder and everything that is in it before the first process starts.
fn create(folder: &RunFolder, config: &mut Config) -> Result<(Identity, RunLock)> {
    create_with(folder, config, &[folder.checkpoints(), folder.recordings()])
}

/// The same for a folder that has these folders besides its logs.
pub fn create_with(folder: &RunFolder, config: &mut Config, folders: &[PathBuf]) -> Result<(Identity, RunLock)> {
    let lock = prepare(folder, config, folders)?;
    let identity = Identity::new()?;
    identity.write(folder)?;
    Ok((identity, lock))
}

/// Makes the folder, these folders in it, and everything else but the identity, which makes it a run.
pub fn prepare(folder: &RunFolder, config: &mut Config, folders: &[PathBuf]) -> Result<RunLock> {
    check_free(folder)?;
    for path in [folder.root().to_path_buf(), folder.logs()].iter().chain(folders) {
        std::fs::create_dir_all(path).with_context(|| format!("cannot create {}", path.display()))?;
    }
    let lock = RunLock::acquire(folder)?;
    if folder.identity().exists() {
        bail!("run folder {} is already in use: another orchestrator was faster", folder.root().display());
    }
    scenes::keep(config, folder)?;
    write_atomically(&folder.config(), config.to_toml().as_bytes())
        .with_context(|| format!("cannot write {}", folder.config().display()))?;
    Ok(lock)
}

fn introduce(config: &Config, asked: bool) {
    let frames = format::count(total_frames(&config.stages));
    if config.preset == "demo" {
        let why = if asked { "" } else { "No CUDA device was found. " };
        terminal::note(&format!(
            "{why}This is a demonstration, not the paper's experiment: a small encoder, episodes that begin near their\n\
             target, {frames} frames instead of 45 000 000. The full run is `orchestrator up --preset paper` (19\n\
             environments, the paper's exact shape) or `orchestrator up --preset two-stage` on a machine with a GPU."
        ));
    } else if !asked {
        terminal::note(&format!("preset {}: {frames} frames", config.preset));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_new_or_empty_folder_is_taken() {
        let temporary = tempfile::tempdir().unwrap();
        let mut config = Config::resolve("demo", None).unwrap();
        let new = RunFolder::new(temporary.path().join("a/b"));
        check_free(&new).unwrap();
        let (identity, lock) = create(&new, &mut config).unwrap();
        assert_eq!(Identity::read(&new).unwrap(), identity);
        let text = std::fs::read_to_string(new.config()).unwrap();
        assert_eq!(Config::from_toml(&text, "config.toml").unwrap(), config);
        let message = check_free(&new).unwrap_err().to_string();
        assert!(message.contains("already in use") && message.contains("resume"), "{message}");
        drop(lock);

        let foreign = RunFolder::new(temporary.path());
        let message = check_free(&foreign).unwrap_err().to_string();
        assert!(message.contains("not empty"), "{message}");
    }
}
