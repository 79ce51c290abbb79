//! `learner import`: a run's first checkpoint from weights of elsewhere. Started by `orchestrator import`, which has
//! made the run folder.

use super::lock::{self, Lock};
use super::machine;
use crate::agent::{Agent, OtherSign};
use crate::checkpoint::{Snapshot, Store, decode_tensors};
use crate::collector::{Boundary, ColumnMap};
use crate::import::{Naming, how_to_convert};
use crate::{device, import};
use anyhow::{Context, Result, bail};
use proto::checkpoint::Manifest;
use proto::config::{CarriedGoal, Config, NetworkConfig};
use proto::policy_file::BYTES_MOST;
use proto::run_folder::RunFolder;
use proto::trained::History;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What `learner import` is asked.
#[derive(Debug, Clone, clap::Args)]
pub struct ImportArguments {
    /// A state dict: AllenAct's, a checkpoint of a run, or weights by our names
    #[arg(long, value_name = "S.safetensors")]
    from: PathBuf,
    /// Run folder; its config.toml names the network
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
    /// Id that the run is to have
    #[arg(long, value_name = "ID", default_value = "")]
    run_id: String,
}

/// Writes the run's first checkpoint, and prints the destination of every weight.
pub fn import(arguments: &ImportArguments, mut output: impl Write) -> Result<()> {
    let ImportArguments { from, run, run_id } = arguments;
    let run = RunFolder::new(run);
    let config = Config::of_run(&run)?;
    let bytes = proto::bounded::read(from, BYTES_MOST).with_context(|| format!("cannot read {}", from.display()))?;
    let state_dict = decode_tensors(&bytes)
        .map_err(|cause| how_to_convert(from, &bytes).map_or_else(|| cause.into(), anyhow::Error::msg))
        .with_context(|| from.display().to_string())?;

    let _lock = Lock::take(&run.learner_lock(0), lock::PATIENCE, || false)?;
    let device = device::choose(&config.learner)?;
    let machine = machine::machine(device, config.learner);
    let store = Store::new((run.clone(), run_id), &config.stages, &config.to_toml(), machine, config.checkpoint.keep)
        .of_unmade();
    if let Some(loaded) = store.load()? {
        bail!("{} has begun: it holds {}", run.root().display(), loaded.path);
    }
    let mut agent = Agent::new(&config, device)?;
    let mut state = agent.state();
    let imported = import::import(&state_dict, config.episode.action_space, &mut state)
        .with_context(|| from.display().to_string())?;
    let sign = sign_of(Naming::of(&state_dict), from);
    if let Some(Sign { trained, .. }) = sign {
        OtherSign::refuse(trained, &config.network).with_context(|| from.display().to_string())?;
    }
    agent.load_state(&state)?;
    let snapshot = Snapshot {
        rollout: 0,
        frames: 0,
        agent: agent.state(),
        boundary: Boundary::start(ColumnMap::of(0, &config).columns()),
        weights: agent.weights_digest(),
    };
    let checkpoint = store.save(&snapshot, &History::default(), false)?;

    writeln!(output, "{} weights of {}", imported.taken, from.display())?;
    for (names, what) in [(&imported.fresh, "starts from the seed"), (&imported.left_out, "is left out")] {
        for name in names {
            writeln!(output, "{name} {what}")?;
        }
    }
    writeln!(output, "{}", assumed_goal(&config.network, sign))?;
    writeln!(output, "checkpoint: {checkpoint}")?;
    writeln!(output, "weights: {}", snapshot.weights)?;
    Ok(())
}

/// The sign of the goal vector that a file's weights were trained with.
#[derive(Debug, Clone, Copy)]
struct Sign {
    trained: CarriedGoal,
    whose: &'static str,
}

/// The goal's sign, if known. It is unknown for weights by our names without a checkpoint's manifest.
fn sign_of(naming: Naming, from: &Path) -> Option<Sign> {
    match naming {
        // Its sensor is object − goal.
        Naming::AllenAct => Some(Sign { trained: CarriedGoal::GoalToObject, whose: "AllenAct's" }),
        Naming::Checkpoint => {
            let manifest = Manifest::read(&from.with_extension("json")).ok()?;
            Some(Sign { trained: manifest.carried_goal, whose: "the checkpoint's" })
        }
        Naming::Ours => None,
    }
}

/// Which goal the weights are taken to have been trained on: their shapes are the same for all.
fn assumed_goal(network: &NetworkConfig, sign: Option<Sign>) -> String {
    let assumed = "weights do not tell";
    match network.sign_seen() {
        None => format!("the goal is taken to be cartesian (network.goal; {assumed})"),
        Some(carried) => format!(
            "the goal is taken to be polar (network.goal; {assumed}), {carried} while the target is held \
             (network.carried_goal; {})",
            sign.map_or(assumed, |sign| sign.whose)
        ),
    }
}
