//! What is kept and shown of a run that trains: `metrics.jsonl`, validation, and the live progress.

use crate::identity::unix_now;
use crate::metrics::{History, Journal, Trained};
use crate::progress::Progress;
use crate::recorder::Recorder;
use crate::supervisor::shell::Audience;
use crate::validation::Validation;
use anyhow::Result;
use proto::config::Config;
use proto::control::LearnerEvent;
use proto::run_folder::RunFolder;
use std::time::Duration;

/// The audience of a training run.
#[derive(Debug)]
pub struct Training {
    /// Rollouts trained so far, in all incarnations.
    pub history: History,
    journal: Journal,
    incarnation: u32,
    progress: Progress,
    validation: Option<Validation>,
}

impl Training {
    /// Goes on with what the folder holds.
    pub fn open(folder: &RunFolder, config: &Config, incarnation: u32) -> Result<Self> {
        Ok(Self {
            history: History::read(folder)?,
            journal: Journal::open(folder)?,
            incarnation,
            progress: Progress::new(config.stages.clone()),
            validation: Validation::open(folder, config)?,
        })
    }
}

impl Audience for Training {
    fn learner(&mut self, now: Duration, event: &LearnerEvent) -> Result<()> {
        self.progress.learner(now, event);
        match event {
            LearnerEvent::Ready { rollout, .. } => self.history.rewind_to(*rollout),
            LearnerEvent::RolloutTrained { rollout, frames, stage, timing, metrics, .. } => {
                let trained = Trained {
                    rollout: *rollout,
                    frames: *frames,
                    stage: *stage,
                    at_unix_s: unix_now(),
                    incarnation: self.incarnation,
                    timing: *timing,
                    metrics: metrics.clone(),
                };
                self.journal.append(&trained)?;
                self.history.insert(trained);
            }
            LearnerEvent::CheckpointWritten { path, rollout, frames, .. } => {
                tracing::debug!("checkpoint {path} at {frames} frames");
                if let Some(validation) = &mut self.validation {
                    validation.checkpoint(*rollout, *frames);
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn learner_died(&mut self, now: Duration) {
        self.progress.learner_died(now);
    }

    fn tick(&mut self, now: Duration, recorder: Option<&Recorder>) {
        if let Some(validation) = &mut self.validation {
            validation.look(recorder);
        }
        self.progress.show(now, &self.history);
    }

    fn is_busy(&self) -> bool {
        self.validation.as_ref().is_some_and(Validation::is_busy)
    }

    fn over(&mut self) {
        self.progress.clear();
        if let Some(validation) = &mut self.validation {
            validation.stop();
        }
    }
}
