//! The actor process around any simulator: E environments of a task and one connection to the learner.
//!
//! ```text
//! simulator     what an actor process runs: the trait
//! environments  the simulated environments, and how they are rebuilt from their actions
//! protocol      who says what when: a pure state machine
//! link          the actor's ends of the shared-memory services
//! shm           observations written where they lie in shared memory
//! guest         simulators whose code is not ours, in any language
//! whereabouts   which environment is being simulated, for last words
//! ```
//!
//! [`run`] is the thin shell around them: it drains what has arrived into [`Protocol`], does the one thing that
//! [`Protocol::next`] says, and begins again. It never returns but by an error: an actor lives until its lifeline
//! closes or it is killed, and holds nothing that cannot be rebuilt.

mod environments;
mod error;
pub mod guest;
mod link;
pub mod protocol;
mod shm;
mod simulator;
pub mod whereabouts;

pub use environments::Environments;
pub use error::EngineError;
pub use link::Link;
pub use simulator::Simulator;

use link::Arrived;
use protocol::{Protocol, Todo, Verdict};
use std::time::Instant;
use wire::fault;

/// Runs an actor, which has been started so often in this run incarnation, until something fails.
pub fn run<S: Simulator>(
    link: &Link,
    environments: &mut Environments<S>,
    incarnation: u32,
) -> Result<std::convert::Infallible, EngineError> {
    let started = Instant::now();
    let mut protocol = Protocol::new(link.actor(), incarnation, environments.count(), link.is_recorded());
    let mut accepted: [Vec<u8>; 2] = Default::default();
    // A half that is simulated, and where its records will be.
    let mut ahead = None;
    loop {
        if protocol.is_strange() {
            protocol.on_met(link.met());
        }
        fault::reach("actor.before_receive");
        receive(link, &mut protocol, environments, &mut accepted, started)?;
        match protocol.next(started.elapsed()) {
            Todo::Hello => {
                link.send_hello(protocol.hello_header())?;
                protocol.hello_sent(started.elapsed());
                fault::reach("actor.after_hello");
            }
            Todo::Act { half } => {
                let range = protocol.halves().range(half);
                let (_, sample) = ahead.insert((half, link.loan(range.len())?));
                environments.act(range, &accepted[half as usize], sample.payload_mut())?;
                protocol.acted(half, started.elapsed());
            }
            Todo::Send { half } => {
                let range = protocol.halves().range(half);
                fault::reach("actor.before_send");
                // A restore can come between, and then the other half is sent first.
                let mut sample = match ahead.take().filter(|(simulated, _)| *simulated == half) {
                    Some((_, sample)) => sample,
                    None => link.loan(range.len())?,
                };
                environments.observe_all(range, sample.payload_mut())?;
                let everyone = link.send_observations(sample, protocol.observation_header(half))?;
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
fn receive<S: Simulator>(
    link: &Link,
    protocol: &mut Protocol,
    environments: &mut Environments<S>,
    accepted: &mut [Vec<u8>; 2],
    started: Instant,
) -> Result<(), EngineError> {
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
        match protocol.on_actions(&header, link.count(&actions)) {
            Verdict::Accepted => {
                fault::reach("actor.after_receive");
                accepted[header.half as usize] = actions;
            }
            Verdict::Ignored(reason) => tracing::debug!(?header, reason, "actions ignored"),
        }
    }
    Ok(())
}
