//! Another frame budget for a run that has begun: `orchestrator resume --frames`.
//!
//! Two files hold the budget's state: `config.toml` has the budget, and `summary.json` exists when it is reached. The
//! summary is removed first and the configuration replaced after it. So a crash leaves the run with its old budget,
//! which the next resume finds reached and sums up again, or with the new one.

use crate::output::{format, terminal};
use anyhow::{Context, Result};
use proto::config::{Config, StageConfig};
use proto::disk::sync_folder;
use proto::learning_rate::{falling, learning_rate_progress};
use proto::run_folder::{RunFolder, write_atomically};
use proto::stage::{position_at, rebudget, total_frames};
use wire::fault;

/// A new budget that a run can have.
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

    /// Whether it is the budget that the run has.
    pub fn is_old(&self) -> bool {
        self.old == self.new
    }

    /// The configuration with it.
    pub fn lay_over(&self, config: &Config) -> Config {
        Config { stages: self.new.clone(), ..config.clone() }
    }

    /// Says what changes, and what it means for the result.
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
        if let Some((before, after)) = self.learning_rates(config) {
            lines.push(format!(
                "the learning rate falls over the length of a stage: the next update takes {after:.3e} instead of \
                 {before:.3e}. What comes of it is not the run that would have had this budget from its beginning"
            ));
        }
        lines
    }

    /// The learning rates of the next update under the old budget and under the new one, if they differ. The stage in
    /// progress must have been trained in: all of one that has not begun is under the new budget.
    fn learning_rates(&self, config: &Config) -> Option<(f64, f64)> {
        let position = position_at(&self.new, self.trained)?;
        let old = &self.old[position.stage];
        if position.frames_in_stage == 0 || old.frames == self.new[position.stage].frames {
            return None;
        }
        let rate = |stage: &StageConfig| {
            let ppo = &config.ppo;
            let progress = learning_rate_progress(position.frames_in_stage, stage.frames, ppo.learning_rate_frames);
            falling(ppo.learning_rate, ppo.learning_rate_end, progress)
        };
        let (before, after) = (rate(old), rate(&self.new[position.stage]));
        (before != after).then_some((before, after))
    }

    /// Makes it the run's, durably.
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
        write_atomically(&folder.config(), self.lay_over(config).to_toml().as_bytes())
            .with_context(|| format!("cannot write {}", folder.config().display()))?;
        fault::reach("resume.after_budget");
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::means::tests::stages;

    /// Of 1000 and 500 frames.
    fn configured() -> Config {
        Config { stages: stages(), ..Config::default() }
    }

    #[test]
    fn the_summary_goes_and_the_configuration_is_replaced() {
        let temporary = tempfile::tempdir().unwrap();
        let (folder, config) = (RunFolder::new(temporary.path()), configured());
        std::fs::write(folder.config(), config.to_toml()).unwrap();
        std::fs::write(folder.summary(), "{}").unwrap();
        let budget = Budget::of(&config, 1500, 2500).unwrap();
        assert!(!budget.is_old() && Budget::of(&config, 1500, 1500).unwrap().is_old());
        budget.write(&folder, &config).unwrap();
        assert!(!folder.summary().exists());
        let written = Config::of_run(&folder).unwrap();
        assert_eq!(written, budget.lay_over(&config));
        let frames: Vec<u64> = written.stages.iter().map(|stage| stage.frames).collect();
        assert_eq!(frames, [1000, 1500]);
        // A run that is not complete has no summary.
        Budget::of(&written, 1500, 3000).unwrap().write(&folder, &written).unwrap();
        assert_eq!(total_frames(&Config::of_run(&folder).unwrap().stages), 3000);
        let refused = Budget::of(&written, 1500, 1499).unwrap_err().to_string();
        assert!(refused.contains("--frames 1499: the run has trained 1500 frames already"), "{refused}");
    }

    #[test]
    fn what_it_means_is_said() {
        let lines_of = |trained, total, learning_rate_frames| {
            let mut config = configured();
            config.ppo.learning_rate_frames = learning_rate_frames;
            Budget::of(&config, trained, total).unwrap().lines(&config)
        };
        // The rate falls over each stage.
        let lines = |trained, total| lines_of(trained, total, 0);
        let longer = lines(1500, 2500);
        assert_eq!(longer[0], "the budget is 2 500 frames instead of 1 500 (stage II: 1 500 instead of 500)");
        // A third of the way instead of at the end: 3e-4 · (1 - 2/3 · 1/3) instead of 3e-4 / 3.
        assert!(longer[1].contains("takes 2.333e-4 instead of 1.000e-4"), "{longer:?}");
        assert_eq!(lines(0, 3000).len(), 1, "nothing is trained yet");
        assert_eq!(lines(1000, 3000).len(), 1, "stage II has not begun");
        assert_eq!(lines(500, 3000).len(), 2);
        assert_eq!(lines(1200, 1200).len(), 1, "there is no next update");
        assert_eq!(lines_of(1500, 2500, 30_000_000).len(), 1, "a rate that falls over so many frames of any stage");
        let mut config = configured();
        config.ppo.learning_rate_frames = 0;
        config.ppo.learning_rate_end = 1.0;
        assert_eq!(Budget::of(&config, 1500, 2500).unwrap().lines(&config).len(), 1, "a rate that does not fall");
    }
}
