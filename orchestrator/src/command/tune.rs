//! `orchestrator tune`: the fastest shape of a run on this machine.

use super::overrides::{Overrides, default_preset};
use crate::preflight::all::demand_all;
use crate::preflight::tools::Tools;
use crate::run::identity::unix_now;
use crate::showing::format;
use crate::showing::terminal;
use crate::supervisor::session::EXIT_INTERRUPTED;
use crate::training::next_steps::program;
use crate::tuning::search::{Choice, Search, Speed, Tried};
use crate::tuning::trial::{self, Interrupts, Outcome, Patience, Workshop};
use anyhow::{Context, Result, bail};
use proto::config::{Config, MachineConfig, Pin, presets};
use proto::run_folder::RunFolder;
use proto::shell::quoted;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Trials that a search usually needs.
const TRIALS: u32 = 8;

/// Measure which shape of a run is fastest on this machine
///
/// Short runs with the real programs: first twice as many environments in each actor, as long as that pays, then with
/// processes held to cores near their GPU (`machine.pin`), then other lengths of a rollout. The number of actors stays.
/// The table goes to standard error, the fastest shape to standard output, as a configuration file. More environments
/// and a longer rollout make a larger batch, and so fewer updates of as many frames: they also change what is learned.
/// Everything that is started is stopped and removed again.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator tune > fast.toml && orchestrator up --config fast.toml
  orchestrator tune --preset recipe --actors 38 --learners 2 --minutes 10 --out fast.toml
  orchestrator tune --preset paper --minutes 3     chooses environments and cores; T is the paper's")]
