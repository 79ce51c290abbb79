use crate::command::choice::{Choice, Chosen, demand_recording, nothing_in};
use crate::output::format::typed;
use crate::output::terminal;
use crate::replay::ffmpeg;
use crate::replay::newest::{Only, newest};
use crate::replay::simulate::{Totals, simulate};
use crate::run::identity::{Identity, perhaps};
use crate::suite;
use crate::wrong::{demand, judged};
use anyhow::{Context, Result, bail, ensure};
use proto::config::Config;
use proto::exit::EXIT_INCOMPLETE;
use proto::replay::{Difference, ImageFormat, RecordedEpisode, ReplayImages, ReplaySetup};
use proto::run_folder::RunFolder;
use recording::episodes::Recorded;
use std::fs::DirEntry;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, SystemTime};

const NAMES_MOST: usize = 10;

/// Simulate recorded episodes again: films of the newest ones, or with --check a proof of all
///
/// Without further words: films of the newest two successes without disturbance, of one that disturbed something, and of a
/// failure; those of more than five steps go first.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  # a few films, in runs/a/films
  orchestrator replay runs/a
  # of the five newest failures
  orchestrator replay runs/a --only failure --newest 5
  # of the newest episode in kitchen 26
  orchestrator replay runs/a --kitchen 26 --newest 1
  # of these episodes
  orchestrator replay runs/a --environment 3/0 --episode 12,40
  # the same, by the numbers of episodes.csv
  orchestrator replay EVALUATION --kitchen 26 --episode 6,7
  # every recorded episode, every state compared
  orchestrator replay runs/a --check
  orchestrator replay runs/a/recordings/incarnation-001.000.mcap --check

Compared are the state after every step and every channel and reward of it by name, and each episode's end with its \
steps. Of a damaged recording everything that can be read is compared.

Exit status: 0 if all agrees and nothing is missing, 1 if anything differs, 6 if the recordings are damaged or not \
complete.")]
pub struct ReplayArgs {
    /// Recordings (.mcap), or the folder of a run or an evaluation: all its recordings.
    #[arg(required = true, value_name = "FILE|RUN")]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    choice: Choice,
    /// Compare all episodes, or those chosen by the options above, and draw nothing.
    #[arg(long, conflicts_with_all = ["only", "newest", "images", "format", "side"])]
    check: bool,
    /// Only of the newest that ended so.
    #[arg(long, value_enum, conflicts_with_all = ["environment", "episode"])]
    only: Option<Only>,
    /// Of the newest N episodes, however short [default: a few of each kind; with --only: 3, of more than five steps first].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), conflicts_with_all = ["environment", "episode"])]
    newest: Option<u16>,
    /// Write pictures into this folder; their names hold kitchen, episode, target and outcome [default: RUN/films; of a
    /// recording elsewhere: films].
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// video: one film an episode, depth and the room with target and goal marked, as mp4 if there is an ffmpeg on the
    /// PATH, else as apng (an animated PNG); png: depth alone, a 16-bit picture (millimetres) a frame.
    #[arg(long, default_value = "video")]
    format: Format,
    /// Width and height of a png, or of each of a film's two views, in pixels [default: 224; films 448].
    #[arg(long, value_parser = clap::value_parser!(u32).range(8..=4096))]
    side: Option<u32>,
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
    let picks = !args.check && (args.choice.is_all() || args.only.is_some() || args.newest.is_some());
    let (shares, incomplete) = if picks { (args.picked()?, false) } else { args.chosen()? };
    let images = if args.check { None } else { Some(args.images_wanted()?) };
    let films = shares.iter().map(|(_, episodes)| episodes.len()).sum::<usize>() as u64;
    if images.is_some() && !picks && films > 1 && !args.choice.is_of_one_environment() {
        terminal::note(&format!("makes {films} films: --environment chooses one environment"));
    }
    // A file's time is that of the last tick of the kernel's clock.
    let began = SystemTime::now() - Duration::from_millis(100);
    let mut totals = Totals::default();
    let mut in_kitchens = true;
    for (mut setup, episodes) in shares {
        let config = Config::from_toml(&setup.config, "the recorded configuration")?;
        in_kitchens = config.environment.is_none();
        ensure!(
            config.spec().restore.is_exact(),
            "the environment cannot be restored (restore none), and so its episodes cannot be simulated again"
        );
        setup.images.clone_from(&images);
        totals.merge(simulate(&setup, episodes)?);
    }

