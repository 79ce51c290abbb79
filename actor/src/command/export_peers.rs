use actor::bench::action_source::PolicyKind;
use actor::export;
use anyhow::Result;
use proto::kitchen::KitchenChoice;
use std::path::PathBuf;

/// What to write.
#[derive(Debug, clap::Args)]
pub struct ExportPeersArgs {
    /// Kitchens: `all`, or numbers with commas between.
    #[arg(long, default_value = "all", value_name = "all|1,2,...")]
    kitchens: KitchenChoice,
    /// Who chooses the actions, in an episode each.
    #[arg(long, value_delimiter = ',', default_values_t = PolicyKind::ALL, value_name = "POLICY,...")]
    policies: Vec<PolicyKind>,
    /// Depth frames of each episode.
    #[arg(long, default_value_t = 16, value_name = "N")]
    frames: usize,
    /// The folder to write.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub fn run(args: &ExportPeersArgs) -> Result<()> {
    export::run(&export::Options {
        kitchens: args.kitchens.0.clone(),
        policies: args.policies.clone(),
        frames: args.frames,
        folder: args.out.clone(),
    })
}
