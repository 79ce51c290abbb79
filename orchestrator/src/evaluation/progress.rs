use super::journal;
use crate::output::format::{self, shown};
use crate::output::table::fitting;
use crate::training::progress::BETWEEN;
use crate::training::scores::read_result;
use anyhow::Result;
use proto::config::Config;
use proto::evaluation::{EpisodeRecord, Figures, RESULT_FILE};
use proto::run_folder::RunFolder;
use proto::task::{Described, Spec};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{Error, ErrorKind};
use std::path::PathBuf;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Progress {
    pub asked: u64,
    pub played: u64,
    #[serde(flatten)]
    pub means: BTreeMap<String, Option<f64>>,
    #[serde(skip)]
    described: Vec<Described>,
    pub result: Option<PathBuf>,
}

impl Progress {
    pub fn of<'a>(spec: &Spec, asked: u64, records: impl Iterator<Item = &'a EpisodeRecord>) -> Self {
        Self::at(spec, asked, &Figures::of(spec, records))
    }

    fn at(spec: &Spec, asked: u64, figures: &Figures) -> Self {
        let described: Vec<Described> = spec.columns().into_iter().filter(|one| !one.label.is_empty()).collect();
        let means = described.iter().map(|one| (one.name.clone(), figures.get(&one.name))).collect();
        Self { asked, played: figures.episodes, means, described, result: None }
    }

    pub fn read(folder: &RunFolder, config: &Config) -> Result<Option<Self>> {
        let Some(plan) = config.evaluation_plan() else { return Ok(None) };
        let asked = plan.len() as u64;
        let is_missing = |error: &anyhow::Error| {
            error.root_cause().downcast_ref::<Error>().is_some_and(|cause| cause.kind() == ErrorKind::NotFound)
        };
        match read_result(folder) {
            Ok(evaluation) => {
                let result = Some(folder.root().join(RESULT_FILE));
                Ok(Some(Self { result, ..Self::at(config.spec(), asked, &evaluation.overall) }))
            }
            Err(error) if is_missing(&error) => Ok(Some(Self::of(config.spec(), asked, journal::read(folder)?.iter()))),
            Err(error) => Err(error),
        }
    }

    pub fn known(&self) -> BTreeMap<String, f64> {
        self.means.iter().filter_map(|(name, mean)| Some((name.clone(), (*mean)?))).collect()
    }

    /// How far it is, the time left or what it waits for, and the first metrics; as much as fits so many columns.
    pub fn line(&self, left: Option<String>, columns: Option<usize>) -> String {
        let (played, asked) = (format::count(self.played), format::counted(self.asked, "episode"));
        let percent = 100.0 * self.played as f64 / self.asked.max(1) as f64;
        let done = [Some(format!("{played} / {asked}  {percent:.1}%")), left];
        // More would not fit the line.
        let first = self.described.iter().take(if self.played > 0 { 3 } else { 0 });
        let figures = first.map(|one| format!("{} {}", one.label, shown(one, self.means[&one.name])));
        if let Some(columns) = columns {
            return fitting(done.into_iter().flatten().chain(figures), columns);
        }
        let figures = Some(figures.collect::<Vec<_>>().join("  ")).filter(|figures| !figures.is_empty());
        done.into_iter().chain([figures]).flatten().collect::<Vec<_>>().join(BETWEEN)
    }
}
