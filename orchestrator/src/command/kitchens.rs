//! This program links no physics: `actor kitchens` builds and draws them.

use crate::preflight::programs;
use crate::wrong::{demand, reject};
use anyhow::{Context, Result};
use proto::exit::how;
use proto::kitchen::{KitchenChoice, KitchenId, KitchenRange};
use proto::run_folder::unlike_a_flag;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

/// Draw the kitchens or a scene of your own on one sheet, or write one as a glTF scene
///
/// The sheet shows each kitchen from above, cut at 1.4 m, and as the robot sees it. The glTF scene is a binary file
/// (GLB) for Blender, three.js and other viewers.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # all 29 into kitchens.png
  orchestrator kitchens
  orchestrator kitchens --kitchens 1,2,5 --width 1600 --out some.png
  # forty of the kitchens without end into kitchens.png
  orchestrator kitchens --procedural 1000..1040
  # kitchen 7 into kitchen-7.glb, or a procedural one: --gltf 1007
  orchestrator kitchens --gltf 7
  # a scene of your own into scene.png
  orchestrator kitchens --scene scenes/studio/scene.toml
  # as it came to rest, into scene-settled.glb
  orchestrator kitchens --scene scenes/studio/scene.toml --gltf")]
pub struct KitchensArgs {
    /// Which kitchens are on the sheet: `all` 29, or numbers.
    #[arg(long, default_value = "all", value_name = "all|1,2,5-9", value_parser = several, conflicts_with = "gltf")]
    kitchens: KitchenChoice,
    /// Procedural kitchens are on the sheet instead: from this number up to, but not, that one.
    #[arg(long, value_name = "FIRST..END", conflicts_with_all = ["gltf", "kitchens", "scene"])]
    procedural: Option<KitchenRange>,
    /// Width of the sheet in pixels [default: 1100 to 2200, by the number of kitchens].
    #[arg(long, value_parser = clap::value_parser!(u32).range(320..=8192), conflicts_with = "gltf")]
    width: Option<u32>,
    /// Draw this scene of your own: its TOML file.
    #[arg(long, value_name = "FILE.toml", conflicts_with = "kitchens")]
    scene: Option<PathBuf>,
    /// Write this kitchen, or the scene of --scene, as a glTF scene instead.
    // None: not asked for. Some(None): without a number, for --scene.
    #[arg(long, value_name = "KITCHEN", value_parser = one, num_args = 0..=1)]
    #[allow(clippy::option_option)]
    gltf: Option<Option<KitchenId>>,
    /// File to write [default: kitchens.png, kitchen-N.glb, scene.png or scene-settled.glb].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Numbers, and `5-9` for those from 5 to 9.
fn several(text: &str) -> Result<KitchenChoice, String> {
    let range = |word: &str| {
        let (first, last) = word.split_once('-')?;
        let (first, last): (u32, u32) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
        let numbers = (first..=last).take(1000).map(|number| number.to_string());
        (first <= last).then(|| numbers.collect::<Vec<_>>().join(","))
    };
    let words: Vec<String> = text.split(',').map(|word| range(word).unwrap_or_else(|| word.to_owned())).collect();
    words.join(",").parse()
}

fn one(text: &str) -> Result<KitchenId, String> {
    let number = text.parse().map_err(|_| format!("`{text}` is not a kitchen number"))?;
    KitchenId::generated(number).map_err(|error| error.to_string())
}

pub fn run(args: &KitchensArgs) -> Result<ExitCode> {
    let program = programs::find("actor")?;
    let mut command = Command::new(&program);
    command.arg("kitchens");
    let default_name = match (&args.scene, args.gltf) {
        (Some(_), Some(Some(kitchen))) => {
            reject!("--gltf {kitchen} and --scene name two things to write: leave out one, or the number after --gltf");
        }
        (None, Some(None)) => {
            reject!("--gltf needs the number of a kitchen, --gltf 7, or a scene, --scene FILE.toml");
        }
        (None, Some(Some(kitchen))) => {
            command.args(["gltf", "--kitchen", &kitchen.to_string()]);
            format!("kitchen-{kitchen}.glb")
        }
        (Some(scene), Some(None)) => {
            command.args(["gltf", "--of-scene"]).arg(unlike_a_flag(scene));
            "scene-settled.glb".to_owned()
        }
        (Some(scene), None) => {
            command.arg("sheet").arg("--scene").arg(unlike_a_flag(scene));
            "scene.png".to_owned()
        }
        (None, None) => {
            let kitchens = args.procedural.map_or_else(|| args.kitchens.to_string(), |range| range.to_string());
            command.args(["sheet", "--kitchens", &kitchens]);
            "kitchens.png".to_owned()
        }
    };
    if let Some(width) = args.width {
        command.args(["--width", &width.to_string()]);
    }
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from(&default_name));
    let ending = Path::new(&default_name).extension();
    demand!(out.extension() == ending, "--out {}: the name has to end as {default_name} does", out.display());
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty());
    demand!(folder.is_none_or(Path::is_dir), "--out {}: there is no such folder", out.display());
    command.arg("--out").arg(unlike_a_flag(out));
    // It ends with us, however we end: the pipe is its lifeline.
    let actor = command.arg("--lifeline").stdin(Stdio::piped()).spawn();
    let mut actor = actor.with_context(|| format!("cannot start {}", program.display()))?;
    let lifeline = actor.stdin.take();
    let status = actor.wait().with_context(|| format!("cannot wait for {}", program.display()))?;
    drop(lifeline);
    // What went wrong it has printed itself.
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    code.map(ExitCode::from).with_context(|| format!("`actor kitchens` {}", how(status)))
}
