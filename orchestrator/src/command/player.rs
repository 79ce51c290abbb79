//! `orchestrator play`: a policy plays, episode after episode, while somebody watches.
//!
//! The viewer only reads folders. So it is shown an evaluation that records, in a temporary folder: a child plays it
//! (`orchestrator eval`), slowly enough to be watched, and begins again when all episodes are played. When the viewer
//! ends it stops the child and removes the folder; when it is killed the kernel interrupts the child, which does that.

use crate::evaluation::choice::{SplitChoice, word};
use crate::evaluation::subject::{Source, find};
use crate::output::format;
use crate::output::log_line::error_in;
use crate::run::identity::Identity;
use crate::run::lifeline::{follow, this_program};
use crate::suite;
use anyhow::{Context, Result, bail, ensure};
use proto::checkpoint::Manifest;
use proto::config::Config;
use proto::evaluation::has_targets;
use proto::exit::how;
use proto::kitchen::KitchenId;
use rustix::process::{Pid, Signal, getppid, kill_process};
use std::fs::{DirBuilder, File};
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use tokio::process::Child;

const PREFIX: &str = "stillroom-play-";
/// Episodes of each kitchen and object set in a round: as many of each target. A viewer may run for days, and keeps what it
/// knows of a round in memory.
const EPISODES: &str = "36";
const LAST: Duration = Duration::from_secs(30);

/// Where a policy plays, and how fast.
#[derive(Debug, clap::Args)]
pub struct SceneArgs {
    /// The policy plays in a single kitchen, by its number; from 1000 on a procedural one
    #[arg(long, value_name = "K", value_parser = generated)]
    kitchen: Option<KitchenId>,
    /// The policy plays in the kitchens of a split [default: test; of a run in scenes of its own: those scenes]
    #[arg(long, value_enum, conflicts_with = "kitchen")]
    split: Option<SplitChoice>,
    /// Steps a second that the policy plays
    #[arg(long, value_name = "N", default_value = "5", value_parser = clap::value_parser!(u32).range(1..=100))]
    speed: u32,
}

fn generated(text: &str) -> Result<KitchenId, String> {
    let number = text.parse().map_err(|_| format!("`{text}` is no kitchen's number"))?;
    KitchenId::generated(number).map_err(|error| error.to_string())
}

/// How an evaluation is told that it is shown: see [`Player`].
#[derive(Debug, clap::Args)]
pub struct ShownArgs {
    /// The viewer that started this: the evaluation stops with it
    #[arg(long, hide = true, value_name = "PID", requires = "out")]
    shown_by: Option<u32>,
    /// Steps a second at most, of each environment
    #[arg(long, hide = true, value_name = "N")]
    pub steps_per_s: Option<u32>,
}

impl ShownArgs {
    /// Ties this process to the viewer, if there is one; what comes back is to be kept until the evaluation has ended.
    pub fn begin(&self, out: Option<&Path>) -> Result<Option<Orphan>> {
        let (Some(viewer), Some(root)) = (self.shown_by, out.and_then(Path::parent)) else { return Ok(None) };
        follow(viewer, Signal::INT)?;
        Ok(Some(Orphan { viewer, root: root.to_owned() }))
    }

    pub fn is_watched(&self) -> bool {
        self.steps_per_s.is_some()
    }

    /// How long a learner may be silent that somebody watches, seconds: three of the longest episodes.
    pub fn patience_s(&self, config: &Config) -> f64 {
        let episode_s = self.steps_per_s.map_or(0.0, |steps| f64::from(config.episode.max_steps) / f64::from(steps));
        config.learner.progress_deadline_s.max(3.0 * episode_s)
    }
}

/// The folder of an evaluation that is shown. It is removed here if the viewer, whose it is, was killed.
pub struct Orphan {
    viewer: u32,
    root: PathBuf,
}

impl Drop for Orphan {
    fn drop(&mut self) {
        let parent = getppid().map_or(0, Pid::as_raw_pid);
        let is_ours = self.root.file_name().is_some_and(|name| name.to_string_lossy().starts_with(PREFIX));
        if is_ours && u32::try_from(parent) != Ok(self.viewer) {
            let _ = std::fs::remove_dir_all(&self.root);
        }
    }
}

/// Options of an evaluation that is shown: where it plays, and how fast. `has_targets`: its episodes have targets.
pub fn options(
    kitchen: Option<KitchenId>,
    split: Option<SplitChoice>,
    steps_per_s: u32,
    has_targets: bool,
) -> Vec<String> {
    let place = match (kitchen, split) {
        (Some(kitchen), _) => Some(("--kitchens", kitchen.to_string())),
        (None, Some(split)) => Some(("--split", word(&split))),
        (None, None) => None,
    };
    let place = place.into_iter().flat_map(|(option, value)| [option.to_owned(), value]);
    let objects = ["--objects", "all"].into_iter().filter(|_| has_targets);
    let rest = ["--episodes", EPISODES, "--environments", "1", "--record", "all", "--device", "cpu"];
    let speed = ["--steps-per-s".to_owned(), steps_per_s.to_string()];
    place.chain(speed).chain(objects.chain(rest).map(str::to_owned)).collect()
}

