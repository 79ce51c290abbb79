//! The learner as a process: command line, lock, lifeline, shared memory, events, exit status.
//!
//! [`training`] is the loop; everything that decides anything in it is pure and lives elsewhere: the collector
//! ([`crate::collector`]), the checkpoint format ([`crate::checkpoint`]), [`announcements`].

mod announcements;
mod check;
mod control;
mod evaluation;
mod import;
mod lifeline;
mod lock;
mod machine;
mod stop;
mod training;
mod weights;
mod wire;

pub use check::check;
pub use evaluation::{EvaluationArguments, evaluate};
pub use import::{ImportArguments, import};
pub use training::NonFinite;

use crate::agent::Agent;
use crate::checkpoint::Store;
use crate::collector::{Boundary, Collector, Layout, Settings};
use crate::{device, ffi};
use anyhow::{Context, Result, bail};
use control::Control;
use lock::Lock;
use proto::config::{Config, FromConfig};
use proto::control::LearnerEvent;
use proto::run_folder::RunFolder;
use proto::wire::{WireAddress, WireShape};
use std::path::{Path, PathBuf};
use stop::OrchestratorGone;
use training::Training;
use wire::Ports;

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
    if rank != 0 {
        // Checkpoints and locks of several learners of one run would be one another's.
        bail!("this version trains with one learner: --rank must be 0, not {rank}");
    }
    let gone = OrchestratorGone::default();
    if lifeline {
        // Ctrl-C in a terminal reaches every process in the foreground; only the orchestrator acts on it.
        ffi::ignore_interrupt();
        lifeline::watch(std::io::stdin(), gone.clone()).context("cannot watch the lifeline")?;
    }
    let run = RunFolder::new(run);
    let path = run.config();
    let text =
        std::fs::read_to_string(&path).with_context(|| format!("cannot read configuration {}", path.display()))?;
    let config = Config::from_toml(&text, &path.display().to_string())?;
    let _lock = Lock::take(&run.learner_lock(rank), lock::PATIENCE, || gone.is_set())?;

    let device = device::choose(config.learner.device, config.learner.threads)?;
    let mut agent = Agent::new(&config, device)?;
    let machine = machine::machine(device, config.learner.threads);
    let store = Store::new(run.clone(), &config.stages, &config.to_toml(), machine, config.checkpoint.keep);

    let ActorsOf { layout, shape } = ActorsOf::rank(rank, &config);
    let resumed = resume(&store, &mut agent, layout, config.from.as_ref())?;
    let Resumed { rollout, frames, boundary, checkpoint } = resumed;
    let settings = Settings {
        layout,
        seed: config.seed,
        policy_actions: config.episode.action_space.actions().len(),
        max_episode_steps: config.episode.max_steps,
        gamma: config.ppo.gamma,
        learner_incarnation: incarnation,
    };
    let collector = Collector::new(settings, boundary);
    let ports = Ports::open(&wire, shape, &format!("learner-{rank}"))?;
    let mut control = Control::new(std::io::stdout(), gone.clone());
    control.tell(&LearnerEvent::Ready {
        rank,
        rollout,
        frames,
        device: device::describe(device),
        parameters: agent.parameter_count(),
        checkpoint: checkpoint.clone(),
    });
    let saved = checkpoint.map(|_| rollout);
    Training { rank, config, run, store, agent, collector, ports, control, gone, rollout, frames, saved }.run()
}

/// The actors that a rank serves.
struct ActorsOf {
    layout: Layout,
    shape: WireShape,
}

impl ActorsOf {
    fn rank(rank: u32, config: &Config) -> Self {
        let (actors, environments_per_actor) = (config.actors.count, config.actors.environments_per_actor);
        Self {
            layout: Layout::new(rank * actors, actors, environments_per_actor).in_kitchens(config.kitchens()),
            shape: WireShape { actors, environments_per_actor },
        }
    }
}

/// Where to go on.
struct Resumed {
    rollout: u64,
    frames: u64,
    boundary: Boundary,
    checkpoint: Option<String>,
}

/// Loads the newest good checkpoint into the agent; without any, the run starts, with the weights of another run if it
/// says so.
fn resume(store: &Store, agent: &mut Agent, layout: Layout, from: Option<&FromConfig>) -> Result<Resumed> {
    let Some(loaded) = store.load()? else {
        if let Some(from) = from {
            begin_from(agent, from)?;
        }
        return Ok(Resumed { rollout: 0, frames: 0, boundary: Boundary::start(layout.columns()), checkpoint: None });
    };
    for rejected in &loaded.rejected {
        tracing::warn!("checkpoint passed over: {rejected}");
    }
    let (snapshot, manifest, path) = (loaded.snapshot, loaded.manifest, loaded.path);
    if snapshot.boundary.environments.len() != layout.columns() {
        bail!(
            "checkpoint {path} holds {} environments, the configuration asks for {}",
            snapshot.boundary.environments.len(),
            layout.columns()
        );
    }
    if manifest.config_sha256 != store.config_sha256() {
        tracing::warn!("the configuration has changed since checkpoint {path}: the run goes on under the new one");
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
