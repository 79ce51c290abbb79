use super::overrides::{Overrides, default_preset};
use crate::output::name::as_called;
use crate::output::table::beside;
use crate::output::{format, terminal};
use crate::preflight::all::check_all;
use crate::preflight::programs::Tools;
use crate::preflight::{Finding, programs, temporary};
use crate::run::create::check_free;
use crate::run::remains::survey;
use crate::run::scenes;
use crate::supervisor::session::shape;
use crate::wrong::is_wrong;
use anyhow::Result;
use proto::device::Torch;
use proto::run_folder::RunFolder;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Check everything that `up` would check, and show what is found
///
/// The exit status is not 0 if something would keep `up` from running.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator doctor
  orchestrator doctor --preset recipe --actors 38 --run /data/runs/a
  orchestrator doctor --json \\
    | jq -r '.checks[] | select(.status != \"ok\") | .text'")]
pub struct DoctorArgs {
    /// Preset to check for [default: the one that `up` would take]
    #[arg(long, value_name = "P")]
    preset: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
    /// Run folder to check for [default: a new one in runs]
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Print one JSON object: `good`, and `checks` with `name`, `status` (ok, warning, problem) and `text`
    #[arg(long)]
    json: bool,
}

impl DoctorArgs {
    pub fn of(preset: &str, overrides: Overrides) -> Self {
        Self { preset: Some(preset.to_owned()), overrides, run: None, json: false }
    }
}

pub fn run(args: &DoctorArgs) -> Result<ExitCode> {
    let mut table = Table { json: args.json, rows: Vec::new() };
    let [learner, actor] = ["learner", "actor"].map(|program| {
        let found = programs::find(program);
        table.row(program, finding(found.as_ref().map(|path| path.display().to_string())));
        found.ok()
    });
    let tools = Tools::find();
    let torch = match &tools {
        Ok(tools) => Some(tools.torch.clone()),
        Err(error) => {
            if learner.is_some() && actor.is_some() {
                table.row("libtorch", Finding::Problem(format!("{error:#}")));
            }
            None
        }
    };
    if let Some(torch) = &torch {
        let Torch { version, library, devices, arithmetic, .. } = torch;
        let text = format!("{version} from {library}, {arithmetic} on the CPU");
        table.row("libtorch", Finding::Good(text));
        table.row("devices", Finding::Good(devices.join(", ")));
    }
    let default = || Ok(torch.as_ref().map_or("demo", default_preset));
    let preset = args.overrides.preset(args.preset.as_deref(), default)?;
    let mut code = ExitCode::FAILURE;
    match args.overrides.resolve(&preset) {
        Err(error) => {
            code = if is_wrong(&error) { ExitCode::from(2) } else { code };
            table.row("configuration", Finding::Problem(format!("{error:#}")));
        }
        Ok(config) => {
            let frames = format::count(proto::stage::total_frames(&config.stages));
            let shape = format!("preset {}: {}, {frames} frames", config.preset, shape(&config));
            table.row("configuration", Finding::Good(shape));
            if let Some(found) = actor.and_then(|actor| scenes::finding(&config, &actor)) {
                table.row("scenes", found);
            }
            let folder = args.run.as_deref().unwrap_or(Path::new("runs"));
            for (name, found) in check_all(&config, folder, torch.as_ref()) {
                table.row(name, found);
            }
        }
    }
    if let Some(run) = &args.run {
        let free = check_free(&RunFolder::new(run)).map(|()| format!("{} is free", run.display()));
        table.row("run folder", finding(free.as_ref().map(String::clone)));
    }
    if !matches!(temporary::check(), Finding::Problem(_)) {
        table.row("remains", remains()?);
    }
    table.end()?;
    Ok(if table.is_good() { ExitCode::SUCCESS } else { code })
}

fn remains() -> Result<Finding> {
    let dead: Vec<_> = survey()?.into_iter().filter(|remains| !remains.alive).collect();
    if dead.is_empty() {
        return Ok(Finding::Good("none of dead runs".to_owned()));
    }
    let bytes = format::bytes(dead.iter().map(|remains| remains.bytes).sum());
    let runs = format::counted(dead.len() as u64, "dead run");
    Ok(Finding::Warning(format!("{bytes} in /dev/shm from {runs}; `orchestrator clean` frees it")))
}

fn finding(result: std::result::Result<String, &anyhow::Error>) -> Finding {
    result.map_or_else(|error| Finding::Problem(format!("{error:#}")), Finding::Good)
}

/// What is found, printed as it is found, or as JSON at the end.
struct Table {
    json: bool,
    rows: Vec<Row>,
}

#[derive(Debug, PartialEq, Eq, Serialize)]
struct Row {
    name: String,
    status: Status,
    text: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Status {
    Ok,
    Warning,
    Problem,
}

impl Table {
    fn row(&mut self, name: &str, finding: Finding) {
        let (status, mark, text) = match finding {
            Finding::Good(text) => (Status::Ok, "ok", text),
            Finding::Warning(text) => (Status::Warning, "warning", text),
            Finding::Problem(text) => (Status::Problem, "PROBLEM", text),
        };
        if !self.json {
            let head = format!("{name:14} {mark:8} ");
            for line in beside(&head, &as_called(&text), terminal::width()) {
                terminal::out(&line);
            }
        }
        self.rows.push(Row { name: name.to_owned(), status, text });
    }

    fn is_good(&self) -> bool {
        self.rows.iter().all(|row| row.status != Status::Problem)
    }

    fn end(&self) -> serde_json::Result<()> {
        if self.json { terminal::out_json(&self.to_json()) } else { Ok(()) }
    }

    fn to_json(&self) -> serde_json::Value {
        serde_json::json!({ "good": self.is_good(), "checks": self.rows })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_problem_is_one_in_json_too() {
        let mut table = Table { json: true, rows: Vec::new() };
        table.row("processor", Finding::Good("AVX2".to_owned()));
        table.row("disk", Finding::Warning("little".to_owned()));
        assert!(table.is_good());
        table.row("libtorch", Finding::Problem("none".to_owned()));
        let expected = serde_json::json!({
            "good": false,
            "checks": [
                { "name": "processor", "status": "ok", "text": "AVX2" },
                { "name": "disk", "status": "warning", "text": "little" },
                { "name": "libtorch", "status": "problem", "text": "none" },
            ],
        });
        assert_eq!(table.to_json(), expected);
    }
}
