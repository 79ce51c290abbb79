//! `orchestrator doctor`: everything that `up` would check, all of it, as a table.

use super::overrides::{Overrides, default_preset};
use crate::preflight::{Finding, device, disk, libtorch, memory, processor, programs, shared_memory};
use crate::remains::survey;
use crate::terminal;
use crate::{format, scenes, session};
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;

/// Check everything that `up` would check, and show what is found
///
/// The exit status is 1 if something would keep `up` from running.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator doctor
  orchestrator doctor --preset two-stage --actors 38 --run /data/runs/a")]
pub struct DoctorArgs {
    /// Preset to check for [default: the one that `up` would take]
    #[arg(long, value_name = "P")]
    preset: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
    /// Run folder to check for
    #[arg(long, value_name = "DIR", default_value = "runs")]
    run: PathBuf,
}

/// Runs the command.
pub fn run(args: &DoctorArgs) -> Result<ExitCode> {
    let mut table = Table::default();
    table.row("processor", processor::check());
    let [learner, actor] = ["learner", "actor"].map(|program| {
        let found = programs::find(program);
        table.row(program, finding(found.as_ref().map(|path| path.display().to_string())));
        found.ok()
    });
    let tools = session::Tools::find();
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
        let libtorch::Torch { version, library, devices, arithmetic } = torch;
        let text = format!("{version} from {library}, {arithmetic} on the CPU");
        table.row("libtorch", Finding::Good(text));
        table.row("devices", Finding::Good(devices.join(", ")));
    }
    let default = || Ok(torch.as_ref().map_or("demo", default_preset));
    let preset = args.overrides.preset(args.preset.as_deref(), default)?;
    match args.overrides.resolve(&preset) {
        Err(error) => table.row("configuration", Finding::Problem(format!("{error:#}"))),
        Ok(config) => {
            let frames = format::count(proto::stage::total_frames(&config.stages));
            let shape = format!("preset {}: {}, {frames} frames", config.preset, session::shape(&config));
            table.row("configuration", Finding::Good(shape));
            if let Some(found) = actor.and_then(|actor| scenes::finding(&config, &actor)) {
                table.row("scenes", found);
            }
            if let Some(torch) = &torch {
                table.row("learners", device::check(&config, torch));
            }
            let on_gpu = torch.as_ref().is_some_and(|torch| device::is_cuda(&config, torch));
            match memory::available() {
                Ok(available) => table.row("memory", memory::check(&config, on_gpu, available)),
                Err(error) => table.row("memory", Finding::Warning(error.to_string())),
            }
            table.row("shared memory", shared_memory::check(&config));
            table.row("disk", disk::check(&config, &args.run));
        }
    }
    let dead: Vec<_> = survey()?.into_iter().filter(|remains| !remains.alive).collect();
    if dead.is_empty() {
        table.row("remains", Finding::Good("none of dead runs".to_owned()));
    } else {
        let bytes = format::bytes(dead.iter().map(|remains| remains.bytes).sum());
        let runs = format::counted(dead.len() as u64, "dead run");
        let text = format!("{bytes} in /dev/shm from {runs}; `orchestrator clean` frees it");
        table.row("remains", Finding::Warning(text));
    }
    Ok(if table.problems == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn finding(result: std::result::Result<String, &anyhow::Error>) -> Finding {
    result.map_or_else(|error| Finding::Problem(format!("{error:#}")), Finding::Good)
}

#[derive(Debug, Default)]
struct Table {
    problems: usize,
}

impl Table {
    fn row(&mut self, name: &str, finding: Finding) {
        let (mark, text) = match finding {
            Finding::Good(text) => ("ok", text),
            Finding::Warning(text) => ("warning", text),
            Finding::Problem(text) => {
                self.problems += 1;
                ("PROBLEM", text)
            }
        };
        terminal::out(&format!("{name:14} {mark:8} {text}"));
    }
}
