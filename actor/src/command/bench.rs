use actor::bench;
use actor::bench::action_source::PolicyKind;
use anyhow::Result;
use proto::kitchen::KitchenChoice;
use std::path::PathBuf;

/// What to measure.
#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    /// Kitchens: `all` 29, or numbers with commas between, or procedural ones, such as 1000..1032.
    #[arg(long, default_value = "all", value_name = "all|1,2,...")]
    kitchens: KitchenChoice,
    /// A scene of your own instead: its TOML file.
    #[arg(long, value_name = "FILE.toml", conflicts_with = "kitchens")]
    scene: Option<PathBuf>,
    /// Who chooses the actions.
    #[arg(long, value_delimiter = ',', default_values_t = PolicyKind::ALL, value_name = "POLICY,...")]
    policies: Vec<PolicyKind>,
    /// Seconds for each figure.
    #[arg(long, default_value_t = 0.2, value_name = "S")]
    seconds: f64,
    /// Print JSON, every kitchen by itself.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &BenchArgs) -> Result<()> {
    bench::run(&bench::Options {
        kitchens: args.kitchens.0.clone(),
        scene: args.scene.clone(),
        policies: args.policies.clone(),
        seconds: args.seconds,
        json: args.json,
    })
}
