//! Validation while a run trains: checkpoints are evaluated by a process beside it, and the best one is kept.
//!
//! ```text
//! checkpoint due ─▶ pinned: hard links in RUN/validation/rollout-K/ ─▶ waiting (one at most) ─▶ `orchestrator eval`
//!                ─▶ a line in validation.jsonl ─▶ RUN/best points to it, or its links are removed
//! ```
//!
//! A crash can interrupt every arrow; [`Validation::open`] reads the state from the folder and continues. An evaluation
//! that fails is reported and skipped; the run continues.

use crate::evaluation::subject::read_manifest;
use crate::process_end::wait_for_child;
use crate::recording::recorder::Recorder;
use crate::recording::schema::stillroom;
use crate::run::identity::Identity;
use crate::run::json_lines;
use crate::run::json_lines::Writer;
use crate::run::lifeline::this_program;
use crate::run::remains;
use anyhow::{Context, Result};
use proto::config::Config;
use proto::evaluation::{Distribution, Evaluation, RESULT_FILE};
use proto::plain_file::open_plain;
use proto::run_folder::{RolloutName, RunFolder};
use proto::stage::total_frames;
use serde::{Deserialize, Serialize};
use std::fs::OpenOptions;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Duration;

/// Time that an evaluation has to stop its processes.
const STOPS: Duration = Duration::from_secs(10);

/// One line of `validation.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// First rollout that is not in the checkpoint.
    pub rollout: u64,
    /// Frames that its weights were trained on.
    pub frames: u64,
    /// SHA-256 of the weights, 64 hex digits.
    pub weights: String,
    /// Folder of the result, relative to the run folder.
    pub result: String,
    /// Episodes played.
    pub episodes: u64,
    /// Fixed ones, or drawn as the run draws its own.
    #[serde(default)]
    pub distribution: Distribution,
    /// SR.
    pub success: f64,
    /// `SRwoD`.
    pub success_without_disturbance: f64,
    /// `SRwoD` by the largest displacement on an axis; none in lines of versions that did not give it.
    #[serde(default)]
    pub success_without_disturbance_per_axis: Option<f64>,
    /// Share of episodes in which the target was picked up.
    pub picked_up: f64,
    /// Mean length, steps.
    pub length: f64,
    /// Mean total displacement at the end, metres.
    pub disturbance_m: f64,
    /// Mean number of disturbed objects at the end.
    pub disturbed_objects: f64,
    /// When, seconds since 1970.
    pub at_unix_s: u64,
    /// What it took, seconds.
    pub wall_s: f64,
}

impl Score {
    fn of(rollout: u64, evaluation: &Evaluation) -> Self {
        let figures = &evaluation.overall;
        let known = |figure: Option<f64>| figure.unwrap_or(0.0);
        Self {
            rollout,
            frames: evaluation.subject.frames,
            weights: evaluation.subject.weights.clone(),
            result: format!("{}/result", RunFolder::relative_validation(rollout)),
            episodes: figures.episodes,
            distribution: evaluation.conditions.distribution,
            success: known(figures.success),
            success_without_disturbance: known(figures.success_without_disturbance),
            success_without_disturbance_per_axis: figures.success_without_disturbance_per_axis,
            picked_up: known(figures.picked_up),
            length: known(figures.length),
            disturbance_m: known(figures.disturbance_m),
            disturbed_objects: known(figures.disturbed_objects),
            at_unix_s: evaluation.cost.at_unix_s,
            wall_s: evaluation.cost.wall_s,
        }
    }

    /// At least as good: by `SRwoD`, then SR, then the longer training.
    fn beats(&self, other: &Self) -> bool {
        let key = |one: &Self| (one.success_without_disturbance, one.success);
        match key(self).partial_cmp(&key(other)) {
            Some(std::cmp::Ordering::Equal) | None => self.frames >= other.frames,
            Some(order) => order.is_gt(),
        }
    }
}

/// The best of these.
fn best(scored: &[Score]) -> Option<&Score> {
    scored.iter().reduce(|best, one| if one.beats(best) { one } else { best })
}

/// The evaluation that runs.
#[derive(Debug)]
struct Running {
    rollout: u64,
    child: Child,
}

