//! The subcommands: each parses its arguments, calls one function of the library, and that prints.

mod check;
mod kitchens;
mod rollout;

pub use rollout::RolloutArgs;

use actor::{bench, episodes, export, harvest, oracle_table, replay, show};
use anyhow::{Context, Result};
use std::io::BufReader;
use wire::lifeline;

/// What else the program can do.
#[derive(Debug, clap::Subcommand)]
pub enum Command {
    /// Re-simulate recorded episodes: reads them from standard input, writes verdicts to standard output.
    Replay,
    /// Re-simulate recorded episodes and write them as a data set: `orchestrator export` calls this.
    Dataset,
    /// Re-simulate episodes and draw them from any camera: `orchestrator view` calls this.
    Show,
    /// Look at kitchens: pictures, scene files, categories of things.
    #[command(subcommand)]
    Kitchens(kitchens::KitchensCommand),
    /// Prove all that a kitchen, or a scene of your own, must satisfy: a line a kitchen, the totals last.
    Check(check::CheckArgs),
    /// The fixed episodes of the validation and test kitchens.
    #[command(subcommand)]
    Episodes(episodes::Command),
    /// Let a planner with privileged knowledge play episodes, to see that they can be solved.
    Oracle(oracle_table::Settings),
    /// Measure physics, rendering and whole steps on one core.
    Bench(bench::Arguments),
    /// Write kitchens, episodes and frames for other programs to be measured on; `make bench-peers` calls this.
    ExportPeers(export::Arguments),
}

pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Replay => {
            lifeline::hold_output(|| std::process::exit(1)).context("cannot watch standard output")?;
            replay::run(std::io::stdin().lock(), std::io::stdout().lock())
        }
        Command::Dataset => harvest::run(BufReader::new(std::io::stdin()), std::io::stdout().lock()),
        Command::Show => show::run(std::io::stdin().lock(), std::io::stdout().lock()),
        Command::Kitchens(command) => kitchens::run(command),
        Command::Check(args) => check::run(args),
        Command::Episodes(command) => episodes::run(command),
        Command::Oracle(settings) => oracle_table::run(settings),
        Command::Bench(args) => bench::run(args),
        Command::ExportPeers(args) => export::run(args),
    }
}
