//! Progress of an evaluation: from its events while it runs, or from its folder alone.

use super::journal;
use crate::run::damaged::damaged;
use crate::showing::format;
use anyhow::{Context, Result};
use proto::bounded::RESULT_BYTES_MOST;
use proto::config::Config;
use proto::evaluation::{EpisodeRecord, Evaluation, Figures, RESULT_FILE};
use proto::run_folder::RunFolder;
use proto::task::Spec;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Episodes of how many, and what they came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Standing {
    /// Episodes to play.
    pub asked: u64,
    /// Episodes played.
    pub played: u64,
    /// SR so far, 0..1; none before the first episode.
    pub success: Option<f64>,
    /// `SRwoD` so far, 0..1.
    pub success_without_disturbance: Option<f64>,
    /// `SRwoD` by the largest displacement on an axis so far, 0..1.
    pub success_without_disturbance_per_axis: Option<f64>,
    /// The result file, once it is there.
    pub result: Option<PathBuf>,
}

impl Standing {
    /// Of an evaluation of `asked` episodes that has these records.
    pub fn of<'a>(asked: u64, records: impl Iterator<Item = &'a EpisodeRecord>) -> Self {
        Self::at(asked, &Figures::of(records))
    }

    fn at(asked: u64, figures: &Figures) -> Self {
        Self {
            asked,
            played: figures.episodes,
            success: figures.success,
            success_without_disturbance: figures.success_without_disturbance,
            success_without_disturbance_per_axis: figures.success_without_disturbance_per_axis,
            result: None,
        }
    }

    /// Reads it from the folder; none for a run that trains.
    pub fn read(folder: &RunFolder, config: &Config) -> Result<Option<Self>> {
        let Some(plan) = config.evaluation_plan() else { return Ok(None) };
        let asked = plan.len() as u64;
        let path = folder.root().join(RESULT_FILE);
        match folder.reader(&path, RESULT_BYTES_MOST) {
            Ok(file) => {
                let evaluation: Evaluation = serde_json::from_reader(file)
                    .with_context(|| damaged(&path, "delete its folder, and evaluate again"))?;
                Ok(Some(Self { result: Some(path), ..Self::at(asked, &evaluation.overall) }))
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                Ok(Some(Self::of(asked, journal::read(folder)?.iter())))
            }
            Err(error) => Err(error).with_context(|| path.display().to_string()),
        }
    }

    /// Means of the task's metrics so far, by name; without those that are not known.
    pub fn figures(&self, task: &Spec) -> BTreeMap<String, f64> {
        let own = serde_json::to_value(self).unwrap_or_default();
        task.metrics.iter().filter_map(|metric| Some((metric.name.clone(), own[&metric.name].as_f64()?))).collect()
    }

    /// As people read it, in parts.
    pub fn parts(&self) -> Vec<String> {
        let mut parts = vec![format!(
            "{} / {} episodes  {:.1}%",
            format::count(self.played),
            format::count(self.asked),
            100.0 * self.played as f64 / self.asked.max(1) as f64
        )];
        if self.played > 0 {
            parts.push(format!(
                "SR {}  SRwoD {} (per axis {})",
                format::percent(self.success),
                format::percent(self.success_without_disturbance),
                format::percent(self.success_without_disturbance_per_axis)
            ));
        }
        parts
    }
}
