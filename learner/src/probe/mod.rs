//! `learner probe`: network, losses and gradients on a batch from a file, so that anyone can compare them with an
//! implementation of their own. The formats are in `docs/probe.md`.
//!
//! What runs is what training runs with that configuration on that device: the first epoch of an update
//! ([`crate::ppo::Update::gradient`]), without its optimiser step.

mod architecture;
mod batch;
mod first_epoch;

pub use architecture::fit;

use crate::agent::{MODEL, weights_of};
use crate::auxiliary::{Auxiliary, Sizes};
use crate::checkpoint::{TensorsError, decode_tensors, encode_tensors};
use crate::declared::declare;
use crate::device;
use crate::import::how_to_convert;
use crate::network::Network;
use crate::ppo::running::{Running, STATISTICS};
use anyhow::{Context, Result, anyhow};
use batch::Batch;
use first_epoch::{Probed, probe};
use proto::config::{Config, DeviceChoice, LearnerConfig, Setting};
use proto::run_folder::write_atomically;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use tch::{Kind, Tensor};

/// What `learner probe` is asked.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
A batch is a rollout of T steps and N environments, the dump of a non-finite update is one, too (--weights and --batch the
same file). Written are the policy's table, values, beliefs, advantages, returns, each loss and figure by its name in the
metrics, and gradient.NAME of every weight. All names, shapes and formulas: docs/probe.md.")]
pub struct Arguments {
    /// Weights by PyTorch's module paths, or a checkpoint of a run: which network they are of is read from them
    #[arg(long, value_name = "W.safetensors")]
    weights: PathBuf,
    /// The batch
    #[arg(long, value_name = "B.safetensors")]
    batch: PathBuf,
    /// What is found is written here
    #[arg(long, value_name = "O.safetensors")]
    out: PathBuf,
    /// Named configuration for what weights do not show: constants of PPO, goal coordinates, the encoder's precision
    #[arg(long, value_name = "P", default_value = "paper")]
    preset: String,
    /// TOML file whose keys replace the preset's
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One key of the configuration over both, for example network.goal=cartesian; repeat it for more
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<Setting>,
    /// Declaration of a task that is not built in: the task.toml of a run
    #[arg(long, value_name = "TASK.toml", value_parser = declare)]
    task: Option<Setting>,
    /// Where to compute: cpu, cuda or auto
    #[arg(long, value_name = "D", default_value = "cpu", value_parser = device::parse_choice)]
    device: DeviceChoice,
}

/// Runs the command: writes the file and prints every figure, a line each.
pub fn run(arguments: &Arguments, mut output: impl Write) -> Result<()> {
    let settings: Vec<Setting> = arguments.task.iter().chain(&arguments.set).cloned().collect();
    let mut config = Config::resolve_set(&arguments.preset, arguments.config.as_deref(), &settings)?;
    let device = device::choose(&LearnerConfig { device: arguments.device, ..config.learner })?;
    let saved = read(&arguments.weights)?;
    // The text alone: it has that of its source in it.
    let at = |path: &Path, cause: TensorsError| anyhow!("{}: {cause}", path.display());
    let in_weights = |cause| at(&arguments.weights, cause);
    let weights = model(&saved);
    fit(&mut config, &weights).map_err(in_weights)?;
    // What weights are of may be more than can be.
    config.validate()?;

    let actions = config.policy_actions().len() as i64;
    let (mut network, auxiliary) = Network::new(&config, device, |layout, hidden| {
        Auxiliary::new(&config.auxiliary, layout, Sizes { hidden, actions })
    });
    network.choose_precision(config.learner.encoder_precision)?;
    tracing::info!("computes on {}", device::describe(device, network.is_in_bfloat16()));
    network.parameters.load(&weights).map_err(|unfit| in_weights(unfit.into()))?;
    let batch = Batch::read(&read(&arguments.batch)?, &config, &network);
    let batch = batch.map_err(|cause| at(&arguments.batch, cause))?;

    let running = Running::before(&config).found_in(&saved).map_err(|unfit| in_weights(unfit.into()))?;
    let Probed { tensors, figures } = probe(&config, &network, &auxiliary, running.reward_scale(), &batch)?;
    let bytes = encode_tensors(&tensors).map_err(|cause| at(&arguments.out, cause))?;
    write_atomically(&arguments.out, &bytes).with_context(|| format!("cannot write {}", arguments.out.display()))?;
    for (name, value) in figures {
        writeln!(output, "{name} {value}").context("cannot print")?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<BTreeMap<String, Tensor>> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    decode_tensors(&bytes).map_err(|cause| {
        let problem = how_to_convert(path, &bytes).unwrap_or_else(|| cause.to_string());
        anyhow!("{}: {problem}", path.display())
    })
}

/// The weights among a file's tensors: a checkpoint's, or else all but statistics. Those of a policy file may have 16
/// bits: they are widened, as an evaluation does.
fn model(tensors: &BTreeMap<String, Tensor>) -> BTreeMap<String, Tensor> {
    let weights = weights_of(tensors, MODEL);
    let weights = if weights.is_empty() { weights_of(tensors, "") } else { weights };
    let is_weight = |(name, _): &(String, Tensor)| !name.starts_with(STATISTICS);
    let widened = |tensor: Tensor| if tensor.kind() == Kind::Half { tensor.to_kind(Kind::Float) } else { tensor };
    weights.into_iter().filter(is_weight).map(|(name, tensor)| (name, widened(tensor))).collect()
}
