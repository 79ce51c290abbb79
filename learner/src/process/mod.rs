//! The learner as a process: command line, lock, lifeline, shared memory, events, exit status.
//!
//! [`training`] and [`evaluation`] are loops over a [`conversation`]. They keep the order of things and the deadlines.
//! What a message means is decided by pure state machines: the collector ([`crate::collector`]) and [`announcements`].

mod announcements;
mod changed;
mod check;
mod control;
mod conversation;
mod evaluation;
mod failure;
mod import;
mod link;
mod lock;
mod machine;
mod ringers;
mod stop;
mod training;
mod weights;

pub use check::check;
pub use evaluation::{EvaluationArguments, evaluate};
pub use failure::{is_non_finite, is_of_peers, is_unsaved};
pub use import::{ImportArguments, import};

use crate::agent::Agent;
use crate::checkpoint::Store;
use crate::collector::Boundary;
use crate::device;
use crate::peers::Peers;
use anyhow::{Context, Result, bail, ensure};
use conversation::{Conversation, Speaker};
use link::Ports;
use lock::Lock;
use proto::config::{Config, FromConfig};
use proto::event::LearnerEvent;
use proto::run_folder::RunFolder;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;
use stop::OrchestratorGone;
use training::Training;
use wire::{WireAddress, WireShape};

/// What a learner is started with.
#[derive(Debug, Clone)]
pub struct Arguments {
    /// Run folder.
    pub run: PathBuf,
    /// Where its services live.
    pub wire: WireAddress,
    /// How often this learner has been started under this wire address, from 1.
    pub incarnation: u32,
    /// Rank in the process group.
    pub rank: u32,
    /// Standard input is a lifeline.
    pub lifeline: bool,
}

/// Runs the learner to the end of its budget or to a stop.
pub fn run(arguments: Arguments) -> Result<()> {
    let Arguments { run, wire, incarnation, rank, lifeline } = arguments;
    let gone = OrchestratorGone::watched(lifeline)?;
    let run = RunFolder::new(run);
    let config = Config::of_run(&run)?;
    gone.end_after(Duration::from_secs_f64(config.longest_update_s()), || {
        tracing::error!("the orchestrator is gone, and there was time to save: ends");
        // Without destructors: those of the GPU would wait for a hanging operation.
        std::process::abort();
    })?;
    let learners = config.learner.count;
    ensure!(rank < learners, "the run has learners 0 to {}: there is no learner {rank}", learners - 1);
    let _lock = Lock::take(&run.learner_lock(rank), lock::PATIENCE, || gone.is_set())?;

    let device = device::choose(&config.learner)?;
    // A new rendezvous for each joint start, so that files of dead learners are not used.
    let rendezvous = wire.root().join(format!("learners-{incarnation}"));
    let peers = Peers::join(&rendezvous, [rank, learners], device)?;
    let mut agent = Agent::among(peers, columns(rank, &config), &config, device)?;
    if config.ppo.overlap {
        agent.overlap()?;
    }
    let machine = machine::machine(device, config.learner.threads, learners);
    let store = Store::new(run.clone(), &config.stages, &config.to_toml(), machine, config.checkpoint.keep);

    let file = std::fs::read_to_string(run.config()).with_context(|| run.config().display().to_string())?;
    let resumed = resume(&store, &mut agent, &config, &file)?;
    let Resumed { rollout, frames, boundary, checkpoint } = resumed;
    // 0 = none was found, which is not the checkpoint of rollout 0.
    agent.peers().agree("the rollouts of their checkpoints", checkpoint.as_ref().map_or(0, |_| rollout + 1))?;
    let ports = Ports::open(&wire, WireShape::of(&config), rank)?;
    let speaker = Speaker { rank, incarnation, ports: &ports, gone: &gone };
    let mut conversation = Conversation::open(speaker, &config, boundary, std::io::stdout())?;
    conversation.tell(&LearnerEvent::Ready {
        rank,
        rollout,
        frames,
        device: agent.device(),
        parameters: agent.parameter_count(),
        checkpoint: checkpoint.clone(),
    });
    let saved = checkpoint.map(|_| rollout);
    Training { config, run, store, agent, conversation, rollout, frames, in_update: None, saved }.run()
}

/// Columns, numbered as in the whole run, of the actors that a rank serves.
fn columns(rank: u32, config: &Config) -> Range<usize> {
    let actors = config.shares().actors_of(rank);
    let each = config.actors.environments_per_actor as usize;
    actors.start as usize * each..actors.end as usize * each
}

/// Where to go on.
struct Resumed {
    rollout: u64,
    frames: u64,
    boundary: Boundary,
    checkpoint: Option<String>,
}

/// Loads the newest good checkpoint into the agent. Without one the run starts, with another run's weights if the
/// configuration has `[from]`. `file`: the text of the configuration.
fn resume(store: &Store, agent: &mut Agent, config: &Config, file: &str) -> Result<Resumed> {
    let columns = agent.columns();
    let Some(loaded) = store.load()? else {
        if let Some(from) = &config.from {
            begin_from(agent, from)?;
        }
        return Ok(Resumed { rollout: 0, frames: 0, boundary: Boundary::start(columns.len()), checkpoint: None });
    };
    for rejected in &loaded.rejected {
        tracing::warn!("checkpoint passed over: {rejected}");
    }
    let (mut snapshot, manifest, path) = (loaded.snapshot, loaded.manifest, loaded.path);
    let (held, wanted) = (snapshot.boundary.environments.len(), config.environments());
    ensure!(held == wanted, "checkpoint {path} holds {held} environments, the configuration asks for {wanted}");
    snapshot.keep(columns);
    if let Some(changes) = changed::since(&manifest, config, file) {
        tracing::warn!(
            "the configuration has changed since checkpoint {path}: {changes}. The run goes on under the new one"
        );
    }
    let differences = store.machine().differences(&manifest.machine);
    if !differences.is_empty() {
        tracing::warn!(
            "results will not be bit-identical to a run without this resume: {} (checkpoint {path})",
            differences.join(", ")
        );
    }
    agent.load_state(&snapshot.agent).with_context(|| format!("cannot use checkpoint {path}"))?;
    let weights = agent.weights_digest();
    if weights != manifest.weights {
        bail!("the weights loaded from checkpoint {path} have digest {weights}, saved were {}", manifest.weights);
    }
    Ok(Resumed {
        rollout: snapshot.rollout,
        frames: snapshot.frames,
        boundary: snapshot.boundary,
        checkpoint: Some(path),
    })
}

/// Takes the weights of another run's checkpoint.
fn begin_from(agent: &mut Agent, from: &FromConfig) -> Result<()> {
    let manifest = weights::load(agent, Path::new(&from.checkpoint))
        .with_context(|| format!("cannot begin from {}", from.checkpoint))?;
    if manifest.weights != from.weights {
        bail!("{} holds weights {} now; the run was to begin from {}", from.checkpoint, manifest.weights, from.weights);
    }
    tracing::info!("begins with the weights of {} ({} frames)", from.checkpoint, from.frames);
    Ok(())
}