pub struct TuneArgs {
    /// Preset to begin with [default: the one that `up` would take]
    #[arg(long, value_name = "P")]
    preset: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
    /// Begin no trial that would not end within so many minutes
    #[arg(long, value_name = "M", default_value_t = 5.0)]
    minutes: f64,
    /// Lengths of a rollout to choose from, with commas between [default: those that the preset leaves open]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=4096))]
    steps: Vec<u32>,
    /// Write the configuration to this file, too
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of a configuration: `preset`, `best`, the `trials` in their order with shape, speed
    /// and shares of the time, or `error`, and the `configuration` as TOML
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &TuneArgs) -> Result<ExitCode> {
    if !(args.minutes > 0.0 && args.minutes <= 1440.0) {
        bail!("--minutes {}: must be above 0 and at most 1440", args.minutes);
    }
    let tools = Tools::find()?;
    let preset = args.overrides.preset(args.preset.as_deref(), || Ok(default_preset(&tools.torch)))?;
    let config = args.overrides.resolve(&preset)?;
    let open = presets().iter().find(|known| known.name == preset).map(proto::config::Preset::open_rollout_steps);
    let steps = if args.steps.is_empty() { open.unwrap_or_default() } else { args.steps.clone() };
    let start = Choice {
        environments: config.actors.environments_per_actor,
        steps: config.ppo.rollout_steps,
        pinned: config.machine.pin != Pin::Automatic(false),
    };
    // What the user asked for must work; what is tried from there on need not.
    demand_all(&config, &RunFolder::new(wire::temporary_folder()), &tools)?;
    let mut search = Search::new(start, steps);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("tokio")?;
    let cut_short = runtime.block_on(explore(args, &config, &tools, &mut search))?;
    if cut_short == Some(Cut::Interrupted) {
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    }
    let Some(best) = search.best() else {
        let why = search.tried.iter().find_map(|tried| tried.result.as_ref().err());
        bail!("nothing could be measured: {}", why.map_or("no time for a single trial", String::as_str));
    };
    let text = configuration(&config, &search, best);
    if let Some(path) = &args.out {
        std::fs::write(path, &text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if args.json {
        terminal::out_json(&as_json(&config, &search, best, &text))?;
    } else {
        terminal::out(text.trim_end());
    }
    let file = args.out.as_ref().map_or_else(|| "FILE".to_owned(), quoted);
    let own = [("--config", args.overrides.config.is_some()), ("--set", !args.overrides.set.is_empty())];
    let own: Vec<&str> = own.into_iter().filter(|(_, given)| *given).map(|(flag, _)| flag).collect();
    let beside =
        if own.is_empty() { String::new() } else { format!(" (with the keys of your {} in it)", own.join(" and ")) };
    terminal::note(&format!("run it with: {} up --config {file}{beside}", program()));
    Ok(ExitCode::SUCCESS)
}

/// Why a search ended before it knew all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cut {
    Time,
    Interrupted,
}

/// Tries shapes until all is known or the time is over.
async fn explore(args: &TuneArgs, config: &Config, tools: &Tools, search: &mut Search) -> Result<Option<Cut>> {
    let mut interrupts = Interrupts::install()?;
    let workshop = Workshop::new()?;
    let began = Instant::now();
    let whole = Duration::from_secs_f64(args.minutes * 60.0);
    let enough = (whole / TRIALS / 2).clamp(Duration::from_secs(1), Duration::from_secs(30));
    let mut slowest = Duration::ZERO;
    terminal::note(&head(config));
    while let Some(choice) = search.next() {
        let left = whole.saturating_sub(began.elapsed());
        if left < slowest || left.is_zero() {
            terminal::note(&format!("{} min are over: {} is not tried", args.minutes, shape(config, choice)));
            return Ok(Some(Cut::Time));
        }
        let trial_began = Instant::now();
        let changed = with(config, choice);
        let result =
            match changed.validate().map_err(Into::into).and_then(|()| demand_all(&changed, &workshop.run(), tools)) {
                Err(problem) => Err(format!("{problem:#}")),
                Ok(()) => {
                    match trial::run(&workshop, &changed, Patience { enough, longest: left }, &mut interrupts).await? {
                        Outcome::Measured(speed) => Ok(speed),
                        Outcome::Failed(reason) => Err(reason),
                        Outcome::Interrupted => return Ok(Some(Cut::Interrupted)),
                    }
                }
            };
        slowest = slowest.max(trial_began.elapsed());
        let tried = Tried { choice, result };
        terminal::note(&line(config, &tried));
        search.tried.push(tried);
    }
    Ok(None)
}

/// The configuration of a trial. Nothing is validated beside it, and it is saved only when it begins and ends.
fn with(config: &Config, choice: Choice) -> Config {
    let mut changed = config.clone();
    changed.actors.environments_per_actor = choice.environments;
    changed.ppo.rollout_steps = choice.steps;
    changed.machine = machine(config, choice);
    changed.validation.every_frames = 0;
    changed.checkpoint.interval_s = 3600.0;
    changed
}

/// Cores that the user named are kept where processes are pinned.
fn machine(config: &Config, choice: Choice) -> MachineConfig {
    let pin = match (&config.machine.pin, choice.pinned) {
        (_, false) => Pin::Automatic(false),
        (Pin::Automatic(_), true) => Pin::Automatic(true),
        (Pin::Cores(cores), true) => Pin::Cores(cores.clone()),
    };
    MachineConfig { pin }
}

fn head(config: &Config) -> String {
    format!(
        "{}, {} actors\n{:>12}  {:>4}  {:>6}  {:>9}  {:>7}  {:>5}  {:>6}  {:>5}",
        config.preset,
        config.actors.count,
        "environments",
        "T",
        "pinned",
        "frames/s",
        "waiting",
        "infer",
        "update",
        "other"
    )
}

fn shape(config: &Config, Choice { environments, steps, pinned }: Choice) -> String {
    let pinned = if pinned { "yes" } else { "no" };
    format!("{:>12}  {steps:>4}  {pinned:>6}", format!("{} × {environments}", config.actors.count))
}

fn line(config: &Config, tried: &Tried) -> String {
    let shape = shape(config, tried.choice);
    match &tried.result {
        Err(reason) => format!("{shape}  {reason}"),
        Ok(Speed { frames_per_s, timing }) => {
            let share = |part: f64| format!("{:.0}%", 100.0 * part / timing.total_s());
            let [waiting, infer, update, other] =
                [timing.simulate_s, timing.infer_s, timing.update_s, timing.other_s].map(share);
            let rate = format::rate(*frames_per_s);
            format!("{shape}  {rate:>9}  {waiting:>7}  {infer:>5}  {update:>6}  {other:>5}")
        }
    }
}

/// The same for scripts.
fn as_json(config: &Config, search: &Search, best: Choice, configuration: &str) -> Value {
    let shape = |Choice { environments, steps, pinned }: Choice| {
        json!({
            "actors": config.actors.count,
            "environments_per_actor": environments,
            "rollout_steps": steps,
            "pinned": pinned,
            "learners": config.learner.count,
        })
    };
    let trial = |tried: &Tried| match &tried.result {
        Err(reason) => json!({ "shape": shape(tried.choice), "error": reason }),
        Ok(Speed { frames_per_s, timing }) => {
            let share = |part: f64| part / timing.total_s();
            json!({
                "shape": shape(tried.choice),
                "frames_per_s": frames_per_s,
                "simulate": share(timing.simulate_s),
                "infer": share(timing.infer_s),
                "update": share(timing.update_s),
                "other": share(timing.other_s),
            })
        }
    };
    json!({
        "preset": config.preset,
        "best": shape(best),
        "trials": search.tried.iter().map(trial).collect::<Vec<_>>(),
        "configuration": configuration,
    })
}

/// The file: what was chosen, and what it brings.
fn configuration(config: &Config, search: &Search, best: Choice) -> String {
    let rate = |choice| search.speed(choice).map_or_else(|| "not measured".to_owned(), format::rate);
    let start = search.tried.first().map(|tried| rate(tried.choice)).unwrap_or_default();
    format!(
        "# orchestrator tune, {}: {} frames/s, {start} before\n\
         preset = \"{}\"\n\n\
         [actors]\ncount = {}\nenvironments_per_actor = {}\n\n\
         [ppo]\nrollout_steps = {}\n\n\
         [learner]\ncount = {}\n\n\
         [machine]\npin = {}\n",
        format::date(unix_now()),
        rate(best),
        config.preset,
        config.actors.count,
        best.environments,
        best.steps,
        config.learner.count,
        machine(config, best).pin,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::event::Timing;

    #[test]
    fn the_file_that_is_printed_is_a_configuration_with_the_best_shape() {
        let mut config = Config::resolve("recipe", None).unwrap();
        config.machine.pin = Pin::Cores(vec![0, 1]);
        let [start, best] = [(16, false), (32, true)].map(|(environments, pinned)| Choice {
            environments,
            steps: config.ppo.rollout_steps,
            pinned,
        });
        let mut search = Search::new(start, vec![]);
        for (choice, frames_per_s) in [(start, 10.0), (best, 20.0)] {
            let timing = Timing { simulate_s: 1.0, infer_s: 2.0, update_s: 1.0, exchange_s: 0.0, other_s: 0.0 };
            search.tried.push(Tried { choice, result: Ok(Speed { frames_per_s, timing }) });
        }
        let text = configuration(&config, &search, best);
        assert!(text.contains("20.0 frames/s, 10.0 before"), "{text}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fast.toml");
        std::fs::write(&path, &text).unwrap();
        let read = Config::resolve("recipe", Some(&path)).unwrap();
        let mut expected = config.clone();
        expected.actors.environments_per_actor = 32;
        assert_eq!(read, expected);
        assert!(line(&config, &search.tried[0]).ends_with("10.0      25%    50%     25%     0%"));
        assert_eq!(machine(&config, start).pin, Pin::Automatic(false));
        search.tried.push(Tried { choice: best, result: Err("no memory".to_owned()) });
        let told = as_json(&config, &search, best, &text);
        assert_eq!(told["best"]["environments_per_actor"], 32);
        let [first, _, last] = [0, 1, 2].map(|number| &told["trials"][number]);
        assert_eq!((&first["frames_per_s"], &first["infer"]), (&json!(10.0), &json!(0.5)));
        assert_eq!((&last["error"], &last["frames_per_s"]), (&json!("no memory"), &Value::Null));
    }
}
