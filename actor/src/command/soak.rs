//! `actor soak`.

use anyhow::Result;
use proto::kitchen::KitchenChoice;

/// How long, and where.
#[derive(Debug, clap::Args)]
pub struct SoakArgs {
    /// Actions in all, spread evenly over the kitchens.
    #[arg(long, default_value_t = 100_000, value_name = "N")]
    steps: u64,
    /// Kitchens: `all`, or numbers with commas between.
    #[arg(long, default_value = "all", value_name = "all|1,2,...")]
    kitchens: KitchenChoice,
    /// What the actions and episodes are drawn from.
    #[arg(long, default_value_t = 1, value_name = "SEED")]
    seed: u64,
}

pub fn run(args: &SoakArgs) -> Result<()> {
    actor::soak::run(&args.kitchens.0, args.steps, args.seed)
}
