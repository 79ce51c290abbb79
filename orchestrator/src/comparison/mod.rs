mod figures;
pub mod settings;

use crate::output::table::{cell, fitted};
use crate::output::terminal;
use crate::run::identity::Identity;
use anyhow::{Result, ensure};
use figures::Figure;
use proto::config::Config;
use proto::run_folder::RunFolder;
use serde::Serialize;
use settings::Row;
use std::path::PathBuf;

const CELL_MAX: usize = 34;

fn column(folder: &RunFolder) -> Result<(Config, Vec<Figure>)> {
    let identity = Identity::read(folder)?;
    let config = Config::of_run(folder)?;
    let figures = figures::of(folder, &config, &identity)?;
    Ok((config, figures))
}

#[derive(Debug, PartialEq, Serialize)]
pub struct Comparison {
    pub runs: Vec<String>,
    pub configuration: Vec<Row>,
    pub figures: Vec<Row>,
}

impl Comparison {
    /// Reads the folders of runs and evaluations. One that cannot be read is named and left out, as long as there are two
    /// others.
    pub fn read(paths: &[PathBuf]) -> Result<Self> {
        let (mut runs, mut configs, mut known) = (Vec::new(), Vec::new(), Vec::new());
        let mut problems = Vec::new();
        for (number, path) in paths.iter().enumerate() {
            ensure!(!paths[..number].contains(path), "{} is given twice", path.display());
            match column(&RunFolder::new(path)) {
                Ok((config, figures)) => {
                    runs.push(path.display().to_string());
                    configs.push(config);
                    known.push(figures);
                }
                Err(error) => problems.push((path, error)),
            }
        }
        if runs.len() < 2 && !problems.is_empty() {
            return Err(problems.swap_remove(0).1);
        }
        for (path, error) in problems {
            terminal::note(&format!("{} is left out: {error:#}", path.display()));
        }
        Ok(Self { runs, configuration: settings::differences(&configs), figures: figures::rows(&known) })
    }

    pub fn lines(&self) -> Vec<String> {
        let head = |title: &str| std::iter::once(title.to_owned()).chain(self.runs.iter().cloned()).collect::<Vec<_>>();
        let row = |row: &Row| {
            let cells = row.shown.iter().map(|text| cell(text, CELL_MAX));
            std::iter::once(format!("  {}", row.name)).chain(cells).collect::<Vec<_>>()
        };
        let mut rows = vec![head("configuration")];
        if self.configuration.is_empty() {
            rows.push(vec!["  the same in all".to_owned()]);
        }
        rows.extend(self.configuration.iter().map(row));
        rows.push(vec!["figures".to_owned()]);
        rows.extend(self.figures.iter().map(row));
        fitted(&rows, terminal::width())
    }
}
