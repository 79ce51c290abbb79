//! `actor check`.

use actor::kitchen::check;
use anyhow::Result;
use proto::kitchen::KitchenChoice;

/// What to check.
#[derive(Debug, clap::Args)]
pub struct CheckArgs {
    /// Kitchens: `all`, or numbers with commas between.
    #[arg(long, default_value = "all", value_name = "all|1,2,...")]
    kitchens: KitchenChoice,
}

/// Runs the command.
pub fn run(args: &CheckArgs) -> Result<()> {
    check::run(&args.kitchens.0, std::io::stdout().lock())
}