/// Validation of one run.
#[derive(Debug)]
pub struct Validation {
    folder: RunFolder,
    config: Config,
    scores: Vec<Score>,
    /// Frames of the newest checkpoint that was due.
    reached: u64,
    waiting: Option<u64>,
    running: Option<Running>,
}

impl Validation {
    /// Continues from the folder's state; none if the run has no validation.
    pub fn open(folder: &RunFolder, config: &Config) -> Result<Option<Self>> {
        if config.validation.every_frames == 0 {
            return Ok(None);
        }
        let mut validation = Self {
            folder: folder.clone(),
            config: config.clone(),
            scores: read_log(&folder.validation_log())?,
            reached: 0,
            waiting: None,
            running: None,
        };
        std::fs::create_dir_all(folder.validations())
            .with_context(|| format!("cannot create {}", folder.validations().display()))?;
        validation.reached = validation.scores.iter().map(|one| one.frames).max().unwrap_or(0);
        for rollout in validation.pinned()? {
            if validation.scores.iter().any(|one| one.rollout == rollout) {
                continue;
            }
            let frames = match read_manifest(&validation.manifest(rollout)) {
                Ok(manifest) => manifest.frames,
                Err(error) => {
                    tracing::warn!("the validation after rollout {rollout} is left out: {error:#}");
                    validation.unpin(rollout);
                    continue;
                }
            };
            validation.reached = validation.reached.max(frames);
            if validation.result(rollout).join(RESULT_FILE).is_file() {
                validation.conclude(rollout, None)?;
            } else {
                // Ascending: the newest is the one that waits.
                validation.enqueue(rollout);
            }
        }
        validation.crown()?;
        Ok(Some(validation))
    }

    /// A checkpoint has been written.
    pub fn checkpoint(&mut self, rollout: u64, frames: u64) {
        let complete = frames == total_frames(&self.config.stages) && frames > self.reached;
        if !complete && !self.config.validation.is_due(self.reached, frames) {
            return;
        }
        self.reached = frames;
        match self.pin(rollout) {
            Ok(()) => self.enqueue(rollout),
            Err(error) => tracing::warn!("no validation at {frames} frames: {error:#}"),
        }
    }

    /// Looks after the evaluation that runs, and starts the one that waits.
    pub fn look(&mut self, recorder: Option<&Recorder>) {
        if let Some(running) = &mut self.running {
            let rollout = running.rollout;
            let ended = match running.child.try_wait() {
                Ok(None) => return,
                Ok(Some(status)) if status.success() => self.conclude(rollout, recorder),
                Ok(Some(status)) => {
                    Err(anyhow::anyhow!("`orchestrator eval` ended with {status}; {} says why", self.log().display()))
                }
                Err(error) => Err(error.into()),
            };
            self.running = None;
            if let Err(error) = ended {
                tracing::warn!("the validation after rollout {rollout} is left out: {error:#}");
                self.unpin(rollout);
            }
        }
        if let Some(rollout) = self.waiting.take()
            && let Err(error) = self.start(rollout)
        {
            tracing::warn!("the validation after rollout {rollout} cannot be started: {error:#}");
            self.unpin(rollout);
        }
    }

    /// Whether an evaluation runs or waits.
    pub fn is_busy(&self) -> bool {
        self.running.is_some() || self.waiting.is_some()
    }

    /// Ends the evaluation that runs; it is made anew when the run goes on.
    pub fn stop(&mut self) {
        let Some(Running { rollout, mut child }) = self.running.take() else { return };
        tracing::info!("the validation after rollout {rollout} is stopped");
        if let Some(pid) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
            // Not reaped yet, so the number is still its own.
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
        if !matches!(wait_for_child(&mut child, STOPS), Ok(Some(_))) {
            let _ = child.kill();
            let _ = child.wait();
        }
        if let Err(error) = clear(&self.result(rollout)) {
            tracing::warn!("{error:#}");
        }
    }

    /// Notes that a pinned checkpoint is to be evaluated. It replaces a waiting one.
    fn enqueue(&mut self, rollout: u64) {
        if let Some(skipped) = self.waiting.replace(rollout) {
            tracing::info!("the validation after rollout {skipped} is skipped: one after rollout {rollout} is due");
            self.unpin(skipped);
        }
    }

