//! Runs beside each other: in what their configurations differ ([`settings`]), and what they came to ([`figures`]).

mod figures;
mod row;
mod settings;

use crate::run::identity::Identity;
use crate::showing::table::{aligned, cell};
use anyhow::{Result, ensure};
use proto::config::Config;
use proto::run_folder::RunFolder;
use row::Row;
use serde::Serialize;
use std::path::PathBuf;

/// Characters of a value in a table.
const CELL_MAX: usize = 34;

/// Runs beside each other.
#[derive(Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Their folders.
    pub runs: Vec<String>,
    /// The settings that are not the same in all.
    pub configuration: Vec<Row>,
    pub figures: Vec<Row>,
}

impl Comparison {
    /// Reads the folders of runs and evaluations.
    pub fn read(paths: &[PathBuf]) -> Result<Self> {
        let (mut configs, mut known) = (Vec::new(), Vec::new());
        for (number, path) in paths.iter().enumerate() {
            ensure!(!paths[..number].contains(path), "{} is given twice", path.display());
            let folder = RunFolder::new(path);
            let identity = Identity::read(&folder)?;
            let config = Config::of_run(&folder)?;
            known.push(figures::of(&folder, &config, &identity)?);
            configs.push(config);
        }
        Ok(Self {
            runs: paths.iter().map(|path| path.display().to_string()).collect(),
            configuration: settings::differences(&configs),
            figures: figures::rows(&known),
        })
    }

    /// As people read it: a column a run.
    pub fn lines(&self) -> Vec<String> {
        let head = |title: &str| std::iter::once(title.to_owned()).chain(self.runs.iter().cloned()).collect::<Vec<_>>();
        let row = |row: &Row| {
            let cells = row.shown.iter().map(|text| cell(text, CELL_MAX));
            std::iter::once(format!("  {}", row.name)).chain(cells).collect::<Vec<_>>()
        };
        let mut rows = vec![head("configuration")];
        rows.extend(self.configuration.iter().map(row));
        rows.push(vec!["figures".to_owned()]);
        rows.extend(self.figures.iter().map(row));
        let mut lines = aligned(&rows);
        if self.configuration.is_empty() {
            lines.insert(1, "  the same in all".to_owned());
        }
        lines
    }
}
