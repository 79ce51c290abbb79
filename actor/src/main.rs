//! The `actor` program: rolls out environments for a learner, re-simulates recordings, measures itself.

use actor::picture::{self, SheetOptions};
use actor::process::{self, lifeline, whereabouts};
use actor::{bench, gltf, replay};
use anyhow::{Context, Result, ensure};
use clap::{Parser, Subcommand};
use proto::kitchen::{KitchenChoice, KitchenId};
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
    /// Show kitchens.
    #[command(subcommand)]
    Kitchens(Kitchens),
    /// Measure physics, rendering and whole steps on one core.
    Bench {
        /// Kitchen to measure in.
        #[arg(long, value_parser = kitchen, default_value = "1", value_name = "1..30")]
        kitchen: KitchenId,
        /// Seconds for each figure.
        #[arg(long, default_value_t = 1.0, value_name = "S")]
        seconds: f64,
    },
}

#[derive(Debug, Subcommand)]
enum Kitchens {
    /// Draw kitchens on one sheet: floor plan and robot's view of each.
    Sheet {
        /// Which: `all`, or numbers.
        #[arg(long, default_value = "all", value_name = "all|1,2,...")]
        kitchens: KitchenChoice,
        /// Width of the picture, pixels.
        #[arg(long, default_value_t = 2200, value_name = "PIXELS")]
        width: u32,
        /// The PNG file.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Write a kitchen as a binary glTF scene.
    Gltf {
        /// Which.
        #[arg(long, value_parser = kitchen, value_name = "1..30")]
        kitchen: KitchenId,
        /// The GLB file.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
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
        Some(Command::Kitchens(Kitchens::Sheet { kitchens, width, out })) => {
            picture::sheet(&SheetOptions { kitchens: kitchens.0, width, out })
        }
        Some(Command::Kitchens(Kitchens::Gltf { kitchen, out })) => gltf::export::write(kitchen, &out),
        Some(Command::Bench { kitchen, seconds }) => bench::run(kitchen, seconds),
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
