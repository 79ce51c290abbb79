//! A suite, disturbed: called until all is done, its weights and tables are those of an undisturbed one.

use crate::case_folder::CaseFolder;
use crate::fault::Case;
use crate::inject::start_until_done;
use crate::privileges::Privileges;
use crate::tally::Tally;
use anyhow::{Context, Result};
use proto::evaluation::{RESULT_FILE, TABLE_FILE};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use system_tests::evidence::{first_difference, result};

/// What is compared, by the name of the run.
#[derive(Debug)]
pub struct Done {
    runs: BTreeMap<String, (String, String, Value)>,
    pub calls: usize,
}

impl Done {
    /// What differs from an undisturbed one.
    pub fn differences(&self, reference: &Self) -> Vec<String> {
        let names = |done: &Self| done.runs.keys().cloned().collect::<Vec<_>>();
        if names(self) != names(reference) {
            return vec![format!("runs: {:?} instead of {:?}", names(self), names(reference))];
        }
        let mut found = vec![];
        for ((name, ours), theirs) in self.runs.iter().zip(reference.runs.values()) {
            if ours.0 != theirs.0 {
                found.push(format!("{name}: weights {} instead of {}", ours.0, theirs.0));
            }
            if ours.1 != theirs.1 {
                found.push(format!("{name}: the table of episodes"));
            }
            if ours.2 != theirs.2 {
                found.push(format!("{name}: {RESULT_FILE}: {}", first_difference("", &ours.2, &theirs.2)));
            }
        }
        found
    }
}

/// Calls the suite until all is done.
pub fn complete(case: &Case, place: &CaseFolder, privileges: Privileges, tally: &mut Tally) -> Result<Done> {
    std::fs::write(place.path("suite.toml"), case.shape.suite())?;
    let command = |_| (place.path("suite"), "suite suite.toml --out");
    let (folder, calls) = start_until_done(case, place, privileges, tally, command, "report/report.html")?;
    read(&folder, calls)
}

fn read(folder: &Path, calls: usize) -> Result<Done> {
    let mut runs = BTreeMap::new();
    for entry in std::fs::read_dir(folder.join("runs"))?.flatten() {
        let path = entry.path();
        let summary = std::fs::read_to_string(path.join("summary.json")).with_context(|| path.display().to_string())?;
        let summary: Value = serde_json::from_str(&summary)?;
        let weights = summary["weights"].as_str().context("a summary holds the weights' digest")?.to_owned();
        let evaluation = path.join("evaluations/suite-test-novel-1");
        let table =
            std::fs::read_to_string(evaluation.join(TABLE_FILE)).with_context(|| evaluation.display().to_string())?;
        let name = entry.file_name().to_string_lossy().into_owned();
        runs.insert(name, (weights, table, result(&evaluation.join(RESULT_FILE))?));
    }
    Ok(Done { runs, calls })
}
