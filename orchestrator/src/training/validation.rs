//! Validation while a run trains: checkpoints are evaluated by a process beside it, and the best one is kept.
//!
//! ```text
//! checkpoint due ─▶ pinned by the learner: hard links in RUN/validation/rollout-K/ ─▶ waiting ─▶ `orchestrator eval`
//!                ─▶ a line in validation.jsonl ─▶ RUN/best names it, or its links are removed
//! ```
//!
//! A crash can interrupt every arrow; [`Validation::open`] reads the state from the folder and continues. An evaluation
//! that fails is made again. One that fails again and again is left to the next `resume`, also of a run that is complete
//! otherwise: its checkpoint stays pinned, and the summary names it ([`Validation::missing`]). A learner that went back
//! and writes the checkpoint again pins it anew and has the evaluation tried again: the old one may have been damaged.
//! So the lines, and which checkpoint is the best, do not depend on what was killed or damaged.

use crate::output::format;
use crate::process_end::wait_for_child;
use crate::run::checkpoints::read_manifest;
use crate::run::cut_off::remove_evaluation;
use crate::run::json_lines::{Writer, set_content};
use crate::run::lifeline::this_program;
use crate::training::events;
use crate::training::next_steps;
use crate::training::scores::{Score, Scores, best, read_result, result_folder};
use crate::training::summary::{Missing, Summary};
use anyhow::{Context, Result};
use proto::config::Config;
use proto::evaluation::has_targets;
use proto::exit::how;
use proto::pin::{pin, unpin};
use proto::plain_file::open_plain;
use proto::run_folder::{RolloutName, RunFolder};
use proto::stage::total_frames;
use recording::recorder::Recorder;
use recording::schema::stillroom;
use std::collections::{BTreeMap, VecDeque};
use std::ffi::OsString;
use std::fs::OpenOptions;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::Duration;
use wire::fault;

const STOPS: Duration = Duration::from_secs(10);
/// Checkpoints that may wait. Each takes the space of a checkpoint.
const WAITING: usize = 8;
const TRIES: u32 = 3;

struct Running {
    rollout: u64,
    child: Child,
}

pub struct Validation {
    folder: RunFolder,
    config: Config,
    pub scores: Vec<Score>,
    reached: u64,
    waiting: VecDeque<u64>,
    running: Option<Running>,
    failures: BTreeMap<u64, u32>,
}

impl Validation {
    pub fn open(folder: &RunFolder, config: &Config) -> Result<Option<Self>> {
        if config.validation.every_frames == 0 {
            return Ok(None);
        }
        let Scores { scores, notes } = Scores::read(folder, config.spec(), true);
        for note in notes {
            tracing::warn!("{note}");
        }
        let mut validation = Self {
            folder: folder.clone(),
            config: config.clone(),
            scores,
            reached: 0,
            waiting: VecDeque::new(),
            running: None,
            failures: BTreeMap::new(),
        };
        validation.mend_log()?;
        std::fs::create_dir_all(folder.validations())
            .with_context(|| format!("cannot create {}", folder.validations().display()))?;
        validation.reached = validation.scores.iter().map(|one| one.frames).max().unwrap_or(0);
        let before = Summary::read(folder).ok().flatten().map_or_else(Vec::new, |summary| summary.missing);
        for missing in before {
            // Not pinned when it fell due: its checkpoint may still be there.
            if let Missing::Validation(rollout) = missing
                && !validation.is_scored(rollout)
                && pin(folder, rollout).is_err()
            {
                validation.failures.insert(rollout, TRIES);
            }
        }
        for rollout in validation.pinned()? {
            if validation.is_scored(rollout) {
                continue;
            }
            let manifest = read_manifest(folder, &validation.manifest(rollout)).and_then(|manifest| {
                let foreign = manifest.is_of_another(&folder.id().unwrap_or_default());
                anyhow::ensure!(!foreign, "its checkpoint is of run {}, not of this one", manifest.run);
                Ok(manifest)
            });
            let frames = match manifest {
                Ok(manifest) => manifest.frames,
                Err(error) => {
                    tracing::warn!(
                        "the validation after rollout {rollout} is left out unless its checkpoint is written again: \
                         {error:#}"
                    );
                    validation.unpin(rollout);
                    validation.failures.insert(rollout, TRIES);
                    continue;
                }
            };
            validation.reached = validation.reached.max(frames);
            // Ascending, as without a crash. However many: the one that ran, and any that failed, waited beside the rest.
            validation.waiting.push_back(rollout);
        }
        validation.try_to_crown();
        Ok(Some(validation))
    }

