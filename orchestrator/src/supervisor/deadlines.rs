//! Which deadline of the learners is exceeded, and what is said about it. Pure.
//!
//! How long a rollout, an update or a checkpoint may take follows from how long the last ones took ([`super::pace`]).
//! What takes unusually long is first told of, again whenever the silence has doubled, and then ended.

use super::event::Process;
use super::gang::Gang;
use super::pace::Work;
use super::policy::Policy;
use std::time::Duration;

/// What follows from a deadline that is exceeded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Overdue {
    /// The run fails, for this reason: trying again would only take as long again.
    Fails(String),
    /// All learners are killed, with this warning.
    Kills(String),
    /// One was not ready in time: all learners are killed, and if that has happened before the run fails for this reason.
    Unready(String),
    /// The user is warned. The silence until then.
    Warns(String, Duration),
}

/// The first deadline that these learners have exceeded. All of them are there.
pub fn of_learners(gang: &Gang, policy: &Policy, now: Duration) -> Option<Overdue> {
    let Policy { learner_ready, actors_connected, .. } = *policy;
    if let Some(rank) = gang.late_to_be_ready(now, learner_ready) {
        let (who, limit_s) = (Process::Learner(rank), learner_ready.as_secs());
        return Some(Overdue::Unready(format!(
            "{who} was not ready after {limit_s} s; its log says what it was doing"
        )));
    }
    if let Some(rank) = gang.late_to_be_connected(now, actors_connected) {
        let (actors, who) = match gang.size() {
            1 => ("actors", "the learner".to_owned()),
            _ => ("of its actors", Process::Learner(rank).to_string()),
        };
        return Some(Overdue::Fails(format!(
            "not all {actors} had answered {who} {} s after it was ready; their logs say what they were doing",
            actors_connected.as_secs()
        )));
    }
    if let Some(starting) = gang.starting_for(now) {
        let rank = gang.late_to_be_ready(now, Duration::ZERO)?;
        return warning_is_due(gang, starting, learner_ready / 2).then(|| {
            let (waited_s, limit_s) = (starting.as_secs(), learner_ready.as_secs());
            let text = format!("{} is not ready after {waited_s} s; it is given {limit_s} s", Process::Learner(rank));
            Overdue::Warns(text, starting)
        });
    }
    of_progress(gang, policy, gang.silent_for(now)?)
}

/// The deadline of the work that they are at.
fn of_progress(gang: &Gang, policy: &Policy, silent: Duration) -> Option<Overdue> {
    let (work, first) = gang.work();
    let (who, have, are) = subject(gang);
    let patience = policy.patience(work, gang.pace(), first);
    let silent_s = silent.as_secs();
    let usual = match policy.measured(work, gang.pace()) {
        Some(longest) => format!("the longest of the last took {:.1} s", longest.as_secs_f64()),
        None => "it is the first, so nobody knows how long it takes".to_owned(),
    };
    let warning = policy.warning(work, gang.pace(), first);
    let beside = policy.overlap && matches!(work, Work::Collect | Work::Update);
    let work = if beside { "rollout or update".to_owned() } else { work.to_string() };
    if silent > patience {
        return Some(Overdue::Kills(format!(
            "{who} {have} finished no {work} for {silent_s} s ({usual}) and {are} killed"
        )));
    }
    warning_is_due(gang, silent, warning).then(|| {
        let text = format!(
            "{who} {have} shown no progress for {silent_s} s: no {work} is finished ({usual}); {who} {are} killed after {} s",
            patience.as_secs()
        );
        Overdue::Warns(text, silent)
    })
}

/// Whether an orderly stop takes too long: what it has waited for learners `to` be done, and how long it may. Those that
/// exceed it hang.
pub fn of_stop(gang: &Gang, policy: &Policy, (waited, patience): (Duration, Duration), to: &str) -> Option<Overdue> {
    let (who, have, are) = subject(gang);
    if waited >= patience {
        return Some(Overdue::Fails(format!("{who} {have} not {to} within {} s", patience.as_secs())));
    }
    warning_is_due(gang, waited, policy.floor / 6).then(|| {
        let (waited_s, left_s) = (waited.as_secs(), patience.saturating_sub(waited).as_secs());
        let text = format!(
            "the stop waits for {who}: {who} {have} not {to} after {waited_s} s and {are} given {left_s} s more"
        );
        Overdue::Warns(text, waited)
    })
}

/// The learners as a subject, with its verbs.
fn subject(gang: &Gang) -> (String, &'static str, &'static str) {
    match gang.size() {
        1 => (Process::Learner(0).to_string(), "has", "is"),
        learners => (format!("the {learners} learners"), "have", "are"),
    }
}

/// Whether to warn now: at first after `first`, then whenever the silence has doubled.
fn warning_is_due(gang: &Gang, silent: Duration, first: Duration) -> bool {
    silent > gang.last_warning().map_or(first, |last| last * 2)
}
