use super::environment_flags::EnvironmentFlags;
use super::host_flags::HostFlags;
use super::overrides::{Overrides, default_preset};
use super::resume::go_on;
use crate::evaluation::subject::{Found, find, network_differences};
use crate::hosts::membership::Membership;
use crate::output::format::counted;
use crate::output::{events, format, terminal};
use crate::preflight::all::demand_all;
use crate::preflight::programs::Tools;
use crate::run::checkpoints::read_manifest;
use crate::run::create::{check_free, create, new_folder};
use crate::run::identity::unix_now;
use crate::run::scenes;
use crate::suite;
use crate::supervisor::process::{TOKEN, TOKEN_FILE};
use crate::training::next_steps;
use crate::training::run::TrainingRun;
use crate::training::summary::Summary;
use crate::wrong::{demand, judged, reject, wrong};
use anyhow::{Context, Result, anyhow};
use proto::checkpoint::Manifest;
use proto::config::{Config, ConfigError, FromConfig};
use proto::run_folder::RunFolder;
use proto::shell::quoted;
use proto::stage::total_frames;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Start a new run: learner, actors, recording
///
/// Ctrl-C saves and stops everything (`orchestrator resume RUN` goes on from there, exit status 0); a second Ctrl-C
/// ends it at once (exit status 130). The last two lines on standard output are `weights: ` and the SHA-256 of the
/// weights, `frames: ` and the number of frames trained on; with --json the last line is the event `ended`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # the demonstration on a CPU, the recipe on a GPU
  orchestrator up
  # the paper's exact shape
  orchestrator up --preset paper --seed 2
  # a small one
  orchestrator up --preset demo --actors 4 --frames 20000 --run runs/small
  # a learner on each of two GPUs
  orchestrator up --preset recipe --actors 76 --learners 2
  # the same with a page to watch it on
  orchestrator up --preset demo --view
  # events for scripts, a line each
  orchestrator up --json | jq .event
  # some settings of your own over the default preset
  orchestrator up --config mine.toml
  # single settings
  orchestrator up --preset demo --set ppo.learning_rate=1e-3 \\
    --set network.encoder=resnet
  # stage II as a run of its own
  orchestrator up --preset disturb-stage2-25m --from runs/stage-1
  # an environment of your own
  orchestrator up --env gymnasium:CartPole-v1
  # a run over two machines
  torchrun --nnodes=2 --nproc-per-node=1 --no-python -- \\
    orchestrator up --learners 2 --run R --token-file token

The configuration, later over earlier: the preset, --config, --set, the other flags. `orchestrator config` prints it.")]
pub struct UpArgs {
    /// Named configuration (`orchestrator presets`) [default: demo without a CUDA device, recipe with one; gym with an
    /// environment of your own]
    #[arg(long, value_name = "P")]
    preset: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
    #[command(flatten)]
    environment: EnvironmentFlags,
    /// Begin with the weights of another run: its folder (the newest checkpoint), RUN/best, or a checkpoint's manifest.
    /// Optimiser, environments and frame count begin anew; the networks must be the same
    #[arg(long, value_name = "RUN|CHECKPOINT")]
    from: Option<PathBuf>,
    /// Run folder, new or empty [default: runs/TIME-PRESET-SEED]. A run that torchrun or srun started goes on in it
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Show the run on a page while it goes on (`orchestrator view`), and open that in a browser
    #[arg(long)]
    view: bool,
    /// Print events for scripts, a JSON object a line, and nothing else on standard output (docs/terminal.md)
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    hosts: HostFlags,
}

/// The preset of environments of the user's.
const OF_ENVIRONMENTS: &str = "gym";

/// Whether the preset is for environments of the user's, but the task is that of the kitchens.
pub(super) fn needs_environment(preset: &str, config: &Config) -> bool {
    preset == OF_ENVIRONMENTS && config.task == Config::default().task
}

