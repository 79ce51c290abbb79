use super::list::EVALUATIONS;
use super::player::ShownArgs;
use crate::environment;
use crate::evaluation::choice::{ObjectsChoice, SplitChoice};
use crate::evaluation::run::EvaluationRun;
use crate::evaluation::subject::{Found, Source, find};
use crate::evaluation::text::{episodes_of, place, seeds_of, word_of_place};
use crate::output::format::counted;
use crate::output::{format, terminal};
use crate::preflight::all::demand_all;
use crate::preflight::programs::Tools;
use crate::run::create::{check_free, create, new_folder};
use crate::run::identity::{is_evaluation, unix_now};
use crate::run::{lifeline, scenes};
use crate::suite;
use crate::wrong::{demand, wrong};
use anyhow::{Result, anyhow, ensure};
use proto::checkpoint::Manifest;
use proto::config::{Config, ConfigError, DeviceChoice, Setting, ValidationConfig};
use proto::evaluation::{
    Distribution, EPISODES_OF_SET, EvaluationConfig, ObjectSet, Plan, SEEDED_EPISODES, SEEDED_EPISODES_MOST, Subject,
    has_targets,
};
use proto::kitchen::{KitchenId, KitchenRange, Split, TargetCategory};
use proto::run_folder::RunFolder;
use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const ENVIRONMENTS_MAX: u32 = 32;

/// Play episodes of the test, validation or training kitchens with a policy, and measure the metrics of its task
///
/// A run whose episodes have short distances is asked for such episodes, drawn alike for every policy; any other
/// one plays the fixed episodes. A run in scenes of its own is evaluated there. --kitchens chooses procedural kitchens,
/// such as a run in kitchens without end has never seen. A run with an environment of your own plays episodes of fixed
/// seeds. On the CPU the same weights, seed, --actors and --environments give the same table; another number of either
/// may change the last bits of the network's output (docs/evaluation.md). Without a run, `--preset` evaluates the weights
/// that a fresh run begins with: a nearly uniform policy, the baseline of a random one. Exit status 1 without a result.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # the paper's main table: 5 kitchens, 360 episodes each
  orchestrator eval runs/a --split test --objects novel
  orchestrator eval runs/a/best --split validation --objects all --episodes 60 \\
    --deterministic
  orchestrator eval runs/a/checkpoints/rollout-00000120.json \\
    --out evaluations/a-120
  # a policy file, which `orchestrator export` writes
  orchestrator eval models/fetch.safetensors --split test
  # the paper's kind of episodes, whatever the run trained on
  orchestrator eval runs/demo --distribution fixed
  orchestrator eval runs/a --split train --episodes 6 --json
  # in a hundred kitchens never seen
  orchestrator eval runs/a --kitchens 5000..5100 --episodes 6
  # an environment of your own: seeds 0 to 99
  orchestrator eval runs/cart-pole --episodes 100
  # a random policy
  orchestrator eval --preset recipe --split test")]
pub struct EvalArgs {
    /// Run folder (its newest checkpoint), RUN/best, a checkpoint's manifest, or a policy file (.safetensors)
    #[arg(value_name = "RUN|CHECKPOINT|FILE", required_unless_present = "preset")]
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
    /// Kitchens, `val` for validation [default: test; of a run in scenes of its own: those scenes]
    #[arg(long, value_enum)]
    split: Option<SplitChoice>,
    /// Instead of a split (whose name --split takes): one kitchen by its number, 1 to 30, or procedural ones, as
    /// 5000..5100, from 1000 on. A run in `count` of these has seen 1000 to 999 + `count`
    #[arg(long, value_name = "N|FIRST..END", value_parser = kitchens, conflicts_with = "split")]
    kitchens: Option<Chosen>,
    /// Targets, of a task that has them: novel (or `unseen`), seen in training, or all [default: novel; in scenes all that they have]
    #[arg(long, value_enum)]
    objects: Option<ObjectsChoice>,
    /// Episodes: the fixed ones at full distance, or drawn within the distances of the run's
    /// table `episode` [default: fixed; run where the run has such limits, in training kitchens and in scenes]
    #[arg(long, value_enum)]
    distribution: Option<DistributionChoice>,
    /// Only the first N episodes of each kitchen and object set, at most 360; a multiple of 6 has each category as often
    /// [default: all]. Of an environment of your own: N episodes [default: 100]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(SEEDED_EPISODES_MOST)))]
    episodes: Option<u32>,
    /// Take the most probable action instead of sampling
    #[arg(long)]
    deterministic: bool,
    /// Actor processes, at least one a kitchen [default: one a kitchen, or as many times that as there are cores for]
    #[arg(long, value_name = "A", value_parser = clap::value_parser!(u32).range(1..=512))]
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
    #[arg(long, value_name = "S", value_parser = super::overrides::seed)]
    seed: Option<u64>,
    /// Print the result as JSON, which is all that comes on standard output
    #[arg(long)]
    json: bool,
    /// Beside the training run of this process, the parent: stop when it ends, and leave the processor to it
    #[arg(long, hide = true, value_name = "PID")]
    beside: Option<u32>,
    #[command(flatten)]
    shown: ShownArgs,
}

