//! `orchestrator replay`: proves a recording by simulating it again.
//!
//! What is to be compared comes from [`crate::recording::episodes`]; how, is in [`crate::recording::simulate`].

use crate::command::choice::{Choice, Chosen, nothing_in};
use crate::output::terminal;
use crate::recording::episodes::Recorded;
use crate::recording::ffmpeg;
use crate::recording::simulate::{Totals, simulate};
use anyhow::{Context, Result, bail, ensure};
use proto::exit::EXIT_INCOMPLETE;
use proto::replay::{Difference, ImageFormat, RecordedEpisode, ReplayImages, ReplaySetup};
use std::path::PathBuf;
use std::process::ExitCode;

/// Simulate recorded episodes again: compare all that was recorded, draw pictures if asked.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator replay runs/a                                        every recorded episode, every state compared
  orchestrator replay runs/a --images films --format video --limit 3   three films to look at
  orchestrator replay runs/a --images films --environment 3/0 --episode 12,40 --format video
  orchestrator replay EVALUATION --kitchen 26 --episode 6,7 --images films --format video   numbers of episodes.csv
  orchestrator replay runs/a/recordings/incarnation-001.000.mcap --episode 7

Compared are the state after every step and every channel and reward of it by name, and each episode's end with its
steps. Of a damaged recording everything that can be read is compared.

Exit status: 0 if all agrees and nothing is missing, 1 if anything differs, 6 if the recordings are damaged or not complete.")]
pub struct ReplayArgs {
    /// Recordings (.mcap), or the folder of a run or an evaluation: all its recordings.
    #[arg(required = true, value_name = "FILE|RUN")]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    choice: Choice,
    /// Write pictures into this folder; their names hold kitchen, episode, target and outcome.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// png: depth alone, a 16-bit picture (millimetres) a frame; video: one film an episode, depth and the room with
    /// target and goal marked, as mp4 if there is an ffmpeg on the PATH, else as apng (an animated PNG).
    #[arg(long, default_value = "png", requires = "images")]
    format: Format,
    /// Width and height of a png, or of each of a film's two views, in pixels [default: 224; films 448].
    #[arg(long, value_parser = clap::value_parser!(u32).range(8..=4096), requires = "images")]
    side: Option<u32>,
    /// At most this many episodes.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    limit: Option<u64>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Format {
    Png,
    Video,
    Mp4,
    Apng,
}

impl Format {
    fn image_format(self) -> Result<ImageFormat> {
        match (self, if matches!(self, Self::Video | Self::Mp4) { ffmpeg::find() } else { None }) {
            (Self::Png, _) => Ok(ImageFormat::Png),
            (Self::Apng, _) => Ok(ImageFormat::Apng),
            (_, Some(ffmpeg)) => Ok(ImageFormat::Mp4(ffmpeg)),
            (Self::Video, None) => {
                terminal::note(
                    "films are animated PNGs, which browsers play: for MP4, install an ffmpeg with libx264 on the PATH",
                );
                Ok(ImageFormat::Apng)
            }
            (Self::Mp4, None) => {
                bail!("there is no ffmpeg with libx264 on the PATH: install one, or use --format apng")
            }
        }
    }

    fn side(self) -> u32 {
        if matches!(self, Self::Png) { 224 } else { 448 }
    }
}

/// Runs the command. An error if anything differs from the recording; a status of its own if all agrees that is there,
/// but not all is there.
pub fn run(args: &ReplayArgs) -> Result<ExitCode> {
    let Chosen { recorded, files, incomplete, folder } = args.choice.gather(&args.paths)?;
    let Recorded { configs, mut episodes, mut config_of, steps, .. } = recorded;
    if let Some(limit) = args.limit {
        episodes.truncate(usize::try_from(limit).unwrap_or(usize::MAX));
        config_of.truncate(episodes.len());
    }
    ensure!(!episodes.is_empty(), "{}", nothing_in(&files, steps));

    let images = args.images_wanted()?;
    let mut shares: Vec<Vec<RecordedEpisode>> = vec![Vec::new(); configs.len()];
    for (episode, config) in episodes.into_iter().zip(config_of) {
        shares[config].push(episode);
    }
    let mut totals = Totals::default();
    for (config, episodes) in configs.into_iter().zip(shares).filter(|(_, episodes)| !episodes.is_empty()) {
        let setup = ReplaySetup { config, folder: folder.clone(), images: images.clone() };
        totals.merge(simulate(&setup, episodes)?);
    }

    terminal::out(&format!("episodes: {}", totals.episodes));
    terminal::out(&format!("states compared: {}", totals.compared));
    if let Some(images) = &images {
        terminal::out(&format!("images: {} in {}", totals.images, images.folder));
    }
    terminal::out(&format!("differences: {}", totals.different));
    match totals.first {
        None if incomplete => {
            terminal::note(
                "all that is there agrees, but the recordings are damaged or not complete: see the warnings above",
            );
            Ok(ExitCode::from(EXIT_INCOMPLETE as u8))
        }
        None => Ok(ExitCode::SUCCESS),
        Some((kitchen, environment, episode, Difference { step, what })) => {
            let kinds = totals.kinds.iter().map(|(what, count)| format!("{what} {count}"));
            bail!(
                "the simulation differs from the recording, first in kitchen {kitchen}, environment {environment}, \
                 episode {episode}, step {step}: {what} (episodes by what differs first: {})",
                kinds.collect::<Vec<_>>().join(", ")
            )
        }
    }
}

impl ReplayArgs {
    /// Where and how pictures are to be drawn.
    fn images_wanted(&self) -> Result<Option<ReplayImages>> {
        let Some(folder) = &self.images else { return Ok(None) };
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        // The actors run elsewhere; a relative folder is the user's.
        let folder = std::path::absolute(folder)?;
        Ok(Some(ReplayImages {
            folder: folder.to_str().context("the folder of images has a name that is not text")?.to_owned(),
            format: self.format.image_format()?,
            side: self.side.unwrap_or_else(|| self.format.side()),
        }))
    }
}
