use actor::check::{kitchens, scene};
use anyhow::Result;
use proto::kitchen::KitchenChoice;
use std::path::PathBuf;

/// What to check.
#[derive(Debug, clap::Args)]
pub struct CheckArgs {
    /// Kitchens: `all` 29, or numbers with commas between, or procedural ones, such as 1000..1040.
    #[arg(long, default_value = "all", value_name = "all|1,2,...", conflicts_with = "scene")]
    kitchens: KitchenChoice,
    /// A scene of your own instead: its TOML file.
    #[arg(long, value_name = "FILE.toml")]
    scene: Option<PathBuf>,
    /// Copy the scene's files into this folder if all is well.
    #[arg(long, value_name = "DIR", requires = "scene")]
    copy: Option<PathBuf>,
    /// Print the categories of its targets only, one a line.
    #[arg(long, requires = "scene")]
    targets: bool,
}

pub fn run(args: &CheckArgs) -> Result<()> {
    let out = std::io::stdout().lock();
    match &args.scene {
        Some(path) => scene::run(path, args.copy.as_deref(), args.targets, out),
        None => kitchens::run(&args.kitchens.0, out),
    }
}