pub fn run(args: &UpArgs) -> Result<ExitCode> {
    if args.json {
        events::begin();
    }
    // What the user wrote is judged before anything is started.
    let member = args.hosts.membership()?;
    if let Some(member) = member.as_ref().filter(|member| member.host > 0) {
        args.overrides.over(&Config::default())?;
        if args.view {
            terminal::note("--view shows the run on host 0 only");
        }
        let otherwise = |run: &Config, folder: &RunFolder| args.otherwise(member.hosts, run, folder);
        return args.hosts.take_part(member.clone(), args.shared_run()?, &otherwise);
    }
    if member.as_ref().is_some_and(|member| member.hosts > 1) {
        args.shared_run()?;
    }
    // Whoever starts this program again gives it the same command: then it goes on.
    let begun = args.run.as_ref().map(RunFolder::new).filter(|run| member.is_some() && run.identity().exists());
    if let (Some(run), None) = (&args.run, &begun) {
        check_free(&RunFolder::new(run))?;
    }
    let mut found = None;
    let default = || {
        if args.environment.is_named() {
            return Ok(OF_ENVIRONMENTS);
        }
        Ok(default_preset(&found.insert(Tools::find()?).torch))
    };
    let preset = args.overrides.preset(args.preset.as_deref(), default)?;
    let mut overrides = args.overrides.clone();
    overrides.set.extend(args.environment.settings(&args.overrides)?);
    let resolved = args.hosts.resolve(&overrides, &preset, member.as_ref());
    let mut config = resolved.map_err(|error| match error.downcast_ref() {
        Some(ConfigError::OutOfRange { key: "network.goal" | "auxiliary.task", .. })
            if args.environment.is_named() && preset != OF_ENVIRONMENTS =>
        {
            wrong(anyhow!("preset {preset} is for the kitchens; leave --preset out ({OF_ENVIRONMENTS})"))
        }
        _ => error,
    })?;
    demand!(
        !needs_environment(&preset, &config),
        "preset {preset} needs `--env gymnasium:ID`, or a task of your own: its constants are not for kitchens"
    );
    check_hosts(&config, member.as_ref())?;
    let started = args.hosts.started(member.as_ref())?;
    if let Some(folder) = begun {
        return go_on(folder, config, started, args.hosts.patience().lost);
    }
    if let Some(from) = &args.from {
        suite::refuse(from)?;
        config.from = Some(begin_from(from, &find(from)?.checkpoint()?, &config)?);
    }
    // The default was needed: nobody asked for a preset, on the command line or in a file.
    let asked = found.is_none();
    let tools = match found {
        Some(tools) => tools,
        None => Tools::find()?,
    };
    let named = args.run.clone().unwrap_or_else(|| default_folder(&config));
    demand_all(&started.part(&config), &RunFolder::new(&named), &tools)?;
    scenes::check(&config)?;
    introduce(&config, asked);
    if let Some(FromConfig { checkpoint, frames, .. }) = &config.from {
        terminal::note(&format!("begins with the weights of {checkpoint}, {} frames", format::count(*frames)));
    }
    if let Some(warning) = next_steps::without_stage_one(&config, |_| "`--from RUN`".to_owned()) {
        terminal::note(&warning);
    }
    let folder = if args.run.is_some() { RunFolder::new(named) } else { new_folder(&named)? };
    let (identity, lock) = create(&folder, &mut config, &[folder.checkpoints(), folder.recordings()])?;
    if args.view {
        show(&folder);
    }
    let is_demonstration = !asked && config.preset == "demo";
    let (run, settings) = (folder.clone(), config.clone());
    let training =
        TrainingRun { folder: run, config: settings, identity, lock, tools, started, is_tested: is_demonstration };
    let ended = training.run()?;
    if is_demonstration && let Some(summary) = Summary::read(&folder)? {
        evaluate(&folder, &config, !summary.recordings.is_empty());
    }
    Ok(ended)
}

impl UpArgs {
    /// The run folder, which nobody can make up who shares it with other hosts.
    fn shared_run(&self) -> Result<&Path> {
        let run = self.run.as_deref();
        judged(run.context("several hosts need --run DIR: the same name on all, on a shared disk or not"))
    }

    fn otherwise(&self, hosts: u32, run: &Config, folder: &RunFolder) -> Result<Vec<String>> {
        let mut found = self.hosts.otherwise(&self.overrides, self.preset.as_deref(), hosts, run, folder)?;
        if let Some(from) = self.from.as_deref() {
            found.extend(other_weights(from, run.from.as_ref()));
        }
        Ok(found)
    }
}

fn check_hosts(config: &Config, member: Option<&Membership>) -> Result<()> {
    let Some(Membership { hosts, by, .. }) = member else { return Ok(()) };
    if config.learner.count < *hosts {
        reject!(
            "{hosts} hosts ({by}) cannot share {}: every host has learners of its own, so give --learners {hosts} or more, or \
             --learners-per-host 1",
            counted(u64::from(config.learner.count), "learner")
        );
    }
    Ok(())
}

/// Starts a viewer that ends with this process. Without one the run goes on all the same.
fn show(folder: &RunFolder) {
    let started = std::env::current_exe().and_then(|program| {
        let mut command = viewer(&program, folder);
        // Standard output is the run's, down to its last line.
        command.stdin(std::process::Stdio::null()).stdout(std::io::stderr()).spawn()
    });
    if let Err(error) = started {
        terminal::note(&format!("cannot start a viewer ({error}): `orchestrator view {}`", quoted(folder.root())));
    }
}

/// Episodes of each test kitchen that end the demonstration: each category once.
const TESTED: &str = "6";

