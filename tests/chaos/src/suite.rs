//! A suite, disturbed: called until all is done, its weights and tables are those of an undisturbed one.

use crate::case_folder::{CaseFolder, Start};
use crate::fault::{Case, Fate, Fault, Phase};
use crate::inject::disturb_by_time;
use crate::judge::explain;
use crate::privileges::Privileges;
use crate::session::{Session, wait_for_end};
use crate::tally::Tally;
use anyhow::{Context, Result, bail};
use proto::evaluation::{RESULT_FILE, TABLE_FILE};
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use system_tests::evidence::{first_difference, result};

/// A suite that is not done after so many calls gets nowhere.
const CALLS_MAX: usize = 15;

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
    let folder = place.path("suite");
    let out = folder.display().to_string();
    let mut plan: VecDeque<_> = case.faults.iter().copied().collect();
    for calls in 1..=CALLS_MAX {
        let mut start = Start::default();
        let mut recent = vec![];
        let armed = plan.pop_front_if(|planned| planned.fault.phase() == Phase::Start).map(|planned| planned.fault);
        if let Some(fault) = armed {
            start.arm(fault);
        }
        let arguments = ["suite", "suite.toml", "--out", &out];
        let mut session = Session::start(place, format!("call-{calls:02}"), &arguments, &start)?;
        for (fault, fate) in disturb_by_time(&mut plan, &folder, place, privileges, &mut session)? {
            recent.extend(fault.in_force(fate));
            tally.add(fault, fate);
        }
        let ended = session.wait()?;
        if let Some(armed) = armed {
            // The deaths of its runs' processes are in the runs' own logs.
            let is_elsewhere = matches!(armed, Fault::Point(point, _) if point.program != "orchestrator");
            tally.add(armed, if is_elsewhere || ended.shows(armed) { Fate::Landed } else { Fate::Missed });
            recent.push(armed);
        }
        ended.ensure_no_panic()?;
        wait_for_end(&folder)?;
        if ended.status.success() && folder.join("report/report.html").exists() {
            plan.drain(..).for_each(|planned| tally.add(planned.fault, Fate::Missed));
            return read(&folder, calls);
        }
        // After a failure the next call tries again.
        explain(&ended, &recent).context("the suite is not done")?;
    }
    bail!("the suite is not done after {CALLS_MAX} calls")
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
