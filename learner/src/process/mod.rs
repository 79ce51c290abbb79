//! The learner as a process: command line, lock, lifeline, shared memory, events, exit status.
//!
//! [`training`] and [`evaluation`] are loops over a [`conversation`]. They keep the order of things and the deadlines.
//! What a message means is decided by pure state machines: the collector ([`crate::collector`]) and [`announcements`].

mod announcements;
mod changed;
mod check;
mod control;
mod conversation;
mod ends;
mod evaluation;
mod failure;
mod import;
mod link;
mod lock;
mod machine;
mod output;
mod pacing;
mod patience;
mod resume;
mod ringers;
mod stop;
mod training;
mod weights;
mod writing;

pub use announcements::{Announcements, Permission};
pub use check::check;
pub use evaluation::{EvaluationArguments, evaluate};
pub use failure::{is_non_finite, is_of_peers, is_unsaved};
pub use import::{ImportArguments, import};
pub use patience::{Patience, Waited};
pub use weights::facts_of;

use crate::agent::Agent;
use crate::checkpoint::Store;
use crate::collector::Pace;
use crate::device;
use crate::peers::{Meeting, Peers};
use anyhow::{Context, Result, ensure};
use conversation::{Conversation, Speaker};
use link::Ports;
use lock::Lock;
use output::claim_stdout;
use pacing::Pacing;
use proto::config::Config;
use proto::event::LearnerEvent;
use proto::hosts::{Hosts, MEETING_KEY};
use proto::run_folder::RunFolder;
use resume::{Resumed, resume};
use std::net::{IpAddr, SocketAddr};
use std::ops::Range;
use std::path::PathBuf;
use std::time::Duration;
use stop::OrchestratorGone;
use training::Training;
use wire::WireAddress;
use wire::message::Halves;

#[derive(Debug, Clone)]
pub struct Arguments {
    pub run: PathBuf,
    pub wire: WireAddress,
    /// How often this learner has been started under this wire address, from 1.
    pub incarnation: u32,
    pub rank: u32,
    /// Standard input is a lifeline.
    pub lifeline: bool,
    /// Where it meets learners of other hosts; none where all are on one.
    pub network: Option<Network>,
}

/// What a learner of a run on several hosts is told of the network.
#[derive(Debug, Clone)]
pub struct Network {
    pub hosts: u32,
    pub store: SocketAddr,
    /// The first learner's descriptor of the socket that listens there.
    pub listener: Option<i32>,
    pub own: IpAddr,
}

/// Runs the learner to the end of its budget or to a stop.
pub fn run(arguments: Arguments) -> Result<()> {
    let Arguments { run, wire, incarnation, rank, lifeline, network } = arguments;
    let output = claim_stdout()?;
    let gone = OrchestratorGone::watched(lifeline)?;
    let run = RunFolder::new(run);
    let config = Config::of_run(&run)?;
    gone.end_after(Duration::from_secs_f64(config.longest_update_s()), || {
        tracing::error!("the orchestrator is gone, and there was time to save: this learner ends");
        // Without destructors: those of the GPU would wait for a hanging operation.
        std::process::abort();
    })?;
    let learners = config.learner.count;
    ensure!(rank < learners, "the run has learners 0 to {}: there is no learner {rank}", learners - 1);
    let count = network.as_ref().map_or(1, |network| network.hosts);
    ensure!((1..=learners).contains(&count), "{count} hosts cannot share {learners} learners: every host has learners");
    let hosts = Hosts::new(count, config.shares());
    let _lock = Lock::take(&run.learner_lock(rank), lock::PATIENCE, || gone.is_set())?;

    let device = device::choose(&config.learner)?;
    let meeting = meeting(network.as_ref(), &wire, incarnation)?;
    // libtorch waits for a learner that never comes, and does not notice the lifeline. There is nothing to save yet.
    let joining = gone.end_while_held(|| {
        tracing::error!("the orchestrator is gone before all learners have joined: this learner ends");
        std::process::abort();
    })?;
    let peers = Peers::join(&meeting, [rank, learners], device)?;
    drop(joining);
    let mut agent = Agent::among(peers, columns(rank, &config), &config, device)?;
    if config.ppo.overlap {
        agent.overlap()?;
    }
    let machine = machine::machine(device, config.learner);
    // A folder without an identity was made by hand.
    let id = if run.identity().exists() { wire.run_id() } else { "" };
    let store = Store::new((run.clone(), id), &config.stages, &config.to_toml(), machine, config.checkpoint.keep);
    store.check_run()?;

    let file = run.read_text(&run.config()).with_context(|| run.config().display().to_string())?;
    let resumed = resume(&store, &mut agent, &config, &file, (rank, hosts))?;
    let Resumed { rollout, frames, boundary, resting, figures, checkpoint } = resumed;
    // 0 = none was found, which is not the checkpoint of rollout 0.
    agent.peers().agree("the rollouts of their checkpoints", checkpoint.as_ref().map_or(0, |_| rollout + 1))?;
    let ports = Ports::open(&wire, &config, rank)?;
    let speaker = Speaker { rank, incarnation, ports: &ports, gone: &gone };
    let mut conversation = Conversation::open(speaker, &config, agent.shards(), boundary, output);
    conversation.tell(&LearnerEvent::Ready {
        rank,
        rollout,
        frames,
        device: agent.device(),
        parameters: agent.parameter_count(),
        checkpoint: checkpoint.clone(),
    });
    let saved = checkpoint.map(|_| rollout);
    let (orchestrator, in_update) = (wire.incarnation(), None);
    let pacing = match Halves::of(config.actors.environments_per_actor).count() {
        _ if !agent.takes_who_is_ready() => Pacing::fixed(Pace::Lockstep),
        // Nothing is simulated while a single half is inferred: there the GPU has time.
        1 => Pacing::faster_than(Pace::Ready),
        _ => Pacing::faster_than(Pace::Lockstep),
    };
    let training = Training {
        config,
        run,
        store,
        agent,
        conversation,
        pacing,
        rollout,
        frames,
        in_update,
        saved,
        resting,
        figures,
        orchestrator,
        hosts,
    };
    training.run()
}

/// Where the learners of this joint start meet: nowhere that dead ones have used.
fn meeting(network: Option<&Network>, wire: &WireAddress, incarnation: u32) -> Result<Meeting> {
    let Some(&Network { store, listener, own, .. }) = network else {
        return Ok(Meeting::File(wire.root().join(format!("learners-{incarnation}"))));
    };
    let key = std::env::var(MEETING_KEY).with_context(|| format!("the variable {MEETING_KEY} is not set"))?;
    Ok(Meeting::Network { store, listener, own, key: format!("{key}/{incarnation}") })
}

/// Columns, numbered as in the whole run, of the actors that a rank serves.
fn columns(rank: u32, config: &Config) -> Range<usize> {
    let actors = config.shares().actors_of(rank);
    let each = config.actors.environments_per_actor as usize;
    actors.start as usize * each..actors.end as usize * each
}