    fn best(&self) -> Option<&Score> {
        best(&self.scores, self.config.spec())
    }

    fn mend_log(&self) -> Result<()> {
        let mut wanted = Vec::new();
        for one in &self.scores {
            serde_json::to_writer(&mut wanted, one)?;
            wanted.push(b'\n');
        }
        set_content(&self.folder.validation_log(), &wanted)
    }

    fn is_scored(&self, rollout: u64) -> bool {
        self.scores.iter().any(|one| one.rollout == rollout)
    }

    /// A checkpoint has been written, or a learner goes on from it. The learner has pinned it if it is due; an older
    /// one, or one that could not, leaves that to us.
    pub fn checkpoint(&mut self, rollout: u64, frames: u64) {
        let is_pinned = self.manifest(rollout).is_file();
        if self.is_scored(rollout) {
            // A learner that went back comes by again.
            if is_pinned && self.best().is_some_and(|best| best.rollout != rollout) {
                self.unpin(rollout);
            }
            return;
        }
        let complete = frames == total_frames(&self.config.stages) && frames > self.reached;
        if !is_pinned && !complete && !self.config.validation.is_due(self.reached, frames) {
            return;
        }
        self.reached = self.reached.max(frames);
        let runs = self.running.as_ref().is_some_and(|running| running.rollout == rollout);
        if runs || self.waiting.contains(&rollout) {
            return;
        }
        self.failures.remove(&rollout);
        fault::reach("validation.before_pin");
        if let Err(error) = pin(&self.folder, rollout) {
            tracing::warn!("the checkpoint at {frames} frames is not kept for its validation yet: {error}");
        }
        self.enqueue(rollout);
    }

    pub fn look(&mut self, recorder: Option<&Recorder>) {
        if let Some(running) = &mut self.running {
            let rollout = running.rollout;
            let ended = match running.child.try_wait() {
                Ok(None) => return,
                Ok(Some(status)) if status.success() => self.conclude(rollout, recorder),
                Ok(Some(status)) => {
                    Err(anyhow::anyhow!("`orchestrator eval` {}; {} may say why", how(status), self.log().display()))
                }
                Err(error) => Err(error.into()),
            };
            self.running = None;
            if let Err(error) = ended {
                self.failed(rollout, &error);
            }
        }
        if let Some(rollout) = self.waiting.pop_front()
            && let Err(error) = self.start(rollout)
        {
            self.failed(rollout, &error);
        }
    }

    fn failed(&mut self, rollout: u64, error: &anyhow::Error) {
        let failures = self.failures.entry(rollout).or_default();
        *failures += 1;
        if *failures < TRIES {
            tracing::warn!("the validation after rollout {rollout} failed and is made again: {error:#}");
            self.waiting.push_front(rollout);
        } else {
            let resume = next_steps::resume(&next_steps::program(), self.folder.root());
            tracing::warn!(
                "the validation after rollout {rollout} failed {TRIES} times and is left to `{resume}`: {error:#}"
            );
        }
    }

    /// What the run is to have and has not, though nothing waits any more. A `best` that could not be written is tried
    /// once more.
    pub fn missing(&self) -> Vec<Missing> {
        let given_up =
            self.failures.iter().filter(|&(&rollout, &failures)| failures >= TRIES && !self.is_scored(rollout));
        let mut missing: Vec<_> = given_up.map(|(&rollout, _)| Missing::Validation(rollout)).collect();
        missing.extend((!self.try_to_crown()).then_some(Missing::Best));
        missing
    }

