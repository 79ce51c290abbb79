//! An evaluation, disturbed: its table and its figures are those of an undisturbed one. One whose orchestrator dies is
//! made again, in another folder.

use crate::case_folder::CaseFolder;
use crate::fault::Case;
use crate::inject::start_until_done;
use crate::privileges::Privileges;
use crate::tally::Tally;
use anyhow::Result;
use proto::evaluation::{RESULT_FILE, TABLE_FILE};
use serde_json::Value;
use std::path::Path;
use system_tests::evidence::{first_difference, result};

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
    let words = "eval --preset demo --config config.toml --seed 5 --split test --objects novel --episodes 2 --out";
    let command = |start| (place.path(&format!("evaluation-{start}")), words);
    let (folder, starts) = start_until_done(case, place, privileges, tally, command, RESULT_FILE)?;
    read(&folder, starts)
}

fn read(folder: &Path, starts: usize) -> Result<Evaluated> {
    let table = std::fs::read_to_string(folder.join(TABLE_FILE))?;
    Ok(Evaluated { table, result: result(&folder.join(RESULT_FILE))?, starts })
}