    terminal::out(&format!("episodes: {}", totals.episodes));
    terminal::out(&format!("states compared: {}", totals.compared));
    if let Some(images) = &images {
        let folder = typed(Path::new(&images.folder));
        if images.format == ImageFormat::Png {
            terminal::out(&format!("images: {} in {}", totals.images, folder.display()));
        } else {
            terminal::out(&format!("films: {} in {}", totals.episodes, folder.display()));
            for name in names_since(&folder, began) {
                terminal::out(&name);
            }
        }
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
            let place = if in_kitchens { format!("kitchen {kitchen}, ") } else { String::new() };
            bail!(
                "the simulation differs from the recording, first in {place}environment {environment}, episode {episode}, \
                 step {step}: {what} (episodes by what differs first: {})",
                kinds.collect::<Vec<_>>().join(", ")
            )
        }
    }
}

/// Files in a folder that were written since then, by name, so many of them at most, and how many more there are.
fn names_since(folder: &Path, began: SystemTime) -> Vec<String> {
    let is_new = |file: &DirEntry| file.metadata().and_then(|file| file.modified()).is_ok_and(|time| time >= began);
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten().filter(is_new);
    let named = |file: DirEntry| {
        let name = file.file_name();
        let is_animated = Path::new(&name).extension().is_some_and(|ending| ending == "png");
        format!("  {}{}", name.display(), if is_animated { " (animated: open in a browser)" } else { "" })
    };
    let mut names: Vec<String> = files.map(named).collect();
    names.sort_unstable();
    let more = names.len().saturating_sub(NAMES_MOST);
    names.truncate(NAMES_MOST);
    names.extend((more > 0).then(|| format!("  and {more} more")));
    names
}

type Share = (ReplaySetup, Vec<RecordedEpisode>);

impl ReplayArgs {
    fn picked(&self) -> Result<Vec<Share>> {
        let mut shares: Vec<Share> = Vec::new();
        for path in &self.paths {
            demand!(path.exists(), "{} does not exist{}", path.display(), perhaps(path));
            demand_recording(path)?;
            suite::refuse(path)?;
            let folder = judged(run_of(path).with_context(|| {
                format!("{} lies in no run folder: choose with --episode, or --check it", path.display())
            }))?;
            if path.is_dir() {
                Identity::read(&folder)?;
            }
            let count = self.newest.map(usize::from);
            for (setup, episode) in newest(&folder, self.choice.kitchen(), self.only, count)? {
                match shares.iter_mut().find(|(known, _)| *known == setup) {
                    Some((_, episodes)) => episodes.push(episode),
                    None => shares.push((setup, vec![episode])),
                }
            }
        }
        Ok(shares)
    }

    /// Those that are chosen by number, or all; and whether some are not there.
    fn chosen(&self) -> Result<(Vec<Share>, bool)> {
        let Chosen { recorded, files, incomplete, folder } = self.choice.gather(&self.paths)?;
        let Recorded { configs, episodes, config_of, steps, .. } = recorded;
        ensure!(!episodes.is_empty(), "{}", nothing_in(&files, steps));
        let share = |config| (ReplaySetup { config, folder: folder.clone(), images: None }, Vec::new());
        let mut shares: Vec<Share> = configs.into_iter().map(share).collect();
        for (episode, config) in episodes.into_iter().zip(config_of) {
            shares[config].1.push(episode);
        }
        shares.retain(|(_, episodes)| !episodes.is_empty());
        Ok((shares, incomplete))
    }

    fn images_wanted(&self) -> Result<ReplayImages> {
        let of_run = || run_of(&self.paths[0]).map_or_else(|| "films".into(), |run| run.root().join("films"));
        let folder = &self.images.clone().unwrap_or_else(of_run);
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        // The actors run elsewhere; a relative folder is the user's.
        let folder = std::path::absolute(folder)?;
        Ok(ReplayImages {
            folder: folder.to_str().context("the folder of images has a name that is not text")?.to_owned(),
            format: self.format.image_format()?,
            side: self.side.unwrap_or_else(|| self.format.side()),
        })
    }
}

/// The run or evaluation whose folder this is, or whose recording.
fn run_of(path: &Path) -> Option<RunFolder> {
    if path.is_dir() { Some(RunFolder::new(path)) } else { RunFolder::of_recording(path) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn films_are_named_and_those_of_before_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str| std::fs::File::create(folder.path().join(name)).unwrap();
        let old = write("old.mp4");
        old.set_modified(SystemTime::UNIX_EPOCH).unwrap();
        write("b.mp4");
        write("a.png");
        assert_eq!(
            names_since(folder.path(), SystemTime::UNIX_EPOCH + Duration::from_secs(1)),
            ["  a.png (animated: open in a browser)", "  b.mp4"]
        );
        (0..NAMES_MOST).for_each(|number| drop(write(&format!("{number:02}.mp4"))));
        let names = names_since(folder.path(), SystemTime::UNIX_EPOCH);
        assert_eq!((names.len(), names[10].as_str()), (11, "  and 3 more"));
    }
}
