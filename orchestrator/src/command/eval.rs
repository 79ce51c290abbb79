//! `orchestrator eval`: success and disturbance of a policy on fixed episodes.

use super::up::{check_free, create_with};
use crate::evaluation::Examination;
use crate::evaluation::subject::{Origin, find};
use crate::format;
use crate::identity::unix_now;
use crate::lifeline;
use crate::session::{Tools, preflight};
use anyhow::{Result, ensure};
use proto::config::{Config, DeviceChoice, Setting, ValidationConfig};
use proto::evaluation::{EvaluationConfig, ObjectSet, Plan};
use proto::kitchen::{KitchenId, Split};
use proto::run_folder::RunFolder;
use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Environments of an actor at most, unless told otherwise.
const ENVIRONMENTS_MAX: u32 = 32;

/// Play fixed episodes of the validation or test kitchens with a policy, and measure success and disturbance
///
/// The same weights and seed give the same table (docs/evaluation.md). Without a run, `--preset` evaluates the weights
/// that a fresh run begins with: a nearly uniform policy, the baseline of a random one. Exit status 1 without a result.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator eval runs/a --split test --objects novel     the paper's main table: 5 kitchens, 360 episodes each
  orchestrator eval runs/a/best --split valid --objects all --episodes 60 --deterministic
  orchestrator eval runs/a/checkpoints/rollout-00000120.json --out evaluations/a-120
  orchestrator eval --preset two-stage --split test         a random policy")]
