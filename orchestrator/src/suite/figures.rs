//! How far a step of a suite is, and its figures, as a line has them.

use super::file::{Suite, SuiteEntry};
use super::folder::{Step, SuiteFolder};
use crate::evaluation::progress::Progress;
use crate::output::format;
use crate::training::means::recent;
use crate::training::metrics::read_history;
use crate::training::progress::{BETWEEN, figures_line, frames_line};
use proto::config::Config;
use proto::run_folder::RunFolder;

/// Empty where nothing is known yet.
pub fn progress(suite: &Suite, folder: &SuiteFolder, entry: &SuiteEntry, step: &Step) -> String {
    let parts = match step {
        Step::Evaluate(number) => {
            let evaluation = &suite.evaluations[*number];
            let parts = of_evaluation(folder, entry, evaluation).map(|progress| progress.parts());
            [vec![format!("evaluating ({})", evaluation.folder())], parts.unwrap_or_default()].concat()
        }
        Step::Begin | Step::Resume => read_history(&folder.run(entry)).map_or_else(
            |_| vec!["training".to_owned()],
            |history| {
                let stages = &entry.config.stages;
                let recent = recent(stages, &history, false);
                vec![frames_line(stages, &recent), figures_line(&entry.config.spec().shown(), &recent)]
            },
        ),
    };
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(BETWEEN)
}

fn of_evaluation(folder: &SuiteFolder, entry: &SuiteEntry, asked: &super::Asked) -> Option<Progress> {
    let evaluation = RunFolder::new(folder.evaluation(entry, asked));
    Progress::read(&evaluation, &Config::of_run(&evaluation).ok()?).ok()?
}

/// A line for each evaluation that has a result; else one with the last figures of training.
pub fn results(suite: &Suite, folder: &SuiteFolder, entry: &SuiteEntry) -> Vec<[String; 2]> {
    let shown = entry.config.spec().shown();
    let of = |asked: &super::Asked| {
        let progress = of_evaluation(folder, entry, asked).filter(|progress| progress.result.is_some())?;
        Some([asked.folder(), format::metrics(&shown, &progress.known(), "  ")])
    };
    let mut results: Vec<_> = suite.evaluations.iter().filter_map(of).collect();
    if results.is_empty() {
        let trained = read_history(&folder.run(entry)).ok();
        let figures = trained.map(|history| figures_line(&shown, &recent(&entry.config.stages, &history, true)));
        let figures = figures.filter(|figures| !figures.is_empty());
        results.push(figures.map_or_else(Default::default, |figures| ["training".to_owned(), figures]));
    }
    results
}