#[derive(Debug, Clone, Copy)]
enum Chosen {
    One(KitchenId),
    Procedural(KitchenRange),
}

fn kitchens(text: &str) -> Result<Chosen, String> {
    let text = text.strip_prefix("procedural:").unwrap_or(text);
    if text.contains("..") {
        return text.parse().map(Chosen::Procedural);
    }
    let wanted = "expected one kitchen's number, as 7, or procedural kitchens, as 5000..5100; several that are built in are \
                  those of a split: --split train, validation or test";
    let number: u32 = text.parse().map_err(|_| wanted)?;
    if KitchenId::new(number).is_ok_and(|kitchen| kitchen.scene_index().is_some()) {
        return Err(
            "it is a scene's number: a run in scenes is evaluated in all of them, without --kitchens".to_owned()
        );
    }
    let kitchen = KitchenId::generated(number).map_err(|error| error.to_string())?;
    if kitchen.is_procedural() {
        format!("{number}..{}", number + 1).parse().map(Chosen::Procedural)
    } else {
        Ok(Chosen::One(kitchen))
    }
}

impl EvalArgs {
    fn kitchen(&self) -> Option<KitchenId> {
        match self.kitchens {
            Some(Chosen::One(kitchen)) => Some(kitchen),
            _ => None,
        }
    }

