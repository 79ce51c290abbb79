use crate::comparison::Comparison;
use crate::output::terminal;
use crate::run::identity::perhaps;
use crate::suite;
use crate::wrong::demand;
use anyhow::Result;
use std::path::PathBuf;

/// Show in what runs or evaluations differ, and what they came to, a column each
///
/// Settings that are the same in all are left out. Figures of a stage are of its last tenth, those of a stage that has
/// not got there of all of it. Of evaluations under the same conditions the newest counts. Runs that differ in the seed
/// alone have a column more, with the means of their figures; folders of one evaluation each stand side by side. It says nothing about whether a difference is one:
/// `orchestrator report` has intervals over seeds.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator compare runs/a runs/b
  orchestrator compare runs/a/evaluations/* | less -S
  # the runs of a suite
  orchestrator compare runs/table-1
  orchestrator compare runs/* --json \\
    | jq '.configuration[] | {(.name): .values}'")]
pub struct CompareArgs {
    /// Folders of runs or evaluations, at least two, or of a suite for all of its runs
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Print one JSON object: `runs`, and `configuration` and `figures` as arrays of objects with `name` and `values`; means of
    /// seeds are further values
    #[arg(long)]
    json: bool,
}

pub fn run(args: &CompareArgs) -> Result<()> {
    let mut runs = Vec::new();
    for run in &args.runs {
        demand!(run.exists(), "{} does not exist{}", run.display(), perhaps(run));
        runs.extend(if suite::is_suite(run) { suite::begun(run)? } else { vec![run.clone()] });
    }
    demand!(runs.len() > 1, "there is nothing to compare {} with: give two runs or more", args.runs[0].display());
    let comparison = Comparison::read(&runs)?;
    if args.json {
        terminal::out_json(&comparison)?;
        return Ok(());
    }
    for line in comparison.lines() {
        terminal::out_wrapped(&line);
    }
    Ok(())
}
