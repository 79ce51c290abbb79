//! An evaluation, disturbed: its table and its figures are those of an undisturbed one. One whose orchestrator dies is
//! made again, in another folder.

use crate::case_folder::{CaseFolder, Start};
use crate::fault::{Case, Fate, Phase};
use crate::inject::disturb_by_time;
use crate::judge::explain;
use crate::privileges::Privileges;
use crate::session::{Session, wait_for_end};
use crate::tally::Tally;
use anyhow::{Context, Result, bail};
use proto::evaluation::{RESULT_FILE, TABLE_FILE};
use serde_json::Value;
use std::collections::VecDeque;
use std::path::Path;
use system_tests::evidence::{first_difference, result};

/// One that has no result after so many starts gets nowhere.
const STARTS_MAX: usize = 12;

#[derive(Debug)]
pub struct Evaluated {
    table: String,
    result: Value,
    pub starts: usize,
}

impl Evaluated {
    /// What differs from an undisturbed one.
    pub fn differences(&self, reference: &Self) -> Vec<String> {
        let mut found = vec![];
        if self.table != reference.table {
            found.push("the table of episodes".to_owned());
        }
        if self.result != reference.result {
            found.push(format!("{RESULT_FILE}: {}", first_difference("", &self.result, &reference.result)));
        }
        found
    }
}

/// Evaluates until there is a result.
pub fn evaluate(case: &Case, place: &CaseFolder, privileges: Privileges, tally: &mut Tally) -> Result<Evaluated> {
    std::fs::write(place.path("config.toml"), case.shape.config())?;
    let mut plan: VecDeque<_> = case.faults.iter().copied().collect();
    for starts in 1..=STARTS_MAX {
        let folder = place.path(&format!("evaluation-{starts}"));
        let (mut start, mut recent, mut armed) = (Start::default(), vec![], None);
        if let Some(planned) = plan.pop_front_if(|planned| planned.fault.phase() == Phase::Start) {
            start.arm(planned.fault);
            armed = Some(planned.fault);
            recent.push(planned.fault);
        }
        let out = folder.display().to_string();
        let words = "eval --preset demo --config config.toml --seed 5 --split test --objects novel --episodes 2 --out";
        let arguments: Vec<&str> = words.split(' ').chain([out.as_str()]).collect();
        let mut session = Session::start(place, format!("start-{starts:02}"), &arguments, &start)?;
        for (fault, fate) in disturb_by_time(&mut plan, &folder, place, privileges, &mut session)? {
            recent.extend(fault.in_force(fate));
            tally.add(fault, fate);
        }
        let ended = session.wait()?;
        if let Some(armed) = armed {
            tally.add(armed, if ended.shows(armed) { Fate::Landed } else { Fate::Missed });
        }
        ended.ensure_no_panic()?;
        wait_for_end(&folder)?;
        if ended.status.success() && folder.join(RESULT_FILE).exists() {
            plan.drain(..).for_each(|planned| tally.add(planned.fault, Fate::Missed));
            return read(&folder, starts);
        }
        explain(&ended, &recent).context("there is no result")?;
    }
    bail!("there is no result after {STARTS_MAX} starts")
}

fn read(folder: &Path, starts: usize) -> Result<Evaluated> {
    let table = std::fs::read_to_string(folder.join(TABLE_FILE))?;
    Ok(Evaluated { table, result: result(&folder.join(RESULT_FILE))?, starts })
}