/// Digits of the weights' digest that tell policies apart, as `compare` prints them.
const DIGITS: usize = 12;

fn in_words(policy: &Path, source: &Source) -> Result<String> {
    let (file, frames, weights) = match source {
        Source::File { path, policy } => (path, policy.origin.frames, policy.origin.weights.clone()),
        Source::Checkpoint(found) => {
            let manifest = Manifest::read_in(&found.named, &found.manifest);
            let read = manifest.with_context(|| found.manifest.display().to_string())?;
            (&found.manifest, read.frames, read.weights)
        }
    };
    let file = file.canonicalize().unwrap_or_else(|_| policy.to_owned());
    // A file's folder says whose it is, a checkpoint's run.
    let parts = file.components().count();
    let kept = if matches!(source, Source::File { .. }) { 2 } else { 3 };
    let file: PathBuf = file.components().skip(parts.saturating_sub(kept)).collect();
    let weights: String = weights.chars().take(DIGITS).collect();
    let (preset, frames) = (&source.config().preset, format::count(frames));
    Ok(format!("{}: preset {preset}, {frames} frames, weights {weights}", file.display()))
}

pub struct Player {
    pub root: PathBuf,
    /// Which policy, in words: its file, preset, frames and weights.
    pub plays: String,
    pub steps_per_s: u32,
    policy: PathBuf,
    options: Vec<String>,
    name: String,
    child: Option<Child>,
}

impl Player {
    /// Checks what is asked. Nothing is started or written yet.
    pub fn of(policy: &Path, scene: &SceneArgs) -> Result<Self> {
        suite::refuse(policy)?;
        let found = find(policy)?;
        let config = found.config();
        ensure!(
            config.environment.is_none(),
            "{} was trained in an environment that is not built in, which this page cannot show: `orchestrator replay RUN` \
             makes films of it",
            policy.display()
        );
        let plays = in_words(policy, &found)?;
        let policy = std::path::absolute(policy)?;
        let options = options(scene.kitchen, scene.split, scene.speed, has_targets(config.spec()));
        let name = policy.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let root = wire::temporary_folder().join(format!("{PREFIX}{}", Identity::new()?.id));
        Ok(Self { root, plays, steps_per_s: scene.speed, policy, options, name, child: None })
    }

    /// Plays all episodes again and again; comes back with the reason when that is not possible.
    ///
    /// To be called on the main thread: the kernel interrupts the child when the thread that started it ends.
    pub async fn play(&mut self) -> Result<std::convert::Infallible> {
        DirBuilder::new()
            .mode(0o700)
            .create(&self.root)
            .with_context(|| format!("cannot make {}", self.root.display()))?;
        for round in 1u64.. {
            let folder = |round: u64| self.root.join(format!("{}-{round}", self.name));
            // The last round stays until this one can be seen.
            if let Some(old) = round.checked_sub(2) {
                let _ = std::fs::remove_dir_all(folder(old));
            }
            let out = folder(round);
            let log = self.root.join("log");
            let mut command = self.command(&out, round);
            let file = File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
            command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(file);
            // Ctrl-C is the viewer's: the child would get it twice.
            command.process_group(0);
            let spawned = tokio::process::Command::from(command).kill_on_drop(true).spawn();
            let child = self.child.insert(spawned.context("cannot start an evaluation")?);
            let status = child.wait().await.context("cannot wait for the evaluation")?;
            self.child = None;
            if !status.success() {
                let text = std::fs::read_to_string(&log).unwrap_or_default();
                let last = || text.rsplit_once("error: ").map(|(_, error)| error);
                bail!(
                    "the policy does not play: `orchestrator eval` {}: {}",
                    how(status),
                    error_in(&text).or_else(last).unwrap_or(&text).trim()
                );
            }
        }
        unreachable!("rounds do not end")
    }

    fn command(&self, out: &Path, round: u64) -> Command {
        let mut command = this_program();
        command.arg("eval").arg(&self.policy).arg("--out").arg(out).args(&self.options);
        command.args(["--shown-by", &std::process::id().to_string(), "--seed", &round.to_string()]);
        command
    }

    pub async fn stop(&mut self) -> Result<()> {
        if let Some(mut child) = self.child.take()
            && let Some(pid) = child.id().and_then(|pid| i32::try_from(pid).ok()).and_then(Pid::from_raw)
        {
            let _ = kill_process(pid, Signal::INT);
            if tokio::time::timeout(LAST, child.wait()).await.is_err() {
                child.kill().await.context("the evaluation does not end")?;
            }
        }
        match std::fs::remove_dir_all(&self.root) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("cannot remove {}", self.root.display()))
            }
            _ => Ok(()),
        }
    }
}
