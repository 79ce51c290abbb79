//! `orchestrator replay`: proves a recording by simulating it again.
//!
//! What is to be compared comes from [`crate::recording::episodes`]; how, is in [`crate::recording::simulate`].

use crate::recording::episodes::{Recorded, gather};
use crate::recording::reader::RecordingError;
use crate::recording::simulate::{Totals, simulate};
use crate::recording::wanted::Wanted;
use crate::recording::{ffmpeg, files_at};
use crate::showing::format::counted;
use crate::showing::terminal;
use crate::training::summary::Summary;
use anyhow::{Context, Result, bail, ensure};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::exit::EXIT_INCOMPLETE;
use proto::kitchen::KitchenId;
use proto::replay::{ImageFormat, RecordedEpisode, ReplayImages, ReplaySetup};
use proto::run_folder::RunFolder;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;

/// Simulate recorded episodes again: compare all that was recorded, draw pictures if asked.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator replay runs/a                                        every recorded episode, every state compared
  orchestrator replay runs/a --images films --format video --limit 3   three films to look at
  orchestrator replay runs/a --images films --environment 3/0 --episode 12,40 --format video
  orchestrator replay EVALUATION --kitchen 26 --episode 2,7 --images films --format video   numbers of episodes.csv
  orchestrator replay runs/a/recordings/incarnation-001.000.mcap --episode 7

Compared are states, goal vectors, outcomes, rewards, disturbance and distances of every step, and each episode's end
with its steps. Of a damaged recording everything that can be read is compared.

Exit status: 0 if all agrees and nothing is missing, 1 if anything differs, 6 if the recordings are damaged or not complete.")]
pub struct ReplayArgs {
    /// Recordings (.mcap), or the folder of a run or an evaluation: all its recordings.
    #[arg(required = true, value_name = "FILE|RUN")]
    paths: Vec<PathBuf>,
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
    /// Only this kitchen.
    #[arg(long, value_name = "K", value_parser = kitchen)]
    kitchen: Option<KitchenId>,
    /// Only this environment: kitchen number and environment number within the kitchen.
    #[arg(long, value_name = "K/N")]
    environment: Option<EnvironmentChoice>,
    /// Only episodes of these numbers: within their environment, in an evaluation those of episodes.csv.
    #[arg(long, value_name = "I,...", value_delimiter = ',')]
    episode: Vec<u32>,
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

#[derive(Debug, Clone, Copy)]
struct EnvironmentChoice(EnvironmentId);

fn kitchen(text: &str) -> Result<KitchenId, String> {
    let number = text.parse().map_err(|_| format!("`{text}` is not a kitchen number"))?;
    KitchenId::new(number).map_err(|error| error.to_string())
}

impl FromStr for EnvironmentChoice {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not an environment (expected e.g. 1/0: kitchen 1, environment 0)");
        let (number_of_kitchen, number) = text.split_once('/').ok_or_else(wrong)?;
        let kitchen = kitchen(number_of_kitchen).map_err(|error| format!("{error}; {}", wrong()))?;
        Ok(Self(EnvironmentId { kitchen, number: number.parse().map_err(|_| wrong())? }))
    }
}

