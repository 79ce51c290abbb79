//! How far a step of a suite is, and its figures, as a line has them.

use super::file::{Suite, SuiteEntry};
use super::folder::{Step, SuiteFolder};
use crate::evaluation::progress::Progress;
use crate::training::means::recent;
use crate::training::metrics::read_history;
use crate::training::progress::{BETWEEN, figures_line, frames_line, short_line};
use proto::config::Config;
use proto::run_folder::RunFolder;

/// As much as fits so many columns.
pub fn progress(
    suite: &Suite,
    folder: &SuiteFolder,
    entry: &SuiteEntry,
    step: &Step,
    columns: Option<usize>,
) -> String {
    let parts = match step {
        Step::Evaluate(number) => {
            let evaluation = &suite.evaluations[*number];
            let head = format!("evaluating ({})", evaluation.folder());
            let columns = columns.map(|columns| columns.saturating_sub((head.clone() + BETWEEN).chars().count()));
            let line = of_evaluation(folder, entry, evaluation).map(|progress| progress.line(None, columns));
            vec![head, line.unwrap_or_default()]
        }
        Step::Begin | Step::Resume => read_history(&folder.run(entry)).map_or_else(
            |_| vec!["training".to_owned()],
            |history| {
                let stages = &entry.config.stages;
                let (recent, shown) = (recent(stages, &history, false), entry.config.spec().shown());
                match columns {
                    Some(columns) => vec![short_line(&shown, stages, &recent, "", true, columns)],
                    None => vec![frames_line(stages, &recent), figures_line(&shown, &recent)],
                }
            },
        ),
    };
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(BETWEEN)
}

fn of_evaluation(folder: &SuiteFolder, entry: &SuiteEntry, asked: &super::Asked) -> Option<Progress> {
    let evaluation = RunFolder::new(folder.evaluation(entry, asked));
    Progress::read(&evaluation, &Config::of_run(&evaluation).ok()?).ok()?
}