    /// Starts the evaluation of a pinned checkpoint.
    fn start(&mut self, rollout: u64) -> Result<()> {
        let result = self.result(rollout);
        clear(&result)?;
        let log_path = self.log();
        let log = open_plain(&log_path, OpenOptions::new().create(true).append(true));
        let log = log.with_context(|| format!("cannot open {}", log_path.display()))?;
        let validation = self.config.validation;
        let mut command = this_program();
        command.arg("eval").arg(self.manifest(rollout)).args(["--split", "valid"]);
        command.args(["--beside", &std::process::id().to_string()]);
        command.args(["--objects", validation.objects.name(), "--actors", &validation.actors.to_string()]);
        if validation.episodes > 0 {
            command.args(["--episodes", &validation.episodes.to_string()]);
        }
        command.arg("--out").arg(&result).env_remove(wire::fault::VARIABLE);
        // A group of its own: Ctrl-C reaches the run alone, which decides.
        command.stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log).process_group(0);
        let child = command.spawn().context("cannot start `orchestrator eval`")?;
        tracing::info!("validation after rollout {rollout} begins");
        self.running = Some(Running { rollout, child });
        Ok(())
    }

    /// Takes in a result: a line, and the best is crowned.
    fn conclude(&mut self, rollout: u64, recorder: Option<&Recorder>) -> Result<()> {
        let path = self.result(rollout).join(RESULT_FILE);
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let evaluation: Evaluation = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
        let one = Score::of(rollout, &evaluation);
        let mut log = Writer::open(&self.folder.validation_log())?;
        log.append(&one)?;
        log.sync()?;
        self.scores.push(one.clone());
        self.crown()?;
        let is_best = best(&self.scores).is_some_and(|best| best.rollout == rollout);
        tracing::info!(
            "validation at {} frames, {}: success {:.1}%, SRwoD {:.1}%{}",
            one.frames,
            evaluation.conditions.episodes_played(),
            100.0 * one.success,
            100.0 * one.success_without_disturbance,
            if is_best { ", the best so far" } else { "" }
        );
        if let Some(recorder) = recorder {
            recorder.validation(stillroom::Validation {
                rollout,
                frames: one.frames,
                episodes: one.episodes,
                success: one.success,
                success_without_disturbance: one.success_without_disturbance,
                picked_up: one.picked_up,
                length: one.length,
                disturbance_m: one.disturbance_m,
                disturbed_objects: one.disturbed_objects,
                best: is_best,
            });
        }
        Ok(())
    }

    /// Has `RUN/best` point to the best checkpoint, then lets go of the others that have been scored.
    fn crown(&self) -> Result<()> {
        let Some(best) = best(&self.scores) else { return Ok(()) };
        let link = self.folder.best();
        let target = RunFolder::relative_validation(best.rollout);
        if std::fs::read_link(&link).ok().as_deref() != Some(Path::new(&target)) {
            let partial = link.with_extension("partial");
            match std::fs::remove_file(&partial) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(error).with_context(|| format!("cannot replace {}", partial.display()));
                }
                _ => {}
            }
            // Renamed into place: at every moment there is a best one, the old or the new.
            std::os::unix::fs::symlink(&target, &partial)
                .and_then(|()| std::fs::rename(&partial, &link))
                .with_context(|| format!("cannot make {}", link.display()))?;
        }
        for one in self.scores.iter().filter(|one| one.rollout != best.rollout) {
            self.unpin(one.rollout);
        }
        Ok(())
    }

    /// Keeps a checkpoint from being pruned: hard links, or copies where those cannot be.
    fn pin(&self, rollout: u64) -> Result<()> {
        let place = self.folder.validation(rollout);
        std::fs::create_dir_all(&place).with_context(|| format!("cannot create {}", place.display()))?;
        // The manifest last, as always: a checkpoint without one does not exist.
        for from in [self.folder.checkpoint_tensors(rollout), self.folder.checkpoint_manifest(rollout)] {
            let to = place.join(from.file_name().context("a checkpoint's files have names")?);
            let linked = match std::fs::hard_link(&from, &to) {
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
                    std::fs::remove_file(&to).and_then(|()| std::fs::hard_link(&from, &to))
                }
                linked => linked,
            };
            linked
                .or_else(|_| std::fs::copy(&from, &to).map(drop))
                .with_context(|| format!("cannot keep {} as {}", from.display(), to.display()))?;
        }
        Ok(())
    }

    /// Lets go of a checkpoint; its result stays.
    fn unpin(&self, rollout: u64) {
        for name in [RolloutName::Manifest, RolloutName::Tensors] {
            let path = self.folder.validation(rollout).join(name.of(rollout));
            match std::fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    tracing::warn!("cannot delete {}: {error}", path.display());
                }
                _ => {}
            }
        }
    }

    /// Rollouts of the pinned checkpoints, ascending.
    fn pinned(&self) -> Result<Vec<u64>> {
        let place = self.folder.validations();
        let mut rollouts = vec![];
        for entry in std::fs::read_dir(&place).with_context(|| place.display().to_string())? {
            let rollout = RolloutName::Folder.rollout_of(&entry?.path());
            rollouts.extend(rollout.filter(|&rollout| self.manifest(rollout).is_file()));
        }
        rollouts.sort_unstable();
        Ok(rollouts)
    }

    fn manifest(&self, rollout: u64) -> PathBuf {
        self.folder.validation(rollout).join(RolloutName::Manifest.of(rollout))
    }

    fn result(&self, rollout: u64) -> PathBuf {
        self.folder.validation(rollout).join("result")
    }

    fn log(&self) -> PathBuf {
        self.folder.log("validation")
    }
}