/// Runs the command. An error if anything differs from the recording; a status of its own if all agrees that is there,
/// but not all is there.
pub fn run(args: &ReplayArgs) -> Result<ExitCode> {
    let mut files = Vec::new();
    for path in &args.paths {
        files.extend(recordings_at(path)?);
    }
    files.sort();
    files.dedup();
    let wanted = Wanted {
        kitchen: args.kitchen,
        environment: args.environment.map(|choice| choice.0),
        episodes: args.episode.clone(),
    };
    let recorded = gather(&files, wanted.clone())?;
    for complaint in &recorded.complaints {
        tracing::warn!("{complaint}");
    }
    wanted.check(&recorded.known)?;
    let all = args.kitchen.is_none() && args.environment.is_none() && args.episode.is_empty();
    let incomplete = tell_what_is_missing(&recorded, args, all.then_some(&files[..]))?;
    let Recorded { configs, mut episodes, mut config_of, steps, .. } = recorded;
    if let Some(limit) = args.limit {
        episodes.truncate(usize::try_from(limit).unwrap_or(usize::MAX));
        config_of.truncate(episodes.len());
    }
    ensure!(
        !episodes.is_empty(),
        "no episode from its first step on in {} with {steps} steps",
        if files.len() == 1 { files[0].display().to_string() } else { format!("{} recordings", files.len()) }
    );

    let images = args.images_wanted()?;
    let run = files.first().and_then(|file| RunFolder::of_recording(file));
    let folder = run.and_then(|run| Some(std::path::absolute(run.root()).ok()?.to_str()?.to_owned()));
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
            terminal::note("all that is there agrees, but the recordings are not complete: see the warnings above");
            Ok(ExitCode::from(EXIT_INCOMPLETE as u8))
        }
        None => Ok(ExitCode::SUCCESS),
        Some((kitchen, environment, episode, step, aspect)) => {
            let kinds = totals.aspects.iter().map(|(aspect, count)| format!("{} {count}", aspect.word()));
            bail!(
                "the simulation differs from the recording, first in kitchen {kitchen}, environment {environment}, \
                 episode {episode}, step {step}: {} (episodes by what differs first: {})",
                aspect.word(),
                kinds.collect::<Vec<_>>().join(", ")
            )
        }
    }
}

/// Warns of all that is not there or contradicts itself; returns whether there is such a thing. `all`: the files, if
/// all their episodes are wanted.
fn tell_what_is_missing(recorded: &Recorded, args: &ReplayArgs, all: Option<&[PathBuf]>) -> Result<bool> {
    for fault in &recorded.faults {
        tracing::warn!("not complete: {fault}");
    }
    let mut incomplete = recorded.damaged_files > 0 || !recorded.faults.is_empty();
    if recorded.headless > 0 {
        let episodes = counted(recorded.headless, "episode");
        // One file out of many begins in the middle of episodes.
        let whole = recorded.from_the_start || args.paths.iter().any(|path| path.is_dir());
        incomplete |= whole;
        match whole {
            true => tracing::warn!("not complete: the first steps are missing: {episodes}"),
            false => tracing::warn!("left out, because begun before these recordings: {episodes}"),
        }
    }
    if recorded.broken > 0 {
        tracing::warn!("replayed up to a hole in the recording: {}", counted(recorded.broken, "episode"));
    }
    let run = match (&args.paths[..], all) {
        ([run], Some(_)) if run.is_dir() && !recorded.failures_only => RunFolder::new(run),
        _ => return Ok(incomplete),
    };
    if let Some(summary) = Summary::read(&run)? {
        let there: u64 = recorded.episodes.iter().map(|episode| episode.actions.len() as u64).sum();
        if there < summary.frames {
            tracing::warn!("not complete: {there} of the {} steps that the run has", summary.frames);
            incomplete = true;
        }
    }
    Ok(incomplete)
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

/// The recordings of a path; the error for an evaluation without any explains how to get them.
fn recordings_at(path: &Path) -> Result<Vec<PathBuf>> {
    let files = files_at(path);
    if let Err(RecordingError::NoRecordings(_)) = &files
        && Config::of_run(&RunFolder::new(path)).is_ok_and(|config| config.evaluation.is_some())
    {
        bail!("{} is an evaluation without recordings: make it again with `--record all`", path.display());
    }
    Ok(files?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn environments_are_named_kitchen_slash_number() {
        let EnvironmentChoice(id) = "13/2".parse().unwrap();
        assert_eq!((id.kitchen.number(), id.number), (13, 2));
        assert!("28/0".parse::<EnvironmentChoice>().unwrap_err().contains("no kitchen 28"));
        assert!("x/0".parse::<EnvironmentChoice>().unwrap_err().contains("expected e.g. 1/0"));
        assert!("3".parse::<EnvironmentChoice>().unwrap_err().contains("expected e.g. 1/0"));
    }
}
