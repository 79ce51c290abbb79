//! Which deadline of the learners is exceeded, and the report of it. Pure.

use super::event::Process;
use super::gang::Gang;
use super::policy::Policy;
use std::time::Duration;

/// What follows from a deadline that is exceeded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Overdue {
    /// The run fails, for this reason: trying again would only take as long again.
    Fails(String),
    /// All learners are killed, with this warning.
    Kills(String),
}

/// The first deadline that these learners have exceeded. All of them are there.
pub fn of_learners(gang: &Gang, policy: &Policy, now: Duration) -> Option<Overdue> {
    let Policy { learner_ready, actors_connected, silence, .. } = *policy;
    let learners = gang.size();
    if let Some(rank) = gang.late_to_be_ready(now, learner_ready) {
        let (who, limit_s) = (Process::Learner(rank), learner_ready.as_secs());
        return Some(Overdue::Fails(format!("{who} was not ready after {limit_s} s; its log says what it was doing")));
    }
    if let Some(rank) = gang.late_to_be_connected(now, actors_connected) {
        let (actors, who) = match learners {
            1 => ("actors", "the learner".to_owned()),
            _ => ("of its actors", Process::Learner(rank).to_string()),
        };
        return Some(Overdue::Fails(format!(
            "not all {actors} had answered {who} {} s after it was ready; their logs say what they were doing",
            actors_connected.as_secs()
        )));
    }
    if gang.silent_for(now).is_some_and(|silent| silent > silence) {
        let (who, are) = match learners {
            1 => (Process::Learner(0).to_string(), "is"),
            _ => (format!("the {learners} learners"), "are"),
        };
        return Some(Overdue::Kills(format!(
            "{who} finished neither a rollout nor an update for {} s and {are} killed",
            silence.as_secs()
        )));
    }
    None
}
