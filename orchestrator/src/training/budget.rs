//! Another frame budget for a run that has begun: `orchestrator resume --frames`.
//!
//! Two files hold the budget's state: `config.toml` has the budget, and `summary.json` exists when it is reached. The
//! summary is removed first and the configuration replaced after it. So a crash leaves the run with its old budget,
//! which the next resume finds reached and sums up again, or with the new one.

use super::run::write_config;
use crate::output::{format, terminal};
use anyhow::{Context, Result};
use proto::config::{Config, PpoConfig, StageConfig};
use proto::disk::sync_folder;
use proto::learning_rate::{falling, learning_rate_progress};
use proto::run_folder::RunFolder;
use proto::stage::{position_at, rebudget, total_frames};
use wire::fault;

#[derive(Debug, Clone, PartialEq)]
pub struct Budget {
    old: Vec<StageConfig>,
    new: Vec<StageConfig>,
    trained: u64,
}

impl Budget {
    /// Judges `total` frames for a run that goes on from `trained`, on which no process works.
    pub fn of(config: &Config, trained: u64, total: u64) -> Result<Self> {
        let new = rebudget(&config.stages, trained, total)?;
        Config { stages: new.clone(), ..config.clone() }.validate()?;
        Ok(Self { old: config.stages.clone(), new, trained })
    }

    pub fn is_old(&self) -> bool {
        self.old == self.new
    }

    pub fn lay_over(&self, config: &Config) -> Config {
        Config { stages: self.new.clone(), ..config.clone() }
    }

    pub fn announce(&self, config: &Config) {
        for line in self.lines(config) {
            terminal::note(&line);
        }
    }

    fn lines(&self, config: &Config) -> Vec<String> {
        let count = |stages: &[StageConfig]| format::count(total_frames(stages));
        let changed = self.old.iter().zip(&self.new).filter(|(old, new)| old != new);
        let stages = changed.map(|(old, new)| {
            format!("stage {}: {} instead of {}", new.name, format::count(new.frames), format::count(old.frames))
        });
        let stages = stages.collect::<Vec<_>>().join(", ");
        let mut lines =
            vec![format!("the budget is {} frames instead of {} ({stages})", count(&self.new), count(&self.old))];
        let ppo = &config.ppo;
        let falls = if let Some((before, after)) = self.changed(ppo, ppo.learning_rate, ppo.learning_rate_end) {
            format!(
                "the learning rate falls over the length of a stage: the next update takes {after:.3e} instead of \
                 {before:.3e}"
            )
        } else if self.changed(ppo, ppo.entropy_coefficient, ppo.entropy_coefficient_end).is_some() {
            "the entropy bonus falls over the length of a stage".to_owned()
        } else if self.changed(ppo, ppo.clip, ppo.clip_end).is_some() {
            "the clip falls over the length of a stage".to_owned()
        } else {
            return lines;
        };
        lines.push(format!(
            "{falls}. What comes of it is not the run that would have had this budget from its beginning"
        ));
        lines
    }

    /// What a constant that falls from `start` to a share `end` of it is in the next update under the old budget and under
    /// the new one, if they differ. The stage in progress must have been trained in: all of one that has not begun is under
    /// the new budget.
    fn changed(&self, ppo: &PpoConfig, start: f64, end: f64) -> Option<(f64, f64)> {
        let position = position_at(&self.new, self.trained)?;
        let old = &self.old[position.stage];
        if position.frames_in_stage == 0 || old.frames == self.new[position.stage].frames {
            return None;
        }
        let value = |stage: &StageConfig| {
            let progress = learning_rate_progress(position.frames_in_stage, stage.frames, ppo.learning_rate_frames);
            falling(start, end, progress)
        };
        let (before, after) = (value(old), value(&self.new[position.stage]));
        (before != after).then_some((before, after))
    }

    pub fn write(&self, folder: &RunFolder, config: &Config) -> Result<()> {
        fault::reach("resume.before_budget");
        let summary = folder.summary();
        match std::fs::remove_file(&summary) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot remove {}", summary.display()));
            }
            // Gone on the disk, too, before the new budget is there.
            _ => sync_folder(folder.root()).with_context(|| format!("cannot write {}", folder.root().display()))?,
        }
        fault::reach("resume.amid_budget");
        write_config(folder, &self.lay_over(config))?;
        fault::reach("resume.after_budget");
        Ok(())
    }
}
