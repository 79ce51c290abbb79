//! `actor bench`, the hidden command that it calls in a process of its own, and the one that `make bench-python` calls.

use actor::arguments::numbered;
use actor::bench::action_source::PolicyKind;
use actor::bench::{self, apart, beside, memory};
use anyhow::{Context, Result};
use proto::kitchen::{KitchenChoice, KitchenId};
use std::path::PathBuf;

/// What to measure.
#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    /// Kitchens: `all` 29, or numbers with commas between, or procedural ones, such as 1000..1032.
    #[arg(long, default_value = "all", value_name = "all|1,2,...")]
    kitchens: KitchenChoice,
    /// As many environments as kitchens, each in a kitchen of its own, beside as many in one.
    #[arg(long, conflicts_with_all = ["scene", "json"])]
    apart: bool,
    /// A scene of your own instead: its TOML file. Memory is not measured then.
    #[arg(long, value_name = "FILE.toml", conflicts_with = "kitchens")]
    scene: Option<PathBuf>,
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
}

/// Where to measure memory.
#[derive(Debug, clap::Args)]
pub struct BenchMemoryArgs {
    /// Kitchens: the first of them, or with --apart all.
    #[arg(long, value_name = "1,2,...")]
    kitchens: KitchenChoice,
    /// A folder that keeps them: one environment in each.
    #[arg(long, value_name = "DIR")]
    apart: Option<PathBuf>,
}

/// What to drive from standard input.
#[derive(Debug, clap::Args)]
pub struct BenchBesideArgs {
    /// Kitchen of all environments.
    #[arg(long, value_parser = numbered)]
    kitchen: KitchenId,
    /// How many environments.
    #[arg(long, value_name = "N")]
    environments: u32,
    /// Seed of their episodes.
    #[arg(long, value_name = "S")]
    seed: u64,
    /// Steps of a turn.
    #[arg(long, value_name = "N")]
    steps: u32,
}

/// Runs `actor bench`.
pub fn run(args: &BenchArgs) -> Result<()> {
    bench::run(&bench::Options {
        kitchens: args.kitchens.0.clone(),
        scene: args.scene.clone(),
        policies: args.policies.clone(),
        seconds: args.seconds,
        memory: !args.no_memory,
        apart: args.apart,
        json: args.json,
    })
}

/// Runs `actor bench-memory`.
pub fn run_memory(args: &BenchMemoryArgs) -> Result<()> {
    match &args.apart {
        Some(folder) => apart::print_memory(&args.kitchens.0, folder),
        None => memory::run(*args.kitchens.0.first().context("--kitchens names none")?),
    }
}

/// Runs `actor bench-beside`.
pub fn run_beside(args: &BenchBesideArgs) -> Result<()> {
    let &BenchBesideArgs { kitchen, environments, seed, steps } = args;
    let options = beside::Options { kitchen, environments, seed, steps };
    beside::run(options, std::io::stdin().lock(), std::io::stdout().lock())
}
