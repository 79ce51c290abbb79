//! `actor bench`, and the hidden command that it calls in a process of its own.

use actor::bench::policy::PolicyKind;
use actor::bench::{self, memory};
use anyhow::Result;
use proto::kitchen::{KitchenChoice, KitchenId};
use std::path::PathBuf;

/// What to measure.
#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    /// Kitchens: `all`, or numbers with commas between.
    #[arg(long, default_value = "all", value_name = "all|1,2,...")]
    kitchens: KitchenChoice,
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
    /// Kitchen.
    #[arg(long, value_parser = actor::arguments::numbered, value_name = "1..30")]
    kitchen: KitchenId,
}

/// Runs `actor bench`.
pub fn run(args: &BenchArgs) -> Result<()> {
    bench::run(&bench::Options {
        kitchens: args.kitchens.0.clone(),
        scene: args.scene.clone(),
        policies: args.policies.clone(),
        seconds: args.seconds,
        memory: !args.no_memory,
        json: args.json,
    })
}

/// Runs `actor bench-memory`.
pub fn run_memory(args: &BenchMemoryArgs) -> Result<()> {
    memory::run(args.kitchen)
}