/// Removes an evaluation that was cut off, and what it left in shared memory.
fn clear(result: &Path) -> Result<()> {
    if !result.exists() {
        return Ok(());
    }
    if let Ok(identity) = Identity::read(&RunFolder::new(result)) {
        for incarnation in identity.incarnations.iter().filter(|incarnation| incarnation.ended.is_none()) {
            remains::sweep(&identity.address(incarnation), Duration::from_secs(2))?;
        }
    }
    std::fs::remove_dir_all(result).with_context(|| format!("cannot remove {}", result.display()))
}

/// The lines of a run's log; none when it was never validated.
pub fn read_log(path: &Path) -> Result<Vec<Score>> {
    json_lines::read(path)
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::evaluation::subject::tests::manifest;
    use std::io::Write;

    fn validated(rollout: u64, undisturbed: f64, success: f64) -> Score {
        Score {
            rollout,
            frames: rollout * 100,
            weights: "00".repeat(32),
            result: String::new(),
            episodes: 10,
            distribution: Distribution::Fixed,
            success,
            success_without_disturbance: undisturbed,
            success_without_disturbance_per_axis: None,
            picked_up: 0.0,
            length: 1.0,
            disturbance_m: 0.0,
            disturbed_objects: 0.0,
            at_unix_s: 0,
            wall_s: 1.0,
        }
    }

    /// A run with checkpoints on disk, each of 100 frames more, to be validated after each 250.
    pub fn run(rollouts: &[u64]) -> (tempfile::TempDir, RunFolder, Config) {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        std::fs::create_dir_all(folder.checkpoints()).unwrap();
        for &rollout in rollouts {
            std::fs::write(folder.checkpoint_tensors(rollout), format!("tensors {rollout}")).unwrap();
            std::fs::write(folder.checkpoint_manifest(rollout), manifest(rollout, rollout * 100)).unwrap();
        }
        let mut config = Config::resolve("demo", None).unwrap();
        config.validation.every_frames = 250;
        (temporary, folder, config)
    }

    fn append(folder: &RunFolder, one: &Score) -> Result<()> {
        Writer::open(&folder.validation_log())?.append(one)
    }

    #[test]
    fn the_best_is_undisturbed_then_successful_then_trained_longer() {
        let mut scored = vec![validated(1, 0.1, 0.9), validated(2, 0.2, 0.3), validated(3, 0.2, 0.4)];
        assert_eq!(best(&scored).unwrap().rollout, 3);
        scored.push(validated(4, 0.2, 0.4));
        scored.push(validated(5, 0.2, 0.3));
        assert_eq!(best(&scored).unwrap().rollout, 4);
        assert!(best(&[]).is_none());
    }

    #[test]
    fn a_checkpoint_that_is_due_is_pinned_and_the_newest_waits() {
        let (_temporary, folder, config) = run(&[1, 2, 3, 4, 5, 6]);
        let mut validation = Validation::open(&folder, &config).unwrap().unwrap();
        // 250, 500: the first boundaries behind them are 300 and 500.
        for rollout in 1..=6 {
            validation.checkpoint(rollout, rollout * 100);
        }
        assert_eq!(validation.pinned().unwrap(), [5]);
        assert_eq!(validation.waiting, Some(5));
        // A learner that went back comes by again.
        validation.checkpoint(3, 300);
        assert_eq!(validation.pinned().unwrap(), [5]);
        // Pruning takes the checkpoint, not the pinned one; a crash later it still waits.
        std::fs::remove_file(folder.checkpoint_tensors(5)).unwrap();
        let again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!((again.waiting, again.reached), (Some(5), 500));
        let tensors = again.manifest(5).with_extension("safetensors");
        assert_eq!(std::fs::read_to_string(tensors).unwrap(), "tensors 5");
    }

    #[test]
    fn the_best_is_kept_and_a_crash_at_any_point_is_mended() {
        let (_temporary, folder, config) = run(&[3, 5, 8]);
        let validation = Validation::open(&folder, &config).unwrap().unwrap();
        for rollout in [3, 5, 8] {
            validation.pin(rollout).unwrap();
        }
        append(&folder, &validated(3, 0.2, 0.2)).unwrap();
        append(&folder, &validated(5, 0.1, 0.6)).unwrap();
        // A crash in the middle of a line.
        let mut file = OpenOptions::new().append(true).open(folder.validation_log()).unwrap();
        file.write_all(b"{\"rollout\": 8, \"fra").unwrap();
        let again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(std::fs::read_link(folder.best()).unwrap(), Path::new("validation/rollout-00000003"));
        assert!(folder.best().join("rollout-00000003.safetensors").is_file());
        assert_eq!((again.pinned().unwrap(), again.waiting), (vec![3, 8], Some(8)));

        append(&folder, &validated(8, 0.3, 0.3)).unwrap();
        let again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(again.scores.iter().map(|one| one.rollout).collect::<Vec<_>>(), [3, 5, 8]);
        assert_eq!(std::fs::read_link(folder.best()).unwrap(), Path::new("validation/rollout-00000008"));
        assert_eq!(again.pinned().unwrap(), [8]);
    }

    #[test]
    fn a_waiting_validation_whose_manifest_is_damaged_is_left_out() {
        let (_temporary, folder, config) = run(&[3, 5]);
        let validation = Validation::open(&folder, &config).unwrap().unwrap();
        for rollout in [3, 5] {
            validation.pin(rollout).unwrap();
        }
        let path = validation.manifest(5);
        std::fs::remove_file(&path).unwrap();
        let text = String::from_utf8(manifest(5, 500)).unwrap();
        assert!(text.contains("500"));
        std::fs::write(&path, text.replace("500", "501")).unwrap();
        let again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!((again.pinned().unwrap(), again.waiting, again.reached), (vec![3], Some(3), 300));
    }

    #[test]
    fn an_evaluation_that_was_cut_off_names_no_folder_that_is_deleted() {
        let temporary = tempfile::tempdir().unwrap();
        let (result, precious) = (temporary.path().join("result"), temporary.path().join("precious"));
        for folder in [&result, &precious] {
            std::fs::create_dir(folder).unwrap();
        }
        let mut identity = Identity::new().unwrap();
        identity.begin_incarnation();
        identity.incarnations[0].wire = format!("stillroom_@{}", precious.display());
        identity.write(&RunFolder::new(&result)).unwrap();
        clear(&result).unwrap();
        assert!(precious.is_dir() && !result.exists());
    }

    #[test]
    fn a_run_that_asks_for_none_has_none() {
        let (_temporary, folder, mut config) = run(&[]);
        config.validation.every_frames = 0;
        assert!(Validation::open(&folder, &config).unwrap().is_none());
        assert!(!folder.validations().exists());
    }
}
