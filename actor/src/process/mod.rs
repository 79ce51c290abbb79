//! The rollout actor: E environments of a task and one connection to the learner.
//!
//! ```text
//! protocol      who says what when: a pure state machine
//! environments  the simulated environments, and how they are rebuilt from their actions
//! scenes        where they are, and what their cameras see there
//! prefetcher        procedural kitchens, made ahead
//! link          the actor's ends of the shared-memory services
//! shm           observations written where they lie in shared memory
//! whereabouts   which environment is being simulated, for last words
//! ```
//!
//! [`run`] is the thin shell around them: it drains what has arrived into [`Protocol`], does the one thing that
//! [`Protocol::next`] says, and begins again. It never returns but by an error: an actor lives until its lifeline
//! closes or it is killed, and holds nothing that cannot be rebuilt.

pub mod environments;
mod link;
pub mod prefetcher;
pub mod protocol;
mod scenes;
mod shm;
pub mod whereabouts;

use anyhow::{Context, Result, ensure};
use environments::Environments;
use link::{Arrived, Link};
use prefetcher::KitchenPrefetcher;
use proto::bounded;
use proto::config::Config;
use proto::kitchen::KitchenId;
use protocol::{Protocol, Todo, Verdict};
use std::path::{Path, PathBuf};
use std::time::Instant;
use wire::{WireAddress, WireShape, fault};

/// What a rollout actor is told on its command line.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Its number among the run's actors, from 0.
    pub actor: u32,
    /// How often it has been started in this run incarnation, from 1.
    pub incarnation: u32,
    /// Where the services are.
    pub wire: WireAddress,
    /// The run's effective configuration.
    pub config: PathBuf,
    /// Kitchen to simulate in place of the actor's own.
    pub kitchen: Option<KitchenId>,
}

/// Runs the actor until something fails.
pub fn run(settings: &Settings) -> Result<std::convert::Infallible> {
    let path = settings.config.display().to_string();
    let text = bounded::read_text(&settings.config).with_context(|| format!("cannot read {path}"))?;
    let config = Config::from_toml(&text, &path)?;
    let kitchen = settings.kitchen.or_else(|| config.kitchens().of_actor(settings.actor));
    let _span = match kitchen {
        Some(kitchen) => tracing::info_span!("actor", number = settings.actor, kitchen = kitchen.number()).entered(),
        None => tracing::info_span!("actor", number = settings.actor).entered(),
    };

    let started = Instant::now();
    let folder = settings.config.parent().unwrap_or(Path::new(""));
    ensure!(
        settings.kitchen.is_none() || !config.kitchen_schedule().moves(),
        "--kitchen cannot be used where environments go from kitchen to kitchen"
    );
    let mut environments =
        Environments::new(KitchenPrefetcher::of(&config, folder)?, kitchen, settings.actor, &config)?;
    let kitchen_ms = started.elapsed().as_millis() as u64;
    let recorder = config.recording.enabled;
    let link = Link::open(&settings.wire, WireShape::of(&config), settings.actor, recorder)?;
    tracing::info!(
        bodies = environments.bodies(),
        triangles = environments.triangles(),
        environments = config.actors.environments_per_actor,
        kitchen_ms,
        total_ms = started.elapsed().as_millis() as u64,
        incarnation = settings.incarnation,
        "ready"
    );

    let environments_each = config.actors.environments_per_actor;
    let mut protocol = Protocol::new(settings.actor, settings.incarnation, environments_each, recorder);
    let mut accepted: [Vec<u8>; 2] = Default::default();
    loop {
        if protocol.is_strange() {
            protocol.on_met(link.met());
        }
        fault::reach("actor.before_receive");
        receive(&link, &mut protocol, &mut environments, &mut accepted, started)?;
        match protocol.next(started.elapsed()) {
            Todo::Hello => {
                link.send_hello(protocol.hello_header())?;
                protocol.hello_sent(started.elapsed());
                fault::reach("actor.after_hello");
            }
            Todo::Act { half } => {
                environments.act(protocol.halves().range(half), &accepted[half as usize])?;
                protocol.acted(half, started.elapsed());
            }
            Todo::Send { half } => {
                let range = protocol.halves().range(half);
                fault::reach("actor.before_send");
                let everyone =
                    link.send_observations(protocol.observation_header(half), range.len(), |i, observation| {
                        environments.observe(range.start + i, observation);
                    })?;
                fault::reach("actor.after_send");
                protocol.sent(half, everyone, started.elapsed());
            }
            // What arrives meanwhile waits for one piece of work at most.
            Todo::Wait(longest) => {
                if !environments.prepare() {
                    link.wait(longest);
                }
            }
        }
    }
}

/// Takes in what has arrived; actions that are accepted are kept by half until they are applied.
fn receive(
    link: &Link,
    protocol: &mut Protocol,
    environments: &mut Environments,
    accepted: &mut [Vec<u8>; 2],
    started: Instant,
) -> Result<()> {
    let Arrived { restores, actions } = link.receive()?;
    // The restores first: actions may build on them.
    for (header, states) in restores {
        match protocol.on_restore(&header, states.len(), started.elapsed()) {
            Verdict::Accepted => {
                fault::reach("actor.before_rebuild");
                environments.rebuild(&states)?;
                tracing::info!(learner_incarnation = header.learner_incarnation, step = ?header.step, "restored");
                fault::reach("actor.after_rebuild");
            }
            Verdict::Ignored(reason) => tracing::debug!(?header, reason, "restore ignored"),
        }
    }
    for (header, actions) in actions {
        match protocol.on_actions(&header, actions.len()) {
            Verdict::Accepted => {
                fault::reach("actor.after_receive");
                accepted[header.half as usize] = actions;
            }
            Verdict::Ignored(reason) => tracing::debug!(?header, reason, "actions ignored"),
        }
    }
    Ok(())
}
