//! A short real run: `orchestrator up` as a child, in a folder that is removed afterwards. It is stopped as soon as
//! enough of it is measured.

use super::search::Speed;
use crate::run::lifeline::this_program;
use crate::supervisor::shell::Signals;
use anyhow::{Context, Result};
use proto::config::Config;
use proto::event::Timing;
use proto::exit::how;
use proto::run_folder::RunFolder;
use proto::trained::History;
use rustix::process::{Pid, kill_process};
use std::fs::File;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Between two looks at a run's metrics.
const LOOK: Duration = Duration::from_millis(100);
/// Rollouts that count at least. The first does not count: processes start in it.
const ROLLOUTS: usize = 2;
/// Time that a run has to save and stop.
const STOPS: Duration = Duration::from_mins(1);

/// What came of a trial.
#[derive(Debug)]
pub enum Outcome {
    /// It was measured.
    Measured(Speed),
    /// The configuration does not work here, or too slowly; why.
    Failed(String),
    /// A signal asks for the end.
    Interrupted,
}

/// A place for the folders of trials, which is removed with all that is in it.
#[derive(Debug)]
pub struct Workshop(PathBuf);

impl Workshop {
    /// A new one.
    pub fn new() -> Result<Self> {
        let path = wire::temporary_folder().join(format!("stillroom-tune-{}", std::process::id()));
        std::fs::create_dir(&path).with_context(|| format!("cannot create {}", path.display()))?;
        Ok(Self(path))
    }

    /// A trial's run folder.
    pub fn run(&self) -> RunFolder {
        RunFolder::new(self.0.join("run"))
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            tracing::warn!("{} remains: {error}", self.0.display());
        }
    }
}

/// Signals that ask for the end. One that comes between two trials is heard by the next.
#[derive(Debug)]
pub struct Interrupts(Signals);

impl Interrupts {
    /// From now on signals do not end the process. To be called inside a runtime.
    pub fn install() -> Result<Self> {
        Ok(Self(Signals::install(false)?))
    }

    /// Waits for one, at most for `longest`; whether one came.
    async fn within(&mut self, longest: Duration) -> bool {
        tokio::time::timeout(longest, self.0.next()).await.is_ok()
    }
}

/// How long a trial may take.
#[derive(Debug, Clone, Copy)]
pub struct Patience {
    /// Time of rollouts that is enough.
    pub enough: Duration,
    /// Time of the whole, its start included, after which it counts as too slow.
    pub longest: Duration,
}

/// Runs a configuration for a while.
pub async fn run(
    workshop: &Workshop,
    config: &Config,
    patience: Patience,
    interrupts: &mut Interrupts,
) -> Result<Outcome> {
    let folder = workshop.run();
    let _ = std::fs::remove_dir_all(folder.root());
    let [file, log] = ["config.toml", "log"].map(|name| workshop.0.join(name));
    std::fs::write(&file, config.to_toml()).with_context(|| file.display().to_string())?;
    let mut child = start(config, &file, &folder, File::create(&log)?)?;
    let began = Instant::now();
    loop {
        if interrupts.within(LOOK).await {
            stop(&mut child).await?;
            return Ok(Outcome::Interrupted);
        }
        let ended = child.try_wait()?;
        let measured = measured(&History::decode(&std::fs::read(folder.metrics()).unwrap_or_default()).0);
        let (rollouts, speed) = measured.map_or((0, None), |(rollouts, speed)| (rollouts, Some(speed)));
        let enough = speed.filter(|speed| {
            rollouts >= ROLLOUTS && speed.timing.total_s() >= patience.enough.as_secs_f64()
                || began.elapsed() >= patience.longest
        });
        if let Some(speed) = enough.or(speed.filter(|_| ended.is_some_and(|status| status.success()))) {
            stop(&mut child).await?;
            return Ok(Outcome::Measured(speed));
        }
        if let Some(status) = ended {
            return Ok(Outcome::Failed(reason(&log, status)));
        }
        if began.elapsed() >= patience.longest {
            stop(&mut child).await?;
            let seconds = patience.longest.as_secs();
            return Ok(Outcome::Failed(format!("no two rollouts within {seconds} s")));
        }
    }
}

fn start(config: &Config, file: &Path, folder: &RunFolder, log: File) -> Result<Child> {
    let mut command = this_program();
    // It stops with this process, however that ends.
    command.arg("--parent").arg(std::process::id().to_string());
    command.args(["up", "--preset", &config.preset]).arg("--config").arg(file).arg("--run").arg(folder.root());
    // A group of its own: Ctrl-C reaches this process alone, which decides.
    command.stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log).process_group(0);
    command.spawn().context("cannot start `orchestrator up`")
}

/// Stops a run in an orderly way, or kills it.
async fn stop(child: &mut Child) -> Result<()> {
    let began = Instant::now();
    if child.try_wait()?.is_none() {
        // Not reaped yet, so the number is still its own.
        let _ = kill_process(Pid::from_child(child), rustix::process::Signal::INT);
    }
    while child.try_wait()?.is_none() {
        if began.elapsed() >= STOPS {
            child.kill()?;
            child.wait()?;
            break;
        }
        tokio::time::sleep(LOOK).await;
    }
    Ok(())
}

/// How many rollouts count, and their speed; none if none counts yet.
fn measured(history: &History) -> Option<(usize, Speed)> {
    let first = history.iter().next()?.frames;
    let (mut rollouts, mut sum) = (0, Timing::default());
    for trained in history.iter().skip(1) {
        sum += trained.timing;
        rollouts += 1;
    }
    let seconds = sum.total_s();
    let frames = history.frames() - first;
    (seconds > 0.0).then(|| (rollouts, Speed { frames_per_s: frames as f64 / seconds, timing: sum }))
}

/// Why a run failed, in a line.
fn reason(log: &Path, status: ExitStatus) -> String {
    if status.signal().is_some() {
        return format!("`orchestrator up` {}", how(status));
    }
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let said = text.lines().rev().find_map(|line| line.trim().strip_prefix("error: "));
    said.or_else(|| text.trim_end().lines().next_back()).map_or_else(|| status.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::means::tests::history;

    #[test]
    fn the_first_rollout_does_not_count() {
        assert_eq!(measured(&history(0)), None);
        assert_eq!(measured(&history(1)), None);
        // 50 frames in two seconds each.
        let (rollouts, speed) = measured(&history(4)).unwrap();
        assert_eq!(rollouts, 3);
        assert!((speed.frames_per_s - 25.0).abs() < 1e-9 && (speed.timing.total_s() - 6.0).abs() < 1e-9, "{speed:?}");
    }

    #[test]
    fn the_reason_is_the_last_error() {
        let log = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(log.path(), "0.1 s INFO starts\nerror: too little memory\n  0.2 s INFO over\n").unwrap();
        assert_eq!(reason(log.path(), ExitStatus::default()), "too little memory");
    }
}
