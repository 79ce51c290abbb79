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
use crate::device::{self, DeviceError};
use crate::import::how_to_convert;
use crate::network::{Network, PrecisionError};
use crate::ppo::UpdateError;
use crate::ppo::running::{Running, STATISTICS};
use batch::Batch;
use first_epoch::{Probed, probe};
use proto::config::{Config, ConfigError, DeviceChoice, LearnerConfig, Setting};
use proto::run_folder::write_atomically;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use tch::{Kind, Tensor};

/// What `learner probe` is asked.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
A batch is a rollout of T steps and N environments (bool may be u8, i64 may be any integer type):
  frames           i16, i32 or f32 (T, N, S, S)  depth, millimetres; S = 224, or 224 / input_pool for pooled ones
  goal_m           f32 (T, N, 3)   goal vector in the robot's frame (x right, y up, z ahead), metres, of the sign that the
                                   weights were trained with (network.carried_goal); or instead of it
  goal             f32 (T, N, 3)   what the network is given for it
  numbers          f32 (T, N, K)   in a task without a frame instead of frames and goal: its observations, one behind the
                                   other, whole numbers as one-hot; behind them, as behind a goal, those of the critic alone
  previous_action  i64 (T, N)      0 = none yet, else 1 + action
  episode_start    bool (T, N)     the belief is zeroed before this observation
  action           i64 (T, N)      action taken; of several choices i64 (T, N, K), of a box f32 (T, N, K), unclipped
  log_prob, value  f32 (T, N)      its log-probability, and the observation's value, when it was taken
  reward           f32 (T, N)
  ended            bool (T, N)     the action ended the episode
  time_limit       bool (T, N)     it ended by the step limit
  last_value       f32 (T, N)      value of what was seen last then; NaN where it is not known [default: not known]
  disturbed        bool (T, N)     label of the auxiliary task `disturb`
  bootstrap        f32 (N)         value of the observation after the last action
  beliefs          f32 (N, hidden) before the first step; of an LSTM (N, 2 * hidden), cells behind them [default: 0]
  recorded         bool (T, N)     false for the last environments in the last step, if they did not act [default: true]
  negatives        i64 (T, N)      cell t·N + n that `cpca16` shows where (t, n) was seen [default: drawn]
Names may begin with `rollout.`: the dump of a non-finite update can be probed (--weights and --batch the same file).

Written are log_probs (of a box means and log_stds), values, embeddings, beliefs, next_beliefs, advantages, returns, each
loss and figure by its name in the metrics (loss/policy, ...), loss/total, gradient.NAME of every weight (unclipped) and what
the auxiliary task was asked. All names, shapes and formulas: docs/probe.md.")]
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

/// Why a probe failed.
#[derive(Debug, thiserror::Error)]
pub enum ProbeError {
    /// The configuration cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The device is not there.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The encoder cannot compute in bfloat16 here.
    #[error(transparent)]
    Precision(#[from] PrecisionError),
    /// A file cannot be read or written.
    #[error("cannot {verb} {path}: {cause}", path = .path.display())]
    File {
        /// `read` or `write`.
        verb: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// A file's tensors cannot be used.
    #[error("{path}: {cause}", path = .path.display())]
    Tensors {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: TensorsError,
    },
    /// A file of PyTorch's own format.
    #[error("{path}: {advice}", path = .path.display())]
    TorchSave {
        /// The file.
        path: PathBuf,
        /// How to make it one of safetensors.
        advice: String,
    },
    /// Losses or gradient cannot be computed.
    #[error(transparent)]
    Update(#[from] UpdateError),
    /// The result cannot be printed.
    #[error("cannot print: {0}")]
    Print(std::io::Error),
}

/// Runs the command: writes the file and prints every figure, a line each.
pub fn run(arguments: &Arguments, mut output: impl Write) -> Result<(), ProbeError> {
    let settings: Vec<Setting> = arguments.task.iter().chain(&arguments.set).cloned().collect();
    let mut config = Config::resolve_set(&arguments.preset, arguments.config.as_deref(), &settings)?;
    let device = device::choose(&LearnerConfig { device: arguments.device, ..config.learner })?;
    let saved = read(&arguments.weights)?;
    let in_weights = |cause| ProbeError::Tensors { path: arguments.weights.clone(), cause };
    let weights = model(&saved);
    fit(&mut config, &weights).map_err(in_weights)?;
    // What weights are of may be more than can be.
    config.validate()?;

    let actions = config.policy_actions().len() as i64;
    let (mut network, auxiliary) = Network::new(&config, device, |layout, hidden| {
        Auxiliary::new(&config.auxiliary, layout, Sizes { hidden, actions })
    });
    network.choose_precision(config.learner.encoder_precision)?;
    tracing::info!("computes on {}", device::describe(device, network.is_fused()));
    network.parameters.load(&weights).map_err(|unfit| in_weights(unfit.into()))?;
    let batch = Batch::read(&read(&arguments.batch)?, &config, &network)
        .map_err(|cause| ProbeError::Tensors { path: arguments.batch.clone(), cause })?;

    let running = Running::before(&config).found_in(&saved).map_err(|unfit| in_weights(unfit.into()))?;
    let Probed { tensors, figures } = probe(&config, &network, &auxiliary, running.reward_scale(), &batch)?;
    let bytes = encode_tensors(&tensors).map_err(|cause| ProbeError::Tensors { path: arguments.out.clone(), cause })?;
    write_atomically(&arguments.out, &bytes).map_err(|cause| ProbeError::File {
        verb: "write",
        path: arguments.out.clone(),
        cause,
    })?;
    for (name, value) in figures {
        writeln!(output, "{name} {value}").map_err(ProbeError::Print)?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<BTreeMap<String, Tensor>, ProbeError> {
    let bytes = std::fs::read(path).map_err(|cause| ProbeError::File { verb: "read", path: path.into(), cause })?;
    decode_tensors(&bytes).map_err(|cause| match how_to_convert(path, &bytes) {
        Some(advice) => ProbeError::TorchSave { path: path.into(), advice },
        None => ProbeError::Tensors { path: path.into(), cause },
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
