//! `learner bench`: how fast this machine infers and trains, through the code that training uses.
//!
//! ```text
//! frames      observations in shared memory, as actors send them
//! inference   one step of a half: from frames in shared memory to sampled actions
//! update      an epoch, and a whole update
//! time        what all of them measure with
//! gpu         how busy the GPU is meanwhile, and how much of its memory is taken
//! report      all of it as one table, or as JSON
//! exchange    a command of its own: sums of gradients over learners
//! ```

pub mod exchange;
mod frames;
mod gpu;
mod inference;
mod report;
mod time;
mod update;

#[cfg(test)]
pub(crate) use frames::Frames;

use crate::agent::Agent;
use crate::declared::declare;
use crate::device;
use anyhow::{Result, ensure};
use gpu::Monitor;
use proto::config::{Config, DeviceChoice, Encoder, Setting};
use report::Report;
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;
use tch::Cuda;

/// What `learner bench` is asked.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
A batch is one half of the environments: 19 actors of 16 environments make batches of 152. Its time goes from frames
in shared memory to sampled actions, so it includes the way of the frames to the device. On a CPU the column `copy`
gives that alone; a GPU reads the frames itself, unless a warning says that they are copied. An epoch is forward and
backward pass of all frames with its optimiser step. `orchestrator up --frames N` measures the whole loop.

Examples:
  learner bench
  learner bench --device cpu --set network.encoder=resnet --batches 10 --steps 16
  learner bench --device cuda --json > bench.json")]
pub struct Arguments {
    /// Where to compute: cpu, cuda or auto
    #[arg(long, value_name = "D", default_value = "auto", value_parser = device::parse_choice)]
    device: DeviceChoice,
    /// Named configuration [default: demo on a CPU, recipe on a GPU]
    #[arg(long, value_name = "P")]
    preset: Option<String>,
    /// TOML file whose keys replace the preset's
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One key of the configuration over both, for example ppo.epochs=1; repeat it for more
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<Setting>,
    /// Declaration of a task that is not built in: the task.toml of a run
    #[arg(long, value_name = "TASK.toml", value_parser = declare)]
    task: Option<Setting>,
    /// Batches of inference, with commas between [default: 10,19,152,304,608; on a CPU 10,19,38]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=4096))]
    batches: Vec<u32>,
    /// Steps of a rollout for updates, with commas between [default: 32,128; on a CPU 16,32]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=4096))]
    steps: Vec<u32>,
    /// Frames of a rollout for updates; there are as many environments as that makes [default: 9728; on a CPU 1216]
    #[arg(long, value_name = "F", value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    rollout_frames: Option<u32>,
    /// Least time for each figure of inference, seconds
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    seconds: f64,
    /// Show a profiler one more step, or one more update of a single epoch (`ncu --profile-from-start off`)
    #[arg(long, value_name = "WHAT", value_enum)]
    mark: Option<Mark>,
    /// Print JSON in place of the table
    #[arg(long)]
    json: bool,
}

/// What a profiler is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Mark {
    /// A step of each of `--batches`.
    Inference,
    /// An update of each of `--steps`.
    Update,
}

pub fn run(arguments: &Arguments, mut output: impl Write) -> Result<()> {
    ensure!(
        arguments.seconds > 0.0 && arguments.seconds <= 600.0,
        "--seconds {}: must be above 0 and at most 600",
        arguments.seconds
    );
    let cuda = arguments.device != DeviceChoice::Cpu && Cuda::is_available();
    let preset = arguments.preset.as_deref().unwrap_or(if cuda { "recipe" } else { "demo" });
    let settings: Vec<Setting> = arguments.task.iter().chain(&arguments.set).cloned().collect();
    let mut config = Config::resolve_set(preset, arguments.config.as_deref(), &settings)?;
    config.learner.device = arguments.device;
    // Whatever the configuration is of, this process is one learner.
    config.learner.count = 1;
    let device = device::choose(&config.learner)?;
    ensure!(arguments.mark.is_none() || device.is_cuda(), "--mark shows a profiler what a GPU does, and this is a CPU");
    let mark = |what| arguments.mark == Some(what);
    let monitor = Monitor::of(device);
    let agent = Agent::new(&config, device)?;
    let (place, parameters) = (agent.device(), agent.parameter_count());
    drop(agent);

    let defaults: (&[u32], &[u32], u32) =
        if device.is_cuda() { (&[10, 19, 152, 304, 608], &[32, 128], 9728) } else { (&[10, 19, 38], &[16, 32], 1216) };
    let given = |list: &[u32], default: &[u32]| if list.is_empty() { default.to_vec() } else { list.to_vec() };
    let mut inference = vec![];
    for batch in given(&arguments.batches, defaults.0) {
        inference.push(inference::measure(
            &config,
            device,
            batch,
            Duration::from_secs_f64(arguments.seconds),
            &monitor,
            mark(Mark::Inference),
        )?);
        tracing::info!("inference of {batch} measured");
    }
    let mut updates = vec![];
    for steps in given(&arguments.steps, defaults.1) {
        let frames = arguments.rollout_frames.unwrap_or(defaults.2);
        updates.push(update::measure(&config, device, steps, frames, &monitor, mark(Mark::Update))?);
        tracing::info!("updates of {steps} steps measured");
    }
    let inputs = config.spec().inputs()?;
    let encoder = match (inputs.frame, config.network.encoder) {
        (None, _) if inputs.images.is_empty() => "mlp",
        (None, _) => "images",
        (Some(_), Encoder::Resnet) => "resnet",
        (Some(_), Encoder::Cnn) => "cnn",
    };
    let report = Report { preset: preset.to_owned(), place, encoder, parameters, inference, updates };
    let text = if arguments.json { serde_json::to_string_pretty(&report)? } else { report.table() };
    writeln!(output, "{text}")?;
    Ok(())
}