pub struct EvalArgs {
    /// Run folder (its newest checkpoint), RUN/best, or a checkpoint's manifest
    #[arg(value_name = "RUN|CHECKPOINT", required_unless_present = "preset")]
    subject: Option<PathBuf>,
    /// Instead of a run: freshly initialised weights of this preset
    #[arg(long, value_name = "P", conflicts_with = "subject")]
    preset: Option<String>,
    /// TOML file whose keys replace the preset's
    #[arg(long, value_name = "FILE", requires = "preset", conflicts_with = "subject")]
    config: Option<PathBuf>,
    /// One key of the configuration, over the preset and --config, as `orchestrator up` takes it; repeat it for more
    #[arg(long, value_name = "KEY=VALUE", requires = "preset", conflicts_with = "subject")]
    set: Vec<Setting>,
    /// Kitchens
    #[arg(long, value_enum, default_value = "test")]
    split: SplitChoice,
    /// Targets: novel, seen in training, or all
    #[arg(long, value_enum, default_value = "novel")]
    objects: ObjectsChoice,
    /// Only the first N episodes of each kitchen and object set; a multiple of 6 has each category as often [default:
    /// all 360]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=360))]
    episodes: Option<u32>,
    /// Take the most probable action instead of sampling
    #[arg(long)]
    deterministic: bool,
    /// Actor processes, at least one a kitchen [default: 5, or as many times 5 as there are cores for]
    #[arg(long, value_name = "A", value_parser = clap::value_parser!(u32).range(5..=512))]
    actors: Option<u32>,
    /// Environments in each actor [default: at most 32, so that all have as many episodes]
    #[arg(long, visible_alias = "envs-per-actor", value_name = "E", value_parser = clap::value_parser!(u32).range(1..=256))]
    environments: Option<u32>,
    /// Folder of the result, new or empty [default: RUN/evaluations/TIME-SPLIT-OBJECTS]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Record episodes as MCAP, without depth frames: `orchestrator replay` draws them
    #[arg(long, value_enum, default_value = "none")]
    record: RecordChoice,
    /// Where to infer [default: as the run says]
    #[arg(long, value_enum)]
    device: Option<DeviceArg>,
    /// Seed of the action noise [default: the run's]
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Beside the training run of this process, the parent: stop when it ends, and leave the processor to it
    #[arg(long, hide = true, value_name = "PID")]
    beside: Option<u32>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum SplitChoice {
    Valid,
    Test,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum ObjectsChoice {
    Novel,
    Seen,
    All,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum RecordChoice {
    None,
    Failures,
    All,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum DeviceArg {
    Auto,
    Cpu,
    Cuda,
}

/// Runs the command.
pub fn run(args: &EvalArgs) -> Result<ExitCode> {
    if let Some(parent) = args.beside {
        // It ends with the run, which comes first on the processor.
        lifeline::follow(parent, Signal::TERM)?;
        rustix::process::nice(10)?;
    }
    if let Some(out) = &args.out {
        check_free(&RunFolder::new(out))?;
    }
    let (run, origin, checkpoint) = subject(args)?;
    let asked = asked(args, checkpoint);
    let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get() as u32);
    let mut config = configuration(run, &asked, args, cores)?;

    let tools = Tools::find()?;
    let folder = RunFolder::new(args.out.clone().unwrap_or_else(|| default_folder(&origin, &asked)));
    preflight(&config, &folder, &tools)?;
    let folders = if config.recording.enabled { vec![folder.recordings()] } else { vec![] };
    let (identity, lock) = create_with(&folder, &mut config, &folders)?;
    Examination { folder, config, asked, subject: origin, identity, lock, tools }.run()
}

/// An evaluation's configuration: its run's, without what concerns training only.
fn configuration(run: Config, asked: &EvaluationConfig, args: &EvalArgs, cores: u32) -> Result<Config> {
    let mut config = run;
    config.scenes.clear();
    config.from = None;
    config.validation = ValidationConfig::default();
    config.evaluation = Some(asked.clone());
    config.recording.enabled = args.record != RecordChoice::None;
    config.recording.depth_share = 0.0;
    config.recording.failures_only = args.record == RecordChoice::Failures;
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    // However many have trained the weights, one infers.
    config.learner.count = 1;
    if let Some(device) = args.device {
        config.learner.device = match device {
            DeviceArg::Auto => DeviceChoice::Auto,
            DeviceArg::Cpu => DeviceChoice::Cpu,
            DeviceArg::Cuda => DeviceChoice::Cuda,
        };
    }
    let (actors, environments) = shape(asked, args.actors, args.environments, cores);
    config.actors.count = actors;
    config.actors.environments_per_actor = environments;
    config.validate()?;
    ensure!(config.evaluation_plan().is_some_and(|plan| !plan.is_empty()), "there is no episode to play");
    Ok(config)
}

/// The run's configuration, whose weights they are, and the manifest of the checkpoint if there is one.
fn subject(args: &EvalArgs) -> Result<(Config, Origin, Option<String>)> {
    let text = |path: &Path| match path.to_str() {
        Some(text) => Ok(text.to_owned()),
        None => anyhow::bail!("{} has a name that is not text", path.display()),
    };
    if let Some(path) = &args.subject {
        let found = find(path)?;
        let Config { preset, seed, .. } = &found.config;
        let origin = Origin { preset: preset.clone(), seed: *seed, run: Some(text(&found.run)?) };
        let manifest = text(&found.manifest)?;
        return Ok((found.config, origin, Some(manifest)));
    }
    let preset = args.preset.as_deref().unwrap_or("demo");
    let config = Config::resolve_set(preset, args.config.as_deref(), &args.set)?;
    let seed = args.seed.unwrap_or(config.seed);
    Ok((config, Origin { preset: preset.to_owned(), seed, run: None }, None))
}

fn asked(args: &EvalArgs, checkpoint: Option<String>) -> EvaluationConfig {
    EvaluationConfig {
        split: match args.split {
            SplitChoice::Valid => Split::Validation,
            SplitChoice::Test => Split::Test,
        },
        objects: match args.objects {
            ObjectsChoice::Novel => ObjectSet::Novel,
            ObjectsChoice::Seen => ObjectSet::Seen,
            ObjectsChoice::All => ObjectSet::All,
        },
        episodes: args.episodes.unwrap_or(0),
        deterministic: args.deterministic,
        checkpoint,
    }
}

/// Actors and environments of each: as many actors as there are cores for, and environments that run out together.
fn shape(asked: &EvaluationConfig, actors: Option<u32>, environments: Option<u32>, cores: u32) -> (u32, u32) {
    let kitchens = KitchenId::of_split(asked.split).len() as u32;
    let actors = actors.unwrap_or_else(|| (cores / kitchens).max(1) * kitchens);
    let per_kitchen = actors / kitchens;
    let episodes = Plan::new(asked, actors, 1).len() as u32 / kitchens;
    let rounds = episodes.div_ceil(per_kitchen * ENVIRONMENTS_MAX).max(1);
    let even = episodes.div_ceil(per_kitchen * rounds).clamp(1, ENVIRONMENTS_MAX);
    (actors, environments.unwrap_or(even))
}

fn default_folder(origin: &Origin, asked: &EvaluationConfig) -> PathBuf {
    let split = if asked.split == Split::Test { "test" } else { "valid" };
    let time = format::timestamp(unix_now());
    match &origin.run {
        Some(run) => Path::new(run).join("evaluations").join(format!("{time}-{split}-{}", asked.objects.name())),
        None => {
            Path::new("evaluations").join(format!("{time}-{}-fresh-{split}-{}", origin.preset, asked.objects.name()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args, FromArgMatches};
    use proto::config::LearnerConfig;

    #[test]
    fn one_learner_evaluates_what_several_have_trained() {
        let command = EvalArgs::augment_args(clap::Command::new("eval").no_binary_name(true));
        let line = command.get_matches_from(["runs/a", "--split", "valid", "--device", "cpu"]);
        let args = EvalArgs::from_arg_matches(&line).unwrap();
        let mut run = Config::resolve("demo", None).unwrap();
        run.learner.count = 8;
        run.validate().unwrap();
        let config = configuration(run.clone(), &asked(&args, None), &args, 2).unwrap();
        assert_eq!((config.learner.count, config.actors.count), (1, 5));
        config.validate().unwrap();
        // All else of the learner is as it was for training.
        let learner = LearnerConfig { count: 1, device: DeviceChoice::Cpu, ..run.learner };
        assert_eq!(config.learner, learner);
    }

    #[test]
    fn all_environments_have_as_many_episodes_and_all_cores_are_used() {
        let asked = |episodes, objects| EvaluationConfig {
            split: Split::Test,
            objects,
            episodes,
            deterministic: false,
            checkpoint: None,
        };
        assert_eq!(shape(&asked(0, ObjectSet::Novel), None, None, 16), (15, 30));
        assert_eq!(shape(&asked(0, ObjectSet::All), None, None, 16), (15, 30));
        assert_eq!(shape(&asked(0, ObjectSet::Novel), None, None, 2), (5, 30));
        assert_eq!(shape(&asked(6, ObjectSet::Novel), None, None, 2), (5, 6));
        assert_eq!(shape(&asked(1, ObjectSet::Novel), None, None, 64), (60, 1));
        assert_eq!(shape(&asked(6, ObjectSet::Seen), Some(7), Some(4), 2), (7, 4));
    }
}
