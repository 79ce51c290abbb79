//! `orchestrator status`: how a run stands, from its folder alone; works while it runs and after a crash.

use crate::figures::{Recent, StageFigures, by_stage, recent};
use crate::format;
use crate::identity::{Held, Identity, Incarnation, holder, state};
use crate::metrics::History;
use crate::progress::{figures_line, frames_line};
use crate::summary::{Summary, table};
use crate::terminal;
use anyhow::Result;
use proto::config::Config;
use proto::run_folder::RunFolder;
use serde::Serialize;
use std::path::PathBuf;

/// Show how a run stands
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator status runs/20261121-020423-demo-1
  orchestrator status --json RUN | jq .recent.frames_per_s")]
pub struct StatusArgs {
    /// Run folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Status {
    id: String,
    /// See [`state`].
    state: String,
    preset: String,
    seed: u64,
    incarnations: Vec<Incarnation>,
    recent: Recent,
    stages: Vec<StageFigures>,
    weights: Option<String>,
}

/// Runs the command.
pub fn run(args: &StatusArgs) -> Result<()> {
    let folder = RunFolder::new(&args.run);
    let identity = Identity::read(&folder)?;
    let config = Config::of_run(&folder)?;
    let held = holder(&folder)?;
    let history = History::read(&folder)?;
    let summary = Summary::read(&folder)?;
    let last = identity.incarnations.last();
    let state = state(&identity, &held, summary.is_some());
    let status = Status {
        id: identity.id.clone(),
        state,
        preset: config.preset.clone(),
        seed: config.seed,
        recent: recent(&config.stages, &history),
        stages: by_stage(&config.stages, &history),
        weights: summary.map(|summary| summary.weights),
        incarnations: identity.incarnations.clone(),
    };
    if args.json {
        terminal::out(&serde_json::to_string(&status)?);
        return Ok(());
    }
    let by = match &held {
        Held::By(holder) => format!(" (pid {} on {})", holder.pid, holder.host),
        Held::Free | Held::Unsigned => String::new(),
    };
    terminal::out(&format!("run {} {}{by}: preset {}, seed {}", status.id, status.state, status.preset, status.seed));
    if let Some(last) = last {
        terminal::out(&format!("start {} at {}", last.number, format::date(last.started_unix_s)));
        if let Some(reason) = last.ended.as_ref().and_then(|ended| ended.reason.as_ref()) {
            terminal::out(reason);
        }
    }
    terminal::out(&frames_line(&config.stages, &status.recent));
    let figures = figures_line(&status.recent);
    if !figures.is_empty() {
        terminal::out(&figures);
    }
    if !status.stages.is_empty() {
        for line in table(&status.stages) {
            terminal::out(&line);
        }
    }
    // An evaluation is not gone on with.
    if held == Held::Free && status.weights.is_none() && config.evaluation.is_none() {
        terminal::out(&format!("go on with: orchestrator resume {}", folder.root().display()));
    }
    Ok(())
}
