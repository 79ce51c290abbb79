//! `actor kitchens`.

use actor::gltf;
use actor::kitchen::report;
use actor::picture::{self, SheetOptions};
use anyhow::Result;
use proto::kitchen::{KitchenChoice, KitchenId};
use std::path::PathBuf;

/// What to make of kitchens.
#[derive(Debug, clap::Subcommand)]
pub enum KitchensCommand {
    /// Draw kitchens on one sheet: floor plan and robot's view of each.
    Sheet {
        /// Which: `all`, or numbers with commas between.
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
        #[arg(long, value_parser = actor::kitchen::numbered, value_name = "1..30")]
        kitchen: KitchenId,
        /// The GLB file.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Write the scene file, too, with which it can be loaded again.
        #[arg(long, value_name = "FILE.toml")]
        scene: Option<PathBuf>,
    },
    /// Print our kitchens' figures beside iTHOR's; fails if they are too far apart.
    Report,
}

/// Runs the command.
pub fn run(command: &KitchensCommand) -> Result<()> {
    match command {
        KitchensCommand::Sheet { kitchens, width, out } => {
            picture::sheet(&SheetOptions { kitchens: kitchens.0.clone(), width: *width, out: out.clone() })
        }
        KitchensCommand::Gltf { kitchen, out, scene } => gltf::export::write(*kitchen, out, scene.as_deref()),
        KitchensCommand::Report => report::run(std::io::stdout().lock()),
    }
}