/// Ends the demonstration with a short test, so that its page and its report have results, and says what can be
/// done next.
fn evaluate(folder: &RunFolder, config: &Config, recorded: bool) {
    let words = ["eval", "--episodes", TESTED, "--record", "all"];
    let ended = std::env::current_exe().and_then(|program| {
        // Standard output is the run's, down to its last line.
        std::process::Command::new(program).args(words).arg(folder.root()).stdout(std::io::stderr()).status()
    });
    let program = next_steps::program();
    if !ended.as_ref().is_ok_and(std::process::ExitStatus::success) {
        terminal::note(&format!("the test was not played to its end: `{program} eval {}`", quoted(folder.root())));
    }
    for line in next_steps::complete(&program, folder, config, recorded) {
        terminal::note(&line);
    }
}

/// The command of a viewer. It is no part of the run, and starts a browser: so it gets no token.
pub(crate) fn viewer(program: &Path, folder: &RunFolder) -> std::process::Command {
    let mut command = std::process::Command::new(program);
    command.args(["--parent", &std::process::id().to_string(), "view"]).arg(folder.root()).arg("--open");
    command.env_remove(TOKEN).env_remove(TOKEN_FILE);
    command
}

/// Whose weights the run begins with; refused where the networks differ.
fn begin_from(from: &Path, found: &Found, config: &Config) -> Result<FromConfig> {
    let differences = network_differences(&found.config, config)?;
    if !differences.is_empty() {
        let (theirs, ours, from) = (&found.config.task, &config.task, from.display());
        demand!(theirs == ours, "{from} is of the task {theirs}, this run of {ours}: their networks differ");
        reject!(
            "{from} holds another network: {}. Give this run the other's preset, or its [network] in a file for --config",
            differences.join("; ")
        );
    }
    let Manifest { frames, weights, .. } = read_manifest(&found.named, &found.manifest)?;
    let checkpoint = found.manifest.to_str().context("the checkpoint has a name that is not text")?.to_owned();
    Ok(FromConfig { checkpoint, frames, weights, stages: found.config.whole_curriculum() })
}

/// That `from` names other weights than the run began with. Where this host cannot read them, the names tell.
fn other_weights(from: &Path, begun: Option<&FromConfig>) -> Option<String> {
    let Some(begun) = begun else { return Some(format!("--from {} instead of none", from.display())) };
    let weights = || {
        let found = find(from)?.checkpoint()?;
        Ok::<_, anyhow::Error>(read_manifest(&found.named, &found.manifest)?.weights)
    };
    let same_name = std::path::absolute(from).is_ok_and(|from| Path::new(&begun.checkpoint).starts_with(from));
    let is_same = same_name || weights().is_ok_and(|weights| weights == begun.weights);
    (!is_same).then(|| format!("--from {} instead of {}", from.display(), begun.checkpoint))
}

fn default_folder(config: &Config) -> PathBuf {
    // Of somebody's environments the preset is the same.
    let what = if config.environment.is_some() { &config.task } else { &config.preset };
    Path::new("runs").join(format!("{}-{what}-{}", format::timestamp(unix_now()), config.seed))
}

fn introduce(config: &Config, asked: bool) {
    let frames = format::count(total_frames(&config.stages));
    if config.preset == "demo" && config.environment.is_none() {
        let why = if asked { "" } else { "No CUDA device was found. " };
        let full = ["paper", "recipe"].map(|preset| next_steps::full_run("orchestrator", preset, std::env::args()));
        let full = match full {
            [Some(paper), Some(recipe)] => format!(
                " The full run is `{paper}` (19 environments, the paper's exact shape) or `{recipe}` on a machine with a GPU."
            ),
            _ => String::new(),
        };
        terminal::note(&format!(
            "{why}This is a demonstration, not the paper's experiment: a small encoder, episodes that begin near their \
             target, {frames} frames instead of 45,000,000.{full}"
        ));
    } else if !asked {
        terminal::note(&format!("preset {}: {frames} frames", config.preset));
    }
    if config.environment.is_some() {
        terminal::note(&format!("restore {}", config.spec().restore.describe()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::EnvironmentConfig;

    #[test]
    fn a_run_of_somebodys_environments_is_called_after_their_task() {
        let named =
            |config: &Config| default_folder(config).display().to_string().split_once('-').unwrap().1[7..].to_owned();
        let mut config = Config::resolve("gym", None).unwrap();
        assert_eq!(named(&config), "gym-1");
        config.environment = Some(EnvironmentConfig { command: vec!["python".to_owned()], declaration: String::new() });
        config.task = "cart_pole_v1".to_owned();
        assert_eq!(named(&config), "cart_pole_v1-1");
    }
}
