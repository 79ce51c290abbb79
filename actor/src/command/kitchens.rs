use actor::sheet::{SheetOptions, Subject, sheet};
use actor::{categories, kitchen_export};
use anyhow::{Context, Result};
use proto::kitchen::{KitchenChoice, KitchenId};
use std::path::PathBuf;
use wire::lifeline;

/// What to make of kitchens.
#[derive(Debug, clap::Subcommand)]
pub enum KitchensCommand {
    /// Draw kitchens on one sheet: floor plan and robot's view of each.
    Sheet {
        /// Which: `all` 29, or numbers with commas between, or procedural ones, such as 1000..1040.
        #[arg(long, default_value = "all", value_name = "all|1,2,...")]
        kitchens: KitchenChoice,
        /// Scenes of your own instead: their TOML files.
        #[arg(long, value_name = "FILE.toml", conflicts_with = "kitchens", num_args = 1..)]
        scene: Vec<PathBuf>,
        /// Width of the picture, pixels [default: 1100 to 2200, by the number of kitchens].
        #[arg(long, value_name = "PIXELS")]
        width: Option<u32>,
        /// The PNG file.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// End when standard input does, as `orchestrator kitchens` wants it.
        #[arg(long, hide = true)]
        lifeline: bool,
    },
    /// Write a kitchen as a binary glTF scene.
    Gltf {
        /// Which.
        #[arg(long, value_parser = actor::arguments::numbered, value_name = "1..30", required_unless_present = "of_scene")]
        kitchen: Option<KitchenId>,
        /// A scene of your own instead, as it came to rest: its TOML file.
        #[arg(long, value_name = "FILE.toml", conflicts_with = "kitchen")]
        of_scene: Option<PathBuf>,
        /// The GLB file.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Write the scene file, too, with which it can be loaded again.
        #[arg(long, value_name = "FILE.toml")]
        scene: Option<PathBuf>,
        /// End when standard input does, as `orchestrator kitchens` wants it.
        #[arg(long, hide = true)]
        lifeline: bool,
    },
    /// List the categories of movable things: size, mass, whether it can be a target, where it stands.
    Categories {
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
}

pub fn run(command: &KitchensCommand) -> Result<()> {
    match command {
        KitchensCommand::Sheet { kitchens, scene, width, out, lifeline } => {
            hold(*lifeline)?;
            let built_in = || kitchens.0.iter().map(|&id| Subject::BuiltIn(id)).collect();
            let scenes = || scene.iter().cloned().map(Subject::Scene).collect();
            let subjects = if scene.is_empty() { built_in() } else { scenes() };
            sheet(&SheetOptions { subjects, width: *width, out: out.clone() })
        }
        KitchensCommand::Gltf { kitchen, of_scene, out, scene, lifeline } => {
            hold(*lifeline)?;
            let subject = match of_scene {
                Some(path) => Subject::Scene(path.clone()),
                None => Subject::BuiltIn(kitchen.context("--kitchen is missing")?),
            };
            kitchen_export::write(&subject, out, scene.as_deref())
        }
        KitchensCommand::Categories { json } => categories::run(*json, std::io::stdout().lock()),
    }
}

fn hold(asked: bool) -> Result<()> {
    if asked {
        lifeline::hold(|| std::process::exit(1)).context("cannot watch standard input")?;
    }
    Ok(())
}
