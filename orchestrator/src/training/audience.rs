use crate::run::identity::{Incarnation, Moment, unix_now};
use crate::supervisor::shell::Audience;
use crate::training::events;
use crate::training::metrics::{Figures, Journal};
use crate::training::progress::Progress;
use crate::training::summary::Missing;
use crate::training::tensorboard::Board;
use crate::training::validation::Validation;
use anyhow::Result;
use proto::config::{Config, StageConfig};
use proto::event::LearnerEvent;
use proto::run_folder::RunFolder;
use proto::trained::{History, Trained};
use recording::recorder::Recorder;
use std::time::Duration;
use wire::fault;

pub struct TrainingAudience {
    pub journal: Journal,
    /// What was trained before this start, as `status` reads it; none from the learner's beginning on.
    before: Option<History>,
    board: Option<Board>,
    start: Incarnation,
    stages: Vec<StageConfig>,
    progress: Progress,
    validation: Option<Validation>,
}

impl TrainingAudience {
    pub fn open(folder: &RunFolder, config: &Config, start: &Incarnation) -> Result<Self> {
        let board = || Board::of(folder, config, start.number);
        Ok(Self {
            journal: Journal::open(folder)?,
            before: Some(Figures::read(folder, true).history),
            board: config.recording.tensorboard.then(board),
            start: start.clone(),
            stages: config.stages.clone(),
            progress: Progress::new(config),
            validation: Validation::open(folder, config)?,
        })
    }
}

impl TrainingAudience {
    pub fn missing(&mut self) -> Vec<Missing> {
        let mut missing = self.validation.as_ref().map_or_else(Vec::new, Validation::missing);
        let scores = self.validation.as_ref().map_or(&[][..], |validation| &validation.scores[..]);
        let board = self.board.as_mut().is_none_or(|board| board.is_whole(&self.journal.history, scores));
        missing.extend((!board).then_some(Missing::TensorBoard));
        missing
    }
}

impl Audience for TrainingAudience {
    fn learner(&mut self, now: Duration, event: &LearnerEvent) -> Result<()> {
        self.progress.learner(now, event);
        match event {
            LearnerEvent::Ready { rollout, frames, checkpoint, .. } => {
                self.journal.begin(*rollout, checkpoint.as_deref())?;
                self.before = None;
                if let Some(board) = &mut self.board {
                    board.begin(&self.journal.history);
                }
                // The figures of the whole run were compared with files.
                wire::give_memory_back();
                // The orchestrator may not know this checkpoint: it was written after the last orchestrator had ended.
                if let Some(validation) = &mut self.validation {
                    validation.checkpoint(*rollout, *frames);
                }
            }
            LearnerEvent::RolloutTrained { rollout, frames, stage, timing, metrics, .. } => {
                fault::reach("metrics.before_line");
                self.journal.append(Trained {
                    rollout: *rollout,
                    frames: *frames,
                    stage: *stage,
                    at_unix_s: unix_now(),
                    incarnation: self.start.number,
                    wall_s: self.start.started.as_ref().and_then(Moment::elapsed_s),
                    timing: *timing,
                    metrics: metrics.clone().into(),
                })?;
                fault::reach("metrics.after_line");
                if let Some(board) = &mut self.board {
                    board.rollout(&self.journal.history);
                }
            }
            LearnerEvent::CheckpointWritten { path, rollout, frames, .. } => {
                tracing::debug!("checkpoint {path} at {frames} frames");
                if let Some(validation) = &mut self.validation {
                    validation.checkpoint(*rollout, *frames);
                }
            }
            _ => {}
        }
        events::learner(event, &self.stages, &self.journal.history);
        Ok(())
    }

    fn learner_died(&mut self, now: Duration) {
        self.progress.learner_died(now);
    }

    fn tick(&mut self, now: Duration, recorder: Option<&Recorder>) {
        if let Some(validation) = &mut self.validation {
            validation.look(recorder);
            if let Some(board) = &mut self.board {
                board.validations(&validation.scores);
            }
        }
        self.progress.show(now, self.before.as_ref().unwrap_or(&self.journal.history), self.is_busy());
    }

    fn stop_asked(&mut self) {
        self.progress.stop_asked();
    }

    fn is_busy(&self) -> bool {
        self.validation.as_ref().is_some_and(Validation::is_busy)
    }

    fn over(&mut self) {
        self.progress.clear();
        if let Err(error) = self.journal.close() {
            tracing::warn!("{error:#}");
        }
        if let Some(validation) = &mut self.validation {
            validation.stop();
        }
    }
}
