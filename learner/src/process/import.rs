//! `learner import`: a run's first checkpoint from weights of elsewhere. Started by `orchestrator import`, which has
//! made the run folder.

use super::lock::{self, Lock};
use super::{layout, machine};
use crate::agent::Agent;
use crate::checkpoint::{Snapshot, Store, decode_tensors};
use crate::collector::Boundary;
use crate::{device, import};
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::run_folder::RunFolder;
use std::io::Write;
use std::path::PathBuf;

/// What `learner import` is asked.
#[derive(Debug, Clone, clap::Args)]
pub struct ImportArguments {
    /// A state dict: AllenAct's, a checkpoint of a run, or weights by our names
    #[arg(long, value_name = "S.safetensors")]
    from: PathBuf,
    /// Run folder; its config.toml says which network
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
}

/// Writes the checkpoint that the run begins with, and prints what became of which weight.
pub fn import(arguments: &ImportArguments, mut output: impl Write) -> Result<()> {
    let ImportArguments { from, run } = arguments;
    let run = RunFolder::new(run);
    let config = Config::of_run(&run)?;
    let bytes = std::fs::read(from).with_context(|| format!("cannot read {}", from.display()))?;
    let state_dict = decode_tensors(&bytes).with_context(|| from.display().to_string())?;

    let _lock = Lock::take(&run.learner_lock(0), lock::PATIENCE, || false)?;
    let device = device::choose(config.learner.device, config.learner.cpu, config.learner.threads)?;
    let machine = machine::machine(device, config.learner.threads, config.learner.count);
    let store = Store::new(run.clone(), &config.stages, &config.to_toml(), machine, config.checkpoint.keep);
    if let Some(loaded) = store.load()? {
        bail!("{} has begun: it holds {}", run.root().display(), loaded.path);
    }
    let mut agent = Agent::new(&config, device)?;
    let mut state = agent.state();
    let imported = import::import(&state_dict, config.episode.action_space, &mut state)
        .with_context(|| from.display().to_string())?;
    agent.load_state(&state)?;
    let snapshot = Snapshot {
        rollout: 0,
        frames: 0,
        agent: agent.state(),
        boundary: Boundary::start(layout(0, &config).columns()),
        weights: agent.weights_digest(),
    };
    let checkpoint = store.save(&snapshot)?;

    writeln!(output, "{} weights of {}", imported.taken, from.display())?;
    for (names, what) in [(&imported.fresh, "starts from the seed"), (&imported.left_out, "is left out")] {
        for name in names {
            writeln!(output, "{name} {what}")?;
        }
    }
    writeln!(output, "checkpoint: {checkpoint}")?;
    writeln!(output, "weights: {}", snapshot.weights)?;
    Ok(())
}