    fn procedural(&self) -> Option<KitchenRange> {
        match self.kitchens {
            Some(Chosen::Procedural(range)) => Some(range),
            _ => None,
        }
    }
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum DistributionChoice {
    Fixed,
    Run,
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

pub fn run(args: &EvalArgs) -> Result<ExitCode> {
    if let Some(parent) = args.beside {
        // It ends with the run, which comes first on the processor.
        lifeline::follow(parent, Signal::TERM)?;
        rustix::process::nice(10)?;
    }
    let _shown = args.shown.begin(args.out.as_deref())?;
    if let Some(out) = &args.out {
        let is_file = out.extension().is_some_and(|ending| ending == "json" || ending == "csv");
        demand!(!is_file, "--out {0} is to be a folder; `--json > {0}` writes the result into a file", out.display());
        let folder = RunFolder::new(out);
        let holds_run = folder.identity().exists() && !is_evaluation(&folder);
        demand!(!holds_run, "--out {} holds a run: give a new or empty folder for the evaluation", out.display());
        check_free(&folder)?;
    }
    let (mut run, subject) = subject(args)?;
    if args.split.is_some() || args.kitchens.is_some() {
        // Elsewhere than in its own scenes.
        run.scenes.clear();
    }
    // A validation's run has tried it.
    if args.beside.is_none() {
        let named = subject.run.as_ref().map(Path::new).or(args.subject.as_deref());
        environment::attempt(&run, named.unwrap_or(Path::new("it")))?;
    }
    let asked = asked(args, &run, scenes::targets(&run)?, subject.checkpoint.clone())?;
    let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get() as u32);
    let mut config = configuration(run, &asked, args, cores)?;

    if let Some(chosen) = chosen(args.subject.as_deref(), asked.checkpoint.as_deref()) {
        terminal::note(&chosen);
    }
    terminal::note(&announcement(args, &config, &asked));
    let tools = Tools::find()?;
    let named = args.out.clone().unwrap_or_else(|| default_folder(&subject, &asked));
    demand_all(&config, &RunFolder::new(&named), &tools)?;
    let folder = if args.out.is_some() { RunFolder::new(named) } else { new_folder(&named)? };
    let folders = if config.recording.enabled { vec![folder.recordings()] } else { vec![] };
    let (identity, lock) = create(&folder, &mut config, &folders)?;
    EvaluationRun { folder, config, asked, json: args.json, subject, identity, lock, tools }.run()
}

/// An evaluation's configuration: its run's, without what concerns training only.
fn configuration(run: Config, asked: &EvaluationConfig, args: &EvalArgs, cores: u32) -> Result<Config> {
    let mut config = run;
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
    (config.learner.count, config.learner.shards) = (1, 0);
    if let Some(device) = args.device {
        config.learner.device = match device {
            DeviceArg::Auto => DeviceChoice::Auto,
            DeviceArg::Cpu => DeviceChoice::Cpu,
            DeviceArg::Cuda => DeviceChoice::Cuda,
        };
    }
    config.learner.progress_deadline_s = args.shown.patience_s(&config);
    // For somebody who watches one actor a kitchen is enough, on any machine.
    let cores = if args.shown.is_watched() { 1 } else { cores };
    // A vector of a fixed size has as many as the run's.
    let of_run = config.environment.is_some().then_some(config.actors.environments_per_actor);
    let (actors, environments) = shape(asked, args.actors, args.environments.or(of_run), cores);
    if let Some(more) = args.actors.filter(|&asked| asked > actors) {
        terminal::note(&format!(
            "{} instead of {more}: no more episodes are to be played",
            counted(actors.into(), "actor")
        ));
    }
    config.actors.count = actors;
    config.actors.environments_per_actor = environments;
    config.validate().map_err(|error| match error {
        ConfigError::OutOfRange { key: "evaluation.procedural", value, problem, .. } => {
            wrong(anyhow!("--kitchens {value}: {problem}"))
        }
        other => other.into(),
    })?;
    let targets: Vec<&str> = asked.scene_targets.iter().flatten().map(|target| target.name()).collect();
    ensure!(
        config.evaluation_plan().is_some_and(|plan| !plan.is_empty()),
        "there is no episode to play: the scenes have no targets that are {} (they have: {})",
        asked.objects.name(),
        targets.join(", ")
    );
    Ok(config)
}

/// The run's configuration, and whose weights they are.
fn subject(args: &EvalArgs) -> Result<(Config, Subject)> {
    let text = |path: &Path| match path.to_str() {
        Some(text) => Ok(text.to_owned()),
        None => anyhow::bail!("{} has a name that is not text", path.display()),
    };
    if let Some(path) = &args.subject {
        suite::refuse(path)?;
        let (config, run, run_id, weights) = match find(path)? {
            Source::Checkpoint(found) => {
                let Found { manifest, named, run, mut config } = *found;
                for scene in &mut config.scenes {
                    // The run's own copy, whatever the working directory is.
                    *scene = text(&run.join(scene.as_str()))?;
                }
                // The learner refuses a manifest that cannot be read.
                let run_id = Manifest::read_in(&named, &manifest).ok().map(|read| read.run).filter(|id| !id.is_empty());
                (config, Some(text(&run)?), run_id, manifest)
            }
            Source::File { path, policy } => (policy.config, None, None, path),
        };
        let (preset, seed, checkpoint) = (config.preset.clone(), config.seed, Some(text(&weights)?));
        return Ok((config, Subject { preset, seed, run, run_id, checkpoint, ..Subject::default() }));
    }
    let preset = args.preset.as_deref().unwrap_or("demo");
    let config = Config::resolve_set(preset, args.config.as_deref(), &args.set)?;
    let seed = args.seed.unwrap_or(config.seed);
    Ok((config, Subject { preset: preset.to_owned(), seed, ..Subject::default() }))
}

/// What is asked about a run. Its configuration names scenes only if the evaluation is in them.
fn asked(
    args: &EvalArgs,
    run: &Config,
    scene_targets: Vec<Vec<TargetCategory>>,
    checkpoint: Option<String>,
) -> Result<EvaluationConfig> {
    let (in_scenes, elsewhere) = (!run.scenes.is_empty(), run.environment.is_some());
    let episodes = args.episodes.unwrap_or(if elsewhere { SEEDED_EPISODES } else { 0 });
    demand!(
        elsewhere || episodes <= EPISODES_OF_SET,
        "--episodes {episodes}: a kitchen has {EPISODES_OF_SET} episodes of each object set"
    );
    demand!(
        !elsewhere || args.kitchens.is_none() && args.distribution.is_none(),
        "--kitchens, --kitchen, --distribution: the run's environments are not built in, and are in no kitchen"
    );
    demand!(
        !elsewhere || args.split != Some(SplitChoice::Train),
        "--split train: episodes of fixed seeds are those of the test or of validation (--split validation)"
    );
    let split = match args.split {
        None if args.kitchen().is_some() => args.kitchen().map_or(Split::Test, KitchenId::split),
        None if in_scenes || args.kitchens.is_some() => Split::Train,
        Some(SplitChoice::Train) => Split::Train,
        Some(SplitChoice::Validation) => Split::Validation,
        Some(SplitChoice::Test) | None => Split::Test,
    };
    let distribution = match args.distribution {
        Some(DistributionChoice::Fixed) => Distribution::Fixed,
        Some(DistributionChoice::Run) => Distribution::Run,
        None if elsewhere => Distribution::Seeds,
        None => run.episode.default_distribution(split),
    };
    demand!(
        distribution != Distribution::Fixed || split != Split::Train,
        "--distribution fixed: {} have no fixed episodes, only validation and test kitchens do (--split validation or test)",
        match args.procedural() {
            Some(_) => "procedural kitchens",
            None if in_scenes => "scenes",
            None => "training kitchens",
        }
    );
    let has_targets = has_targets(run.spec());
    demand!(
        has_targets || args.objects.is_none(),
        "--objects: an episode of the task `{}` has no target, and so there are no sets of them",
        run.task
    );
    Ok(EvaluationConfig {
        split,
        procedural: args.procedural(),
        kitchen: args.kitchen(),
        objects: match args.objects {
            _ if !has_targets => ObjectSet::NoTargets,
            None if in_scenes => ObjectSet::All,
            Some(ObjectsChoice::Novel) | None => ObjectSet::Novel,
            Some(ObjectsChoice::Seen) => ObjectSet::Seen,
            Some(ObjectsChoice::All) => ObjectSet::All,
        },
        episodes,
        distribution,
        scene_targets,
        deterministic: args.deterministic,
        hashes_by_kitchen: true,
        steps_per_s: args.shown.steps_per_s,
        checkpoint,
    })
}

/// Which of a folder's checkpoints is evaluated.
fn chosen(subject: Option<&Path>, checkpoint: Option<&str>) -> Option<String> {
    let (folder, checkpoint) = (subject.filter(|subject| subject.is_dir())?, Path::new(checkpoint?));
    Some(format!("checkpoint {} of {}", checkpoint.file_name()?.display(), folder.display()))
}

/// Which episodes are played where, and how to have others where that was not asked for.
fn announcement(args: &EvalArgs, config: &Config, asked: &EvaluationConfig) -> String {
    let what = episodes_of(config, asked);
    if let Some(seeds) = seeds_of(asked.distribution, asked.split, asked.episodes) {
        return seeds;
    }
    let place = place(asked.split, asked.procedural, asked.scene_targets.len(), asked.kitchen);
    let otherwise = match (args.distribution, asked.distribution, asked.split) {
        _ if !config.scenes.is_empty() => " (--split goes elsewhere)",
        (None, Distribution::Run, Split::Validation | Split::Test) => " (--distribution fixed plays the fixed ones)",
        _ => "",
    };
    format!("{what}, in {place}{otherwise}")
}

/// Actors and environments of each: as many actors as there are cores for and episodes at most, and environments that run
/// out together.
fn shape(asked: &EvaluationConfig, actors: Option<u32>, environments: Option<u32>, cores: u32) -> (u32, u32) {
    if asked.procedural.is_some() {
        // Environments go from kitchen to kitchen: no actor belongs to one.
        let episodes = Plan::new(asked, 1, 1).len() as u32;
        let actors = actors.unwrap_or(cores).min(episodes).max(1);
        let even = episodes.div_ceil(actors).clamp(1, ENVIRONMENTS_MAX);
        return (actors, environments.unwrap_or(even));
    }
    let kitchens = asked.kitchens().count() as u32;
    // Without episodes, or with too few actors for the kitchens, it is refused later, with a reason.
    let episodes = (Plan::new(asked, kitchens, 1).len() as u32).max(kitchens);
    let actors = actors.unwrap_or_else(|| (cores / kitchens).max(1) * kitchens).min(episodes);
    let per_kitchen = (actors / kitchens).max(1);
    let episodes = Plan::new(asked, actors, 1).longest() as u32;
    let rounds = episodes.div_ceil(per_kitchen * ENVIRONMENTS_MAX).max(1);
    let even = episodes.div_ceil(per_kitchen * rounds).clamp(1, ENVIRONMENTS_MAX);
    (actors, environments.unwrap_or(even))
}

fn default_folder(subject: &Subject, asked: &EvaluationConfig) -> PathBuf {
    let split = word_of_place(asked.split, asked.procedural.is_some(), !asked.scene_targets.is_empty());
    let time = format::timestamp(unix_now());
    let objects = match asked.objects {
        ObjectSet::NoTargets => String::new(),
        objects => format!("-{}", objects.name()),
    };
    let name = |whose: &str| format!("{time}-{whose}{split}{objects}");
    if let Some(run) = &subject.run {
        return format::typed(Path::new(run)).join("evaluations").join(name(""));
    }
    // Of a policy file, or of nothing that anybody has trained.
    let stem = asked.checkpoint.as_ref().and_then(|file| Path::new(file).file_stem());
    let whose = stem.map_or_else(|| format!("{}-fresh", subject.preset), |stem| stem.to_string_lossy().into_owned());
    Path::new(EVALUATIONS).join(name(&format!("{whose}-")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args, FromArgMatches};
    use proto::config::LearnerConfig;

    fn args(line: &[&str]) -> EvalArgs {
        let command = EvalArgs::augment_args(clap::Command::new("eval").no_binary_name(true));
        EvalArgs::from_arg_matches(&command.get_matches_from(line)).unwrap()
    }

    #[test]
    fn other_words_that_are_understood_stand_in_the_help() {
        let args = args(&["a", "--split", "val", "--objects", "unseen"]);
        assert!(matches!((args.split, args.objects), (Some(SplitChoice::Validation), Some(ObjectsChoice::Novel))));
        let help = EvalArgs::augment_args(clap::Command::new("eval")).render_long_help().to_string();
        assert!(help.contains("`val` for validation") && help.contains("(or `unseen`)"), "{help}");
    }

    #[test]
    fn one_learner_evaluates_what_several_have_trained() {
        let args = args(&["runs/a", "--split", "validation", "--device", "cpu"]);
        let mut run = Config::resolve("demo", None).unwrap();
        (run.actors.count, run.learner.count, run.learner.shards) = (8, 8, 8);
        run.validate().unwrap();
        let asked = asked(&args, &run, Vec::new(), None).unwrap();
        let config = configuration(run.clone(), &asked, &args, 2).unwrap();
        assert_eq!((config.learner.count, config.actors.count), (1, 5));
        config.validate().unwrap();
        // All else of the learner is as it was for training.
        let learner = LearnerConfig { count: 1, shards: 0, device: DeviceChoice::Cpu, ..run.learner };
        assert_eq!(config.learner, learner);
    }

    #[test]
    fn procedural_kitchens_are_chosen_by_number() {
        let of = |line: &[&str]| {
            let run = Config::resolve("procedural-100", None).unwrap();
            let args = args(line);
            let asked = asked(&args, &run, Vec::new(), None)?;
            let config = configuration(run, &asked, &args, 2)?;
            let announced = announcement(&args, &config, &asked);
            Ok::<_, anyhow::Error>((config, asked, announced))
        };
        let test = KitchenId::of_split(Split::Test)[0];
        let (_, asked, announced) = of(&["a", "--kitchens", &test.to_string()]).unwrap();
        assert_eq!((asked.split, asked.kitchens().ids()), (Split::Test, vec![test]));
        assert!(announced.ends_with(&format!("in kitchen {test}")), "{announced}");
        assert_eq!(of(&["a", "--kitchens", "5000"]).unwrap().1.procedural.map(KitchenRange::count), Some(1));
        let (config, asked, announced) = of(&["a", "--kitchens", "5000..5100", "--episodes", "6"]).unwrap();
        assert_eq!((asked.split, asked.distribution), (Split::Train, Distribution::Run));
        assert_eq!((config.actors.count, config.actors.environments_per_actor), (2, 32));
        assert_eq!(config.evaluation_plan().unwrap().len(), 600);
        assert!(announced.ends_with("in 100 procedural kitchens (5000..5100)"), "{announced}");
        // A run in kitchens without end is asked about the test kitchens like any other.
        assert_eq!(of(&["a"]).unwrap().1.split, Split::Test);
        let many = of(&["a", "--kitchens", "5000..9000"]).unwrap_err().to_string();
        assert_eq!(many, "--kitchens 5000..9000: must be at most 1000 kitchens");
        let fixed = of(&["a", "--kitchens", "procedural:5000..5100", "--distribution", "fixed"]).unwrap_err();
        assert!(fixed.to_string().contains("procedural kitchens have no fixed episodes"), "{fixed}");
        let command = EvalArgs::augment_args(clap::Command::new("eval").no_binary_name(true));
        for wrong in ["1,2", "31", "seven", "procedural:1..30"] {
            assert!(command.clone().try_get_matches_from(["a", "--kitchens", wrong]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn what_is_shown_has_one_slow_environment_a_kitchen_on_any_machine() {
        let of = |kitchen: Option<u32>, split: Option<SplitChoice>, cores: u32| {
            let kitchen = kitchen.map(|number| KitchenId::new(number).unwrap());
            let options = super::super::player::options(kitchen, split, 4, true);
            let args =
                args(&[&["a.safetensors"], &options.iter().map(String::as_str).collect::<Vec<_>>()[..]].concat());
            let run = Config::resolve("demo", None).unwrap();
            let checkpoint = Some("/w/a.safetensors".to_owned());
            let asked = asked(&args, &run, Vec::new(), checkpoint).unwrap();
            let config = configuration(run, &asked, &args, cores).unwrap();
            assert_eq!((config.actors.environments_per_actor, config.recording.enabled), (1, true));
            assert_eq!(config.evaluation.as_ref().and_then(|asked| asked.steps_per_s), Some(4));
            // The longest episode takes 50 s, in which nothing is heard of it.
            assert_eq!((config.episode.max_steps, config.learner.progress_deadline_s), (200, 150.0));
            (config.actors.count, config.kitchens().ids()[0].number(), asked.split)
        };
        for cores in [1, 2, 64] {
            assert_eq!(of(None, None, cores), (5, 2, Split::Test));
            assert_eq!(of(None, Some(SplitChoice::Train), cores), (19, 1, Split::Train));
            assert_eq!(of(Some(7), None, cores), (1, 7, Split::Train));
            assert_eq!(of(Some(11), None, cores), (1, 11, Split::Validation));
            assert_eq!(of(Some(1003), None, cores), (1, 1003, Split::Train));
        }
    }

    #[test]
    fn a_result_is_called_after_the_run_the_file_or_the_preset() {
        let name = |run: Option<&str>, checkpoint: Option<&str>| {
            let subject = Subject { preset: "demo".to_owned(), run: run.map(str::to_owned), ..Subject::default() };
            let asked = EvaluationConfig {
                checkpoint: checkpoint.map(str::to_owned),
                ..EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 0)
            };
            default_folder(&subject, &asked).display().to_string()
        };
        let of_run = name(Some("/r/a"), Some("/r/a/checkpoints/rollout-00000003.json"));
        assert!(of_run.starts_with("/r/a/evaluations/") && of_run.ends_with("-test-novel"), "{of_run}");
        assert!(name(None, Some("/w/fetch.safetensors")).ends_with("-fetch-test-novel"));
        assert!(name(None, None).ends_with("-demo-fresh-test-novel"));
    }

    #[test]
    fn all_environments_have_as_many_episodes_and_all_cores_are_used() {
        let asked = |episodes, objects| EvaluationConfig::fixed(Split::Test, objects, episodes);
        assert_eq!(shape(&asked(0, ObjectSet::Novel), None, None, 16), (15, 30));
        assert_eq!(shape(&asked(0, ObjectSet::All), None, None, 16), (15, 30));
        assert_eq!(shape(&asked(0, ObjectSet::Novel), None, None, 2), (5, 30));
        assert_eq!(shape(&asked(6, ObjectSet::Novel), None, None, 2), (5, 6));
        assert_eq!(shape(&asked(1, ObjectSet::Novel), None, None, 64), (5, 1));
        assert_eq!(shape(&asked(6, ObjectSet::Seen), Some(7), Some(4), 2), (7, 4));
        assert_eq!(shape(&asked(1, ObjectSet::Seen), Some(500), None, 2), (5, 1), "none has nothing to play");
        // Fewer actors than kitchens are refused later, with a reason.
        assert_eq!(shape(&asked(6, ObjectSet::Seen), Some(4), None, 2).0, 4);
        let scene_targets = vec![vec![TargetCategory::Mug, TargetCategory::Cup]];
        let scene = EvaluationConfig { split: Split::Train, scene_targets, ..asked(0, ObjectSet::All) };
        assert_eq!(shape(&scene, None, None, 2), (2, 30));
    }
}
