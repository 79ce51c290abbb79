use super::stop::Log;
use crate::output::format::{self, counted};
use crate::output::terminal;
use crate::run::identity::{Identity, host_name, is_evaluation};
use crate::run::lock::{Holder, LockState, holder};
use crate::run::scale::{ScaleRequest, with_actors};
use crate::suite;
use crate::training::summary::Summary;
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::run_folder::RunFolder;
use proto::shell::quoted;
use std::path::PathBuf;
use std::time::{Duration, Instant};

const LOOK: Duration = Duration::from_millis(50);

/// Give a run that goes on another number of actors
///
/// At the end of a rollout the run is saved, its processes end in order and start again in the new number, all within the
/// same orchestrators; several hosts divide the new number as they did the old one. Waits until the run goes on.
///
/// Environments keep what they are. Those of the actors that remain go on where they were. Those of actors that are no more
/// rest as they are, in every checkpoint, until such an actor is there again. New ones begin their first episode. The
/// frames of the run and of its stages stay exact, and what a rollout has of each environment, too; so a rollout has more
/// or fewer frames. `orchestrator status RUN` says at which rollouts the number changed: the same seed with the same
/// changes at the same rollouts gives the same weights.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator scale runs/first --actors 8
  # the first rollout with 8 is number 120
  orchestrator scale runs/first --actors 8 --at-rollout 120

A run that does not go on at present: `orchestrator resume RUN --actors N`.")]
pub struct ScaleArgs {
    /// Run folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Actors of the whole run; every learner needs one at least
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=512))]
    actors: u32,
    /// The first rollout with that number, counted from 0 [default: the next that has not begun]
    #[arg(long, value_name = "K")]
    at_rollout: Option<u64>,
    /// Give up waiting after this many seconds; the run still does as asked
    #[arg(long, value_name = "SECONDS", default_value_t = 3600)]
    timeout: u64,
}

pub fn run(args: &ScaleArgs) -> Result<()> {
    let folder = RunFolder::new(&args.run);
    suite::refuse(folder.root())?;
    Identity::read(&folder)?;
    let root = folder.root().display().to_string();
    if is_evaluation(&folder) {
        bail!("{root} is an evaluation: its number of actors is that of its episodes' batches, and stays");
    }
    let actors = args.actors;
    let config = Config::of_run(&folder)?;
    // What cannot be is said at once.
    with_actors(&config, actors)?;
    let asked = signed(&folder, actors)?;
    if config.actors.count == actors && args.at_rollout.is_none() {
        terminal::note(&format!("{root} has {} already", counted(u64::from(actors), "actor")));
        return Ok(());
    }
    let mut log = Log::at_end(&folder);
    let request = ScaleRequest { incarnation: asked.incarnation, actors, at_rollout: args.at_rollout, refused: None };
    request.write(&folder)?;
    let begin = Instant::now();
    loop {
        log.show();
        if let Some(reason) = ScaleRequest::read(&folder)?.and_then(|found| found.answers(&request)) {
            ScaleRequest::remove(&folder);
            bail!("{root} keeps its number of actors: {reason}");
        }
        let held = holder(&folder)?;
        match &held {
            LockState::By(now) if now.incarnation > asked.incarnation => {
                return done(&folder, now.incarnation, &request);
            }
            LockState::Free => bail!("{root} has ended before its number of actors changed"),
            LockState::By(_) | LockState::Unsigned => {}
        }
        if begin.elapsed() > Duration::from_secs(args.timeout) {
            bail!("{root} has not changed within {} s; it still may", args.timeout);
        }
        // A file that is gone, or a lock that is signed anew, wakes nobody.
        std::thread::sleep(LOOK);
    }
}

fn signed(folder: &RunFolder, actors: u32) -> Result<Holder> {
    let root = folder.root().display();
    let begin = Instant::now();
    loop {
        match holder(folder)? {
            LockState::By(holder) if holder.host != host_name() => {
                bail!("{root} is run on {}: scale it there", holder.host)
            }
            LockState::By(holder) => return Ok(holder),
            LockState::Free => {
                let run = quoted(folder.root());
                if Summary::read(folder)?.is_some() {
                    bail!(
                        "{root} is complete: `orchestrator resume {run} --actors {actors} --frames F` goes on with that \
                         number, up to F frames in all"
                    );
                }
                bail!("{root} does not run: `orchestrator resume {run} --actors {actors}` goes on with that number")
            }
            LockState::Unsigned if begin.elapsed() > Duration::from_mins(1) => {
                bail!("{root} is about to start for a minute already: try again when it trains")
            }
            LockState::Unsigned => std::thread::sleep(LOOK),
        }
    }
}

fn done(folder: &RunFolder, incarnation: u32, request: &ScaleRequest) -> Result<()> {
    let &ScaleRequest { actors, at_rollout, .. } = request;
    let identity = Identity::read(folder)?;
    let start = identity.incarnations.iter().find(|start| start.number == incarnation);
    let shape = start.and_then(|start| start.shape).context("run.toml does not say how the run goes on")?;
    if shape.actors != actors {
        bail!("{} goes on with {} actors: its log says why", folder.root().display(), shape.actors);
    }
    if let Some(at) = at_rollout.filter(|at| *at != shape.rollout) {
        tracing::warn!("the first rollout with that number is {}, not {at}", shape.rollout);
    }
    terminal::out(&format!("run {} has {}", identity.id, counted(u64::from(actors), "actor")));
    terminal::out(&format!("from rollout: {} ({} frames)", shape.rollout, format::count(shape.frames)));
    Ok(())
}
