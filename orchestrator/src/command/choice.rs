use crate::output::format::counted;
use crate::run::identity::{no_folder, perhaps};
use crate::suite;
use crate::training::summary::Summary;
use crate::wrong::{demand, judged, reject, wrong};
use anyhow::{Error, Result, bail};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::run_folder::{RunFolder, by_number};
use recording::episodes::{Recorded, gather};
use recording::files_at;
use recording::reader::{RecordingError, read_with_trust};
use recording::wanted::Wanted;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Filters.
#[derive(Debug, Clone, clap::Args)]
pub struct Choice {
    /// Only this kitchen.
    #[arg(long, value_name = "K", value_parser = kitchen)]
    kitchen: Option<KitchenId>,
    /// Only this environment: kitchen number and environment number within the kitchen. Where the environments are your
    /// own, its number alone.
    #[arg(long, value_name = "K/N")]
    environment: Option<EnvironmentChoice>,
    /// Only episodes of these numbers: within their environment, in an evaluation those of episodes.csv.
    #[arg(long, value_name = "I,...", value_delimiter = ',')]
    episode: Vec<u32>,
}

pub struct Chosen {
    pub recorded: Recorded,
    pub files: Vec<PathBuf>,
    /// The recordings are damaged or not complete: of what, was said.
    pub incomplete: bool,
    /// The run folder, absolute, if the recordings are in one.
    pub folder: Option<String>,
}

impl Choice {
    pub fn is_all(&self) -> bool {
        self.kitchen.is_none() && self.environment.is_none() && self.episode.is_empty()
    }

    pub fn kitchen(&self) -> Option<KitchenId> {
        self.kitchen
    }

    pub fn is_of_one_environment(&self) -> bool {
        self.environment.is_some()
    }

    pub fn gather(&self, paths: &[PathBuf]) -> Result<Chosen> {
        let mut files = Vec::new();
        for path in paths {
            demand!(path.exists(), "{} does not exist{}", path.display(), perhaps(path));
            demand_recording(path)?;
            suite::refuse(path)?;
            files.extend(recordings_at(path)?);
        }
        files.sort_by(|a, b| by_number(a, b));
        files.dedup();
        let wanted = Wanted {
            kitchen: self.kitchen,
            environment: self.environment.map(|choice| choice.0),
            episodes: self.episode.clone(),
        };
        let recorded = gather(&files, wanted.clone())?;
        for complaint in &recorded.complaints {
            tracing::warn!("{complaint}");
        }
        judged(wanted.check(&recorded.known))?;
        let incomplete = tell_what_is_missing(&recorded, paths, self.is_all())?;
        let run = files.first().and_then(|file| RunFolder::of_recording(file));
        let folder = run.and_then(|run| Some(std::path::absolute(run.root()).ok()?.to_str()?.to_owned()));
        Ok(Chosen { recorded, files, incomplete, folder })
    }
}

pub fn nothing_in(files: &[PathBuf], steps: u64) -> String {
    let name = if files.len() == 1 { files[0].display().to_string() } else { format!("{} recordings", files.len()) };
    format!("no episode from its first step on in {name} with {steps} steps")
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
        let wrong = || {
            format!(
                "`{text}` is not an environment (expected e.g. 1/0: kitchen 1, environment 0; or 7 of environments of your own)"
            )
        };
        let (kitchen, number) = match text.split_once('/') {
            Some((of_kitchen, number)) => {
                (kitchen(of_kitchen).map_err(|error| format!("{error}; {}", wrong()))?, number)
            }
            // Environments in no kitchen are recorded as those of the first scene.
            None => (KitchenId::scene(0).ok_or_else(wrong)?, text),
        };
        Ok(Self(EnvironmentId { kitchen, number: number.parse().map_err(|_| wrong())? }))
    }
}

/// Warns of all that is not there or contradicts itself; returns whether there is such a thing. `all`: all
/// episodes are wanted.
fn tell_what_is_missing(recorded: &Recorded, paths: &[PathBuf], all: bool) -> Result<bool> {
    for fault in &recorded.faults {
        tracing::warn!("not complete: {fault}");
    }
    let mut incomplete = recorded.damaged_files > 0 || !recorded.faults.is_empty();
    if recorded.headless > 0 {
        let episodes = counted(recorded.headless, "episode");
        // One file out of many begins in the middle of episodes.
        let whole = recorded.from_the_start || paths.iter().any(|path| path.is_dir());
        incomplete |= whole;
        if whole {
            tracing::warn!("not complete: the first steps are missing: {episodes}");
        } else {
            tracing::warn!("left out, because begun before these recordings: {episodes}");
        }
    }
    if recorded.broken > 0 {
        tracing::warn!("used up to a hole in the recording: {}", counted(recorded.broken, "episode"));
    }
    let run = match (paths, all) {
        ([run], true) if run.is_dir() && !recorded.failures_only => RunFolder::new(run),
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

/// Refuses files that are something else.
pub fn demand_recording(path: &Path) -> Result<()> {
    let others = ["safetensors", "onnx", "py", "toml", "csv", "json", "jsonl", "npz"];
    let ending = path.extension().and_then(|ending| ending.to_str());
    let is_other = path.is_file() && ending.is_some_and(|ending| others.contains(&ending));
    demand!(!is_other, "{}", no_folder(path));
    for file in if path.is_file() { files_at(path)? } else { vec![] } {
        match read_with_trust(&file, |_, _| bail!("the first record is enough")) {
            Err(error) if error.is::<RecordingError>() => return Err(of_file(error)),
            _ => {}
        }
    }
    Ok(())
}

/// An error of a recording that the user named.
pub fn of_file(error: Error) -> Error {
    let is_other = |cause: &RecordingError| matches!(cause, RecordingError::Empty(_) | RecordingError::NotMcap(_));
    if error.downcast_ref().is_some_and(is_other) { wrong(error) } else { error }
}

/// The recordings of a path; the error for an evaluation without any explains how to get them.
fn recordings_at(path: &Path) -> Result<Vec<PathBuf>> {
    let files = files_at(path);
    if let Err(RecordingError::NoRecordings(_)) = &files
        && Config::of_run(&RunFolder::new(path)).is_ok_and(|config| config.evaluation.is_some())
    {
        reject!("{} is an evaluation without recordings: make it again with `--record all`", path.display());
    }
    Ok(files?)
}
