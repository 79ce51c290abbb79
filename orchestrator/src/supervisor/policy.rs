//! Every bound that the supervisor keeps, from the configuration.

use super::restart::RestartPolicy;
use proto::config::Config;
use proto::kitchen::Kitchens;
use std::time::Duration;

/// Every bound the supervisor keeps.
#[derive(Debug, Clone, Copy)]
pub struct Policy {
    /// Kitchens that the actors simulate.
    pub kitchens: Kitchens,
    /// Learner processes.
    pub learners: u32,
    /// Actor processes.
    pub actors: u32,
    /// On restarts.
    pub restart: RestartPolicy,
    /// From a learner's start to its `Ready`.
    pub learner_ready: Duration,
    /// From the last learner's `Ready` until all actors have answered.
    pub actors_connected: Duration,
    /// The longest that learners may be without a finished rollout or update; also the longest that saving may take.
    pub silence: Duration,
    /// An actor that the learner has waited for this long, and that has run this long, is taken to hang.
    pub actor_silence: Duration,
    /// From a learner's `Finished` to its exit.
    pub learner_leaves: Duration,
    /// From an actor's closed lifeline to its exit.
    pub actor_leaves: Duration,
    /// From SIGKILL to the death: longer only when the kernel itself is stuck.
    pub killed: Duration,
}

impl Policy {
    /// The bounds for a configuration.
    pub fn of(config: &Config) -> Self {
        let actor_deadline = Duration::from_secs_f64(config.learner.actor_deadline_s.min(1e6));
        Self {
            kitchens: config.kitchens(),
            learners: config.learner.count,
            actors: config.actors.count,
            restart: RestartPolicy::default(),
            learner_ready: Duration::from_mins(2),
            actors_connected: actor_deadline + Duration::from_secs(30),
            silence: Duration::from_secs_f64(config.longest_update_s()) + actor_deadline,
            actor_silence: actor_deadline / 2,
            learner_leaves: Duration::from_secs(30),
            actor_leaves: Duration::from_secs(2),
            killed: Duration::from_secs(10),
        }
    }
}