    fn evaluation(&self, rollout: u64) -> Vec<OsString> {
        let validation = self.config.validation;
        let mut words = vec!["eval".into(), self.manifest(rollout).into_os_string()];
        let elsewhere = self.config.environment.is_some();
        // The preset's number is one for each of five kitchens.
        let actors = if elsewhere { validation.actors.min(self.config.actors.count) } else { validation.actors };
        let (objects, actors) = (validation.objects.name(), actors.to_string());
        words.extend(["--split", "validation", "--actors", &actors].map(OsString::from));
        if has_targets(self.config.spec()) {
            words.extend(["--objects", objects].map(OsString::from));
        }
        if validation.episodes > 0 {
            words.extend(["--episodes".into(), validation.episodes.to_string().into()]);
        }
        words
    }

    pub fn is_busy(&self) -> bool {
        self.running.is_some() || !self.waiting.is_empty()
    }

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
        if let Err(error) = remove_evaluation(&self.result(rollout)) {
            tracing::warn!("{error:#}");
        }
    }

    /// Notes that a pinned checkpoint is to be evaluated. If too many wait, the oldest gives way.
    fn enqueue(&mut self, rollout: u64) {
        self.waiting.push_back(rollout);
        if self.waiting.len() > WAITING
            && let Some(skipped) = self.waiting.pop_front()
        {
            tracing::warn!(
                "the validation after rollout {skipped} is skipped: {WAITING} others wait. Fewer of them \
                 (validation.every_frames, validation.episodes) would all be made"
            );
            self.unpin(skipped);
        }
    }

    fn start(&mut self, rollout: u64) -> Result<()> {
        pin(&self.folder, rollout)?;
        let result = self.result(rollout);
        remove_evaluation(&result)?;
        let log_path = self.log();
        let log = open_plain(&log_path, OpenOptions::new().create(true).append(true));
        let log = log.with_context(|| format!("cannot open {}", log_path.display()))?;
        let mut command = this_program();
        command.args(self.evaluation(rollout)).args(["--beside", &std::process::id().to_string()]);
        command.arg("--out").arg(&result).env_remove(wire::fault::VARIABLE);
        // A group of its own: Ctrl-C reaches the run alone, which decides.
        command.stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log).process_group(0);
        let child = command.spawn().context("cannot start `orchestrator eval`")?;
        tracing::info!("validation after rollout {rollout} begins");
        fault::reach("validation.after_start");
        self.running = Some(Running { rollout, child });
        Ok(())
    }

    fn conclude(&mut self, rollout: u64, recorder: Option<&Recorder>) -> Result<()> {
        let evaluation = read_result(&result_folder(&self.folder, rollout))?;
        let one = Score::of(rollout, &evaluation, self.config.spec());
        fault::reach("validation.before_line");
        let mut log = Writer::open(&self.folder.validation_log())?;
        log.append(&one)?;
        events::validated(&one);
        fault::reach("validation.after_line");
        log.sync()?;
        self.scores.push(one.clone());
        self.try_to_crown();
        let is_best = self.best().is_some_and(|best| best.rollout == rollout);
        let shown = self.config.spec().shown();
        tracing::info!(
            "validation at {} frames, {}: {}{}",
            one.frames,
            evaluation.conditions.episodes_played(),
            format::metrics(shown.iter().filter(|metric| metric.unit.is_empty()), &one.figures, ", "),
            if is_best { ", the best so far" } else { "" }
        );
        if let Some(recorder) = recorder {
            recorder.validation(stillroom::Validation {
                rollout,
                frames: one.frames,
                episodes: one.episodes,
                length: one.length,
                best: is_best,
                figures: one.figures,
            });
        }
        Ok(())
    }

    /// Has `RUN/best` name the best checkpoint, then lets go of the others that have been scored. False with a warning
    /// where it cannot be written: the next validation or start tries again.
    fn try_to_crown(&self) -> bool {
        let Some(best) = self.best() else { return true };
        if self.folder.best_rollout() != Some(best.rollout) {
            if let Err(error) = self.folder.set_best(best.rollout) {
                tracing::warn!("{} does not name the best checkpoint: {error}", self.folder.best().display());
                return false;
            }
            fault::reach("validation.after_crown");
        }
        for one in self.scores.iter().filter(|one| one.rollout != best.rollout) {
            self.unpin(one.rollout);
        }
        true
    }

    fn unpin(&self, rollout: u64) {
        if let Err(error) = unpin(&self.folder, rollout) {
            tracing::warn!("cannot delete {error}");
        }
    }

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
        result_folder(&self.folder, rollout).root().to_owned()
    }

    fn log(&self) -> PathBuf {
        self.folder.log("validation")
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::run::checkpoints::tests::manifest;
    use crate::training::scores::tests::validated;
    use std::io::Write;
    use std::os::unix::process::ExitStatusExt;
    use std::process::Command;

    /// A run with checkpoints on disk, each of 100 frames more, to be validated after each 250.
    pub fn run(rollouts: &[u64]) -> (tempfile::TempDir, RunFolder, Config) {
        let temporary = tempfile::tempdir().unwrap();
        // With a space, which a shell must not see.
        let folder = RunFolder::new(temporary.path().join("my run"));
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
    fn checkpoints_that_are_due_are_pinned_and_wait() {
        let (_temporary, folder, config) = run(&[1, 2, 3, 4, 5, 6]);
        let mut validation = Validation::open(&folder, &config).unwrap().unwrap();
        // 250, 500: the first boundaries behind them are 300 and 500.
        for rollout in 1..=6 {
            validation.checkpoint(rollout, rollout * 100);
        }
        assert_eq!(validation.pinned().unwrap(), [3, 5]);
        assert_eq!(validation.waiting, [3, 5]);
        // A learner that went back comes by again.
        validation.checkpoint(3, 300);
        assert_eq!(validation.waiting, [3, 5]);
        // Pruning takes the checkpoint, not the pinned one; a crash later it still waits.
        std::fs::remove_file(folder.checkpoint_tensors(5)).unwrap();
        let mut again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(again.reached, 500);
        assert_eq!(again.waiting, [3, 5]);
        let tensors = again.manifest(5).with_extension("safetensors");
        assert_eq!(std::fs::read_to_string(tensors).unwrap(), "tensors 5");

        // One that the learner pinned is due, whatever was evaluated after it.
        pin(&folder, 2).unwrap();
        again.checkpoint(2, 200);
        assert_eq!(again.waiting, [3, 5, 2]);
    }

    /// One runs and eight wait when a run ends: at the next start nine wait, and none of them is too many.
    #[test]
    fn one_that_ran_when_the_run_ended_is_not_pushed_out_by_those_that_waited() {
        let rollouts: Vec<u64> = (1..=10).map(|number| number * 3).collect();
        let (_temporary, folder, config) = run(&rollouts);
        let mut validation = Validation::open(&folder, &config).unwrap().unwrap();
        validation.checkpoint(3, 300);
        let first = validation.waiting.pop_front().unwrap();
        let child = Command::new("sleep").arg("60").spawn().unwrap();
        validation.running = Some(Running { rollout: first, child });
        for &rollout in &rollouts[1..9] {
            validation.checkpoint(rollout, rollout * 100);
        }
        validation.stop();
        let mut again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(again.waiting, &rollouts[..9]);
        // From here on a new one pushes one out, as ever.
        again.checkpoint(30, 3000);
        assert_eq!(again.waiting, &rollouts[1..]);
        assert_eq!(again.pinned().unwrap(), rollouts[1..]);
    }

    #[test]
    fn an_evaluation_that_was_killed_is_made_again_and_then_left_to_the_next_start() {
        let (_temporary, folder, config) = run(&[3, 5]);
        let mut validation = Validation::open(&folder, &config).unwrap().unwrap();
        validation.checkpoint(3, 300);
        validation.checkpoint(5, 500);
        assert_eq!(validation.waiting.pop_front(), Some(3));
        let mut child = Command::new("sleep").arg("60").spawn().unwrap();
        child.kill().unwrap();
        assert_eq!(child.wait().unwrap().signal(), Some(9));
        validation.running = Some(Running { rollout: 3, child });
        // Killed, and then it cannot be started: there is no folder for its log.
        validation.look(None);
        assert_eq!((validation.failures[&3], validation.is_busy()), (2, true));
        assert_eq!(validation.waiting, [3, 5]);
        validation.look(None);
        assert_eq!(validation.failures, BTreeMap::from([(3, TRIES)]));
        assert_eq!(validation.waiting, [5]);
        assert_eq!(validation.pinned().unwrap(), [3, 5], "its checkpoint is kept");
        assert_eq!(validation.missing(), [Missing::Validation(3)]);
        let again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(again.waiting, [3, 5]);
        assert_eq!(again.missing(), []);
    }

    #[test]
    fn the_best_is_kept_and_a_crash_at_any_point_is_mended() {
        let (_temporary, folder, config) = run(&[3, 5, 8]);
        for rollout in [3, 5, 8] {
            pin(&folder, rollout).unwrap();
        }
        append(&folder, &validated(3, 0.2, 0.2)).unwrap();
        append(&folder, &validated(5, 0.1, 0.6)).unwrap();
        // A crash in the middle of a line.
        let mut file = OpenOptions::new().append(true).open(folder.validation_log()).unwrap();
        file.write_all(b"{\"rollout\": 8, \"fra").unwrap();
        let again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(folder.best_rollout(), Some(3));
        assert!(folder.best().join("rollout-00000003.safetensors").is_file());
        assert_eq!((again.pinned().unwrap(), again.waiting), (vec![3, 8], VecDeque::from([8])));
        let text = std::fs::read_to_string(folder.validation_log()).unwrap();
        assert!(text.lines().count() == 2 && text.ends_with('\n'), "what was cut short is gone: {text}");

        append(&folder, &validated(8, 0.3, 0.3)).unwrap();
        let again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(again.scores.iter().map(|one| one.rollout).collect::<Vec<_>>(), [3, 5, 8]);
        assert_eq!((folder.best_rollout(), again.pinned().unwrap()), (Some(8), vec![8]));
    }

    /// The error of a disk without links ended every start.
    #[test]
    fn a_best_that_cannot_be_written_is_missing_and_ends_no_start() {
        let (_temporary, folder, config) = run(&[3]);
        pin(&folder, 3).unwrap();
        append(&folder, &validated(3, 0.2, 0.2)).unwrap();
        std::fs::create_dir_all(folder.best().join("in the way")).unwrap();
        let validation = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(validation.missing(), [Missing::Best]);
        assert_eq!(validation.pinned().unwrap(), [3]);
        std::fs::remove_dir_all(folder.best()).unwrap();
        assert_eq!((validation.missing(), folder.best_rollout()), (vec![], Some(3)));
    }

    #[test]
    fn a_validation_whose_manifest_is_damaged_waits_until_it_is_written_again() {
        let (_temporary, folder, config) = run(&[3, 5]);
        let validation = Validation::open(&folder, &config).unwrap().unwrap();
        for rollout in [3, 5] {
            pin(&folder, rollout).unwrap();
        }
        let path = validation.manifest(5);
        std::fs::remove_file(&path).unwrap();
        let text = String::from_utf8(manifest(5, 500)).unwrap();
        assert!(text.contains("500"));
        std::fs::write(&path, text.replace("500", "501")).unwrap();
        let mut again = Validation::open(&folder, &config).unwrap().unwrap();
        assert_eq!(again.missing(), [Missing::Validation(5)]);
        assert_eq!((again.pinned().unwrap(), again.reached), (vec![3], 300));
        assert_eq!(again.waiting, [3]);
        // The learner went back and has written it again.
        again.checkpoint(5, 500);
        assert_eq!(again.missing(), []);
        assert_eq!((again.pinned().unwrap(), again.waiting), (vec![3, 5], VecDeque::from([3, 5])));
    }
}
