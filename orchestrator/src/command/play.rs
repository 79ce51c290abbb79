use super::player::{Player, SceneArgs};
use super::view::{self, PageArgs};
use anyhow::{Context, Result};
use std::path::{Path, PathBuf};

/// Let a trained policy play, and show it on a page in a browser
///
/// It plays on the CPU until Ctrl-C, episode after episode. Without FILE it is the policy that comes with the programs:
/// trained for 45 million frames, it fetches things in kitchens that it has never seen.
///
/// Keys on the page: space pauses and goes on. Arrow keys turn the camera (with shift they move it), + and - zoom, 0 puts it
/// back.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # the shipped policy in the test kitchens
  orchestrator play
  # the best policy of a run, in one kitchen
  orchestrator play runs/a/best --kitchen 7
  # only prints the page's address
  orchestrator play --no-open --port 8000")]
pub struct PlayArgs {
    /// A policy file (.safetensors), a run folder, RUN/best, or a checkpoint's manifest
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    page: PageArgs,
    /// Print the page's address, and open no browser
    #[arg(long)]
    no_open: bool,
}

/// The policy that is shipped. A wheel and an archive hold it beside the programs, a checkout two folders above.
const SHIPPED: [&str; 2] = ["models/fetch.safetensors", "../../models/fetch.safetensors"];

pub fn run(args: &PlayArgs) -> Result<()> {
    let program = std::env::current_exe().context("this program has no place")?;
    let policy = args.file.clone().or_else(|| shipped(program.parent()?));
    let policy = policy.context(
        "models/fetch.safetensors does not lie beside this program: name a policy, `orchestrator play FILE`",
    )?;
    view::play(Player::of(&policy, &args.scene)?, &args.page, !args.no_open)
}

fn shipped(programs: &Path) -> Option<PathBuf> {
    SHIPPED.iter().map(|place| programs.join(place)).find(|place| place.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_policy_of_a_wheel_and_of_a_checkout_is_found() {
        let root = tempfile::tempdir().unwrap();
        let programs = root.path().join("target/release");
        std::fs::create_dir_all(programs.join("models")).unwrap();
        assert_eq!(shipped(&programs), None);
        std::fs::create_dir(root.path().join("models")).unwrap();
        for place in ["models", "target/release/models"] {
            let policy = root.path().join(place).join("fetch.safetensors");
            std::fs::write(&policy, "").unwrap();
            assert_eq!(shipped(&programs).unwrap().canonicalize().unwrap(), policy.canonicalize().unwrap());
        }
    }
}
