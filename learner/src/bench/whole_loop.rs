//! A short real run, and where its time goes: simulating, inferring, updating, and the rest.

use super::gpu::{Monitor, Use};
use anyhow::{Context, Result, bail, ensure};
use proto::config::Config;
use proto::event::Timing;
use proto::run_folder::RunFolder;
use proto::trained::History;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Rollouts of the run if nothing else is asked for.
const ROLLOUTS: u64 = 8;
/// Rollouts that do not count: in the first processes start, after the second a GPU's graphs are recorded.
const WARM_UP: usize = 2;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WholeLoop {
    /// Frames of the rollouts that count.
    pub frames: u64,
    pub timing: Timing,
    /// What the GPU did during the whole run, its start included.
    pub gpu: Option<Use>,
}

impl WholeLoop {
    pub fn seconds(&self) -> f64 {
        self.timing.total_s()
    }
}

struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Runs the configuration for some frames with the `orchestrator` beside this program, and reads its metrics.
pub fn measure(config: &Config, frames: Option<u64>, monitor: &Monitor) -> Result<WholeLoop> {
    let program = std::env::current_exe()?.with_file_name("orchestrator");
    ensure!(
        program.exists(),
        "the whole loop needs {}, which is not there: --loop-frames 0 leaves it out",
        program.display()
    );
    let rollout = config.environments() as u64 * u64::from(config.ppo.rollout_steps);
    let folder = Folder(std::env::temp_dir().join(format!("stillroom-bench-run-{}", std::process::id())));
    std::fs::create_dir(&folder.0).with_context(|| folder.0.display().to_string())?;
    let [run, errors, file] = ["run", "errors", "config.toml"].map(|name| folder.0.join(name));
    let mut config = config.clone();
    config.validation.every_frames = 0;
    // A boundary between stages is a checkpoint and a shorter rollout, which a long run has once.
    config.stages.truncate(1);
    std::fs::write(&file, config.to_toml()).with_context(|| file.display().to_string())?;
    let mut command = Command::new(&program);
    // It ends with this process.
    command.arg("--parent").arg(std::process::id().to_string());
    command.args(["up", "--preset", &config.preset]).arg("--config").arg(&file).arg("--run").arg(&run);
    command.arg("--frames").arg(frames.unwrap_or(ROLLOUTS * rollout).to_string());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(File::create(&errors)?);
    let (status, gpu) = monitor.during(|| command.status());
    if !status.with_context(|| program.display().to_string())?.success() {
        let text = std::fs::read_to_string(&errors).unwrap_or_default();
        bail!(
            "the run that shows the whole loop failed: {}",
            text.trim_end().lines().last().unwrap_or("no reason given")
        );
    }
    let (frames, timing) = read(&RunFolder::new(&run).metrics())?;
    Ok(WholeLoop { frames, timing, gpu })
}

/// Frames and times of all rollouts in a run's metrics but the first [`WARM_UP`] and the last one: with overlap no other is
/// collected beside its update, and it may be shorter.
fn read(path: &Path) -> Result<(u64, Timing)> {
    let (history, _) = History::decode(&std::fs::read(path).with_context(|| path.display().to_string())?);
    let mut rollouts: Vec<_> = history.iter().collect();
    rollouts.pop();
    let mut sum = Timing::default();
    rollouts.iter().skip(WARM_UP).for_each(|trained| sum += trained.timing);
    let frames = match (rollouts.get(WARM_UP - 1), rollouts.last()) {
        (Some(warm), Some(last)) => last.frames - warm.frames,
        _ => 0,
    };
    ensure!(
        frames > 0,
        "the run has no rollout that counts, which the first {WARM_UP} and the last do not: give it more --loop-frames"
    );
    Ok((frames, sum))
}
