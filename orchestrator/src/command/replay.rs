//! `orchestrator replay`: proves a recording by simulating it again.
//!
//! What is to be compared comes from [`crate::recording::episodes`]; how, is in [`crate::recording::simulate`].

use crate::format::counted;
use crate::recording::episodes::{Recorded, Wanted, gather};
use crate::recording::files_at;
use crate::recording::simulate::simulate;
use crate::terminal;
use anyhow::{Context, Result, bail, ensure};
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::replay::{ImageFormat, ReplayImages, ReplaySetup};
use proto::run_folder::RunFolder;
use std::path::PathBuf;
use std::str::FromStr;

/// Simulate recorded episodes again: compare every state, draw depth images if asked.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator replay runs/a                                        every recorded episode, every state compared
  orchestrator replay runs/a --images frames --format video --limit 3   three episodes to look at in a browser
  orchestrator replay runs/a --images frames --environment 1/0 --side 448   kitchen 1, environment 0, larger pictures
  orchestrator replay runs/a/recordings/incarnation-001.000.mcap --episode 7")]
pub struct ReplayArgs {
    /// Recordings (.mcap), or a run folder: all its recordings.
    #[arg(required = true, value_name = "FILE|RUN")]
    paths: Vec<PathBuf>,
    /// Write depth images into this folder.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// png: a 16-bit picture (millimetres) a frame; video: an animated PNG an episode, near is bright.
    #[arg(long, default_value = "png", requires = "images")]
    format: Format,
    /// Width and height of the images in pixels.
    #[arg(long, default_value_t = 224, value_parser = clap::value_parser!(u32).range(8..=4096), requires = "images")]
    side: u32,
    /// Only this environment: kitchen number and environment number within the kitchen.
    #[arg(long, value_name = "K/N")]
    environment: Option<EnvironmentChoice>,
    /// Only episodes of this number.
    #[arg(long, value_name = "I")]
    episode: Option<u32>,
    /// At most this many episodes.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    limit: Option<u64>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Format {
    Png,
    Video,
}

#[derive(Debug, Clone, Copy)]
struct EnvironmentChoice(EnvironmentId);

impl FromStr for EnvironmentChoice {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not an environment (expected e.g. 1/0: kitchen 1, environment 0)");
        let (kitchen, number) = text.split_once('/').ok_or_else(wrong)?;
        let kitchen = KitchenId::new(kitchen.parse().map_err(|_| wrong())?).map_err(|error| error.to_string())?;
        Ok(Self(EnvironmentId { kitchen, number: number.parse().map_err(|_| wrong())? }))
    }
}

/// Runs the command. An error if any state differs from the recording.
pub fn run(args: &ReplayArgs) -> Result<()> {
    let mut files = Vec::new();
    for path in &args.paths {
        files.extend(files_at(path)?);
    }
    let wanted = Wanted { environment: args.environment.map(|choice| choice.0), episode: args.episode };
    let Recorded { config, mut episodes, headless, broken, steps, complaints } = gather(&files, wanted)?;
    for complaint in complaints {
        tracing::warn!("{complaint}");
    }
    if headless > 0 {
        tracing::warn!("left out, because begun before these recordings: {}", counted(headless, "episode"));
    }
    if broken > 0 {
        tracing::warn!("replayed up to a hole in the recording: {}", counted(broken, "episode"));
    }
    if let Some(limit) = args.limit {
        episodes.truncate(usize::try_from(limit).unwrap_or(usize::MAX));
    }
    ensure!(
        !episodes.is_empty(),
        "there is no such episode in {} with {steps} steps",
        if files.len() == 1 { files[0].display().to_string() } else { format!("{} recordings", files.len()) }
    );

    let images = args.images.as_ref().map(|folder| -> Result<ReplayImages> {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        // The actors run elsewhere; a relative folder is the user's.
        let folder = std::path::absolute(folder)?;
        Ok(ReplayImages {
            folder: folder.to_str().context("the folder of images has a name that is not text")?.to_owned(),
            format: match args.format {
                Format::Png => ImageFormat::Png,
                Format::Video => ImageFormat::Video,
            },
            side: args.side,
        })
    });
    let run = files.first().and_then(|file| RunFolder::of_recording(file));
    let folder = run.and_then(|run| Some(std::path::absolute(run.root()).ok()?.to_str()?.to_owned()));
    let setup = ReplaySetup { config, folder, images: images.transpose()? };
    let totals = simulate(&setup, episodes)?;

    terminal::out(&format!("episodes: {}", totals.episodes));
    terminal::out(&format!("states compared: {}", totals.compared));
    if let Some(images) = &setup.images {
        terminal::out(&format!("images: {} in {}", totals.images, images.folder));
    }
    terminal::out(&format!("differences: {}", totals.different));
    match totals.first {
        None => Ok(()),
        Some((kitchen, environment, episode, step)) => bail!(
            "the simulation differs from the recording, first in kitchen {kitchen}, environment {environment}, episode \
             {episode}, step {step}"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn environments_are_named_kitchen_slash_number() {
        let EnvironmentChoice(id) = "13/2".parse().unwrap();
        assert_eq!((id.kitchen.number(), id.number), (13, 2));
        assert!("28/0".parse::<EnvironmentChoice>().unwrap_err().contains("no kitchen 28"));
        assert!("3".parse::<EnvironmentChoice>().unwrap_err().contains("expected e.g. 1/0"));
    }
}
