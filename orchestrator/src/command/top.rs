use crate::suite::is_suite;
use crate::tui::session::show;
use crate::viewer::RunReaders;
use anyhow::{Context, Result, bail, ensure};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

/// Show a run in this terminal, live: curves, progress, processes, warnings
///
/// It only reads the run folder, so it can be started and left at any time, from any terminal, as often as you like; the
/// run neither waits for it nor ends with it. q, Esc or Ctrl-C leave, Tab changes the chart where there is room for one,
/// w shows warnings only, then kitchens, the arrow keys scroll processes and kitchens.
/// `restarts` are of a process since the newest start of the run, `starts` over all of them.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator top runs/20261121-020423-demo-1
  # the newest run below runs/
  orchestrator top
  # one on another machine
  ssh -t HOST orchestrator top /data/runs/a")]
pub struct TopArgs {
    /// Run folder, or that of an evaluation, or of a suite: its run at work [default: the newest below runs/]
    #[arg(value_name = "RUN")]
    run: Option<PathBuf>,
}

/// Whatever trains on the machine comes first.
const NICENESS: i32 = 10;

pub fn run(args: &TopArgs) -> Result<()> {
    let suite = args.run.as_deref().filter(|folder| is_suite(folder));
    let (readers, run) = match &args.run {
        Some(folder) if suite.is_some() => newest(folder, true)?,
        Some(folder) => {
            // Refuses what is no run, with the reason.
            crate::run::identity::Identity::read(&proto::run_folder::RunFolder::new(folder))?;
            let readers = RunReaders::of(vec![folder.clone()]);
            let name = readers.names_of(std::slice::from_ref(folder)).pop();
            let name = name.with_context(|| format!("{} is not the folder of a run", folder.display()))?;
            (readers, name)
        }
        None => newest(Path::new("runs"), false)?,
    };
    ensure!(
        std::io::stdout().is_terminal(),
        "top needs a terminal: `orchestrator status RUN` prints how a run stands, with --json for scripts"
    );
    if std::env::var_os("TERM").is_none_or(|term| term.is_empty() || term == "dumb") {
        bail!(
            "top moves a cursor, which this terminal cannot (TERM is dumb or not set): use `orchestrator status RUN`"
        );
    }
    // Where it is refused it is as important as others.
    let _ = rustix::process::setpriority_process(None, NICENESS);
    show(readers, run, suite.map(Path::to_owned))
}

fn newest(folder: &Path, suite: bool) -> Result<(RunReaders, String)> {
    ensure!(folder.is_dir(), "no run yet: `orchestrator up` starts one; or give the folder of a run");
    let readers = RunReaders::of(vec![folder.to_path_buf()]);
    let newest = readers.newest_run(suite);
    let newest =
        newest.with_context(|| format!("there is no run below {}/: give the folder of one", folder.display()))?;
    Ok((readers, newest.id))
}
