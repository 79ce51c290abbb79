//! The `actor` program: rolls out environments for a learner, re-simulates recordings, measures itself.

use actor::bench::policy::PolicyKind;
use actor::process::{self, lifeline, whereabouts};
use actor::{bench, export, replay, soak};
use anyhow::{Context, Result, ensure};
use clap::{Parser, Subcommand};
use proto::kitchen::KitchenId;
use proto::wire::WireAddress;
use std::path::PathBuf;
use std::process::ExitCode;

/// Simulates kitchens for Stillroom.
///
/// Without a subcommand it is one rollout actor of a run; `orchestrator up` starts it as such.
#[derive(Debug, Parser)]
#[command(version, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// Number among the run's actors, from 0.
    #[arg(long, required = true, value_name = "N")]
    actor: Option<u32>,
    /// Where the run's shared-memory services are.
    #[arg(long, required = true, value_name = "PREFIX@FOLDER")]
    wire: Option<WireAddress>,
    /// The run's effective configuration.
    #[arg(long, required = true, value_name = "RUN/config.toml")]
    config: Option<PathBuf>,
    /// How often this actor has been started in this incarnation of the run.
    #[arg(long, default_value_t = 1, value_name = "N")]
    incarnation: u32,
    /// Exit when standard input closes, and leave Ctrl-C to whoever holds its other end.
    #[arg(long)]
    lifeline: bool,
    /// Simulate this kitchen in place of the actor's own; not with --lifeline.
    #[arg(long, value_parser = kitchen, value_name = "1..30")]
    kitchen: Option<KitchenId>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Re-simulate recorded episodes: reads them from standard input, writes verdicts to standard output.
    Replay,
    /// Measure physics, rendering and whole steps on one core.
    Bench {
        /// Kitchens to measure in: `all`, or numbers with commas between.
        #[arg(long, value_parser = kitchens, default_value = "all", value_name = "all|1,2,...")]
        kitchens: Kitchens,
        /// Who chooses the actions.
        #[arg(long, value_delimiter = ',', default_values_t = PolicyKind::ALL, value_name = "POLICY,...")]
        policies: Vec<PolicyKind>,
        /// Seconds for each figure.
        #[arg(long, default_value_t = 0.2, value_name = "S")]
        seconds: f64,
        /// Leave out the memory of a further environment.
        #[arg(long)]
        no_memory: bool,
        /// Print JSON, every kitchen by itself.
        #[arg(long)]
        json: bool,
    },
    /// Write kitchens, episodes and frames for other programs to be measured on; `make bench-peers` calls this.
    ExportPeers {
        /// Kitchens to export: `all`, or numbers with commas between.
        #[arg(long, value_parser = kitchens, default_value = "all", value_name = "all|1,2,...")]
        kitchens: Kitchens,
        /// Who chooses the actions, in an episode each.
        #[arg(long, value_delimiter = ',', default_values_t = PolicyKind::ALL, value_name = "POLICY,...")]
        policies: Vec<PolicyKind>,
        /// Depth frames of each episode.
        #[arg(long, default_value_t = 16, value_name = "N")]
        frames: usize,
        /// The folder to write.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Print the memory of a further environment; `bench` calls this in a process of its own.
    #[command(hide = true)]
    BenchMemory {
        /// Kitchen to measure in.
        #[arg(long, value_parser = kitchen, value_name = "1..30")]
        kitchen: KitchenId,
    },
    /// Take random actions in many kitchens; fails if anything moves too fast, leaves the room or is not a number.
    Soak {
        /// Actions in all, spread evenly over the kitchens.
        #[arg(long, default_value_t = 100_000, value_name = "N")]
        steps: u64,
        /// Kitchens.
        #[arg(long, value_parser = kitchens, default_value = "all", value_name = "all|1,2,..")]
        kitchens: Kitchens,
        /// What the actions and episodes are drawn from.
        #[arg(long, default_value_t = 1, value_name = "SEED")]
        seed: u64,
    },
}

/// One or more kitchens, as given on the command line.
#[derive(Debug, Clone)]
struct Kitchens(Vec<KitchenId>);

fn kitchens(text: &str) -> Result<Kitchens, String> {
    if text == "all" {
        return Ok(Kitchens(KitchenId::all().collect()));
    }
    text.split(',').map(kitchen).collect::<Result<_, _>>().map(Kitchens)
}

fn kitchen(text: &str) -> Result<KitchenId, String> {
    let number: u8 = text.parse().map_err(|_| format!("`{text}` is not a kitchen number"))?;
    KitchenId::new(number).map_err(|error| error.to_string())
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    proto::logging::to_stderr();
    whereabouts::name_it_in_panics();
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let place = whereabouts::here().map(|here| format!(" ({here})")).unwrap_or_default();
            tracing::error!("{error:#}{place}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments) -> Result<()> {
    match arguments.command {
        Some(Command::Replay) => replay::run(std::io::stdin().lock(), std::io::stdout().lock()),
        Some(Command::Soak { steps, kitchens, seed }) => soak::run(&kitchens.0, steps, seed),
        Some(Command::Bench { kitchens: Kitchens(kitchens), policies, seconds, no_memory, json }) => {
            bench::run(&bench::Options { kitchens, policies, seconds, memory: !no_memory, json })
        }
        Some(Command::ExportPeers { kitchens: Kitchens(kitchens), policies, frames, out }) => {
            export::run(&export::Options { kitchens, policies, frames, folder: out })
        }
        Some(Command::BenchMemory { kitchen }) => bench::memory::run(kitchen),
        None => {
            ensure!(
                !(arguments.lifeline && arguments.kitchen.is_some()),
                "--kitchen cannot be used in a run (--lifeline): its recordings name environments by actor number, \
                 from which the kitchen follows"
            );
            if arguments.lifeline {
                lifeline::hold().context("cannot watch standard input")?;
            }
            let settings = process::Settings {
                actor: arguments.actor.context("--actor is missing")?,
                incarnation: arguments.incarnation,
                wire: arguments.wire.context("--wire is missing")?,
                config: arguments.config.context("--config is missing")?,
                kitchen: arguments.kitchen,
            };
            match process::run(&settings)? {}
        }
    }
}
