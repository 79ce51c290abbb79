//! Which deadline of the learners is exceeded, and what is said about it. Pure.
//!
//! How long a rollout, an update or a checkpoint may take follows from how long the last ones took ([`super::pace`]).
//! What takes unusually long is first told of, again whenever the silence has doubled, and then ended.

use super::deadlines::Deadlines;
use super::event::Process;
use super::learner_group::LearnerGroup;
use super::pace::Work;
use std::time::Duration;

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Overdue {
    /// The run fails, for this reason: trying again would only take as long again.
    Fails(String),
    Kills(String),
    /// One was not ready in time: all learners are killed, and if that has happened before the run fails for this reason.
    Unready(String),
    Warns(String, Duration),
}

pub fn of_learners(learner_group: &LearnerGroup, deadlines: &Deadlines, now: Duration) -> Option<Overdue> {
    let Deadlines { learner_ready, actors_connected, .. } = *deadlines;
    if let Some(rank) = learner_group.late_to_be_ready(now, learner_ready) {
        let (who, limit_s) = (Process::Learner(rank), learner_ready.as_secs());
        return Some(Overdue::Unready(format!(
            "{who} was not ready after {limit_s} s; its log says what it was doing"
        )));
    }
    if let Some(rank) = learner_group.late_to_be_connected(now, actors_connected) {
        let (actors, who) = match learner_group.size() {
            1 => ("actors", "the learner".to_owned()),
            _ => ("of its actors", Process::Learner(rank).to_string()),
        };
        return Some(Overdue::Fails(format!(
            "not all {actors} had answered {who} {} s after it was ready; their logs say what they were doing",
            actors_connected.as_secs()
        )));
    }
    if let Some(starting) = learner_group.starting_for(now) {
        let rank = learner_group.late_to_be_ready(now, Duration::ZERO)?;
        return warning_is_due(learner_group, starting, learner_ready / 2).then(|| {
            let (waited_s, limit_s) = (starting.as_secs(), learner_ready.as_secs());
            let text = format!("{} is not ready after {waited_s} s; it is given {limit_s} s", Process::Learner(rank));
            Overdue::Warns(text, starting)
        });
    }
    of_progress(learner_group, deadlines, learner_group.silent_for(now)?)
}

fn of_progress(learner_group: &LearnerGroup, deadlines: &Deadlines, silent: Duration) -> Option<Overdue> {
    let (work, first) = learner_group.work();
    let (who, have, are) = subject(learner_group);
    let patience = deadlines.patience(work, &learner_group.pace, first);
    let silent_s = silent.as_secs();
    let usual = match deadlines.measured(work, &learner_group.pace) {
        Some(longest) => format!("the longest of the last took {:.1} s", longest.as_secs_f64()),
        None => "it is the first, so nobody knows how long it takes".to_owned(),
    };
    let warning = deadlines.warning(work, &learner_group.pace, first);
    let beside = deadlines.overlap && matches!(work, Work::Collect | Work::Update);
    let work = if beside { "rollout or update".to_owned() } else { work.to_string() };
    if silent > patience {
        return Some(Overdue::Kills(format!(
            "{who} {have} finished no {work} for {silent_s} s ({usual}) and {are} killed"
        )));
    }
    warning_is_due(learner_group, silent, warning).then(|| {
        let text = format!(
            "{who} {have} shown no progress for {silent_s} s: no {work} is finished ({usual}); {who} {are} killed after {} s",
            patience.as_secs()
        );
        Overdue::Warns(text, silent)
    })
}

/// Whether an orderly stop takes too long: what it has waited for learners `to` be done, and how long it may. Those that
/// exceed it hang.
pub fn of_stop(
    learner_group: &LearnerGroup,
    deadlines: &Deadlines,
    (waited, patience): (Duration, Duration),
    to: &str,
) -> Option<Overdue> {
    let (who, have, are) = subject(learner_group);
    if waited >= patience {
        return Some(Overdue::Fails(format!("{who} {have} not {to} within {} s", patience.as_secs())));
    }
    warning_is_due(learner_group, waited, deadlines.floor / 6).then(|| {
        let (waited_s, left_s) = (waited.as_secs(), patience.saturating_sub(waited).as_secs());
        let text = format!(
            "the stop waits for {who}: {who} {have} not {to} after {waited_s} s and {are} given {left_s} s more"
        );
        Overdue::Warns(text, waited)
    })
}

fn subject(learner_group: &LearnerGroup) -> (String, &'static str, &'static str) {
    match learner_group.size() {
        1 => (Process::Learner(0).to_string(), "has", "is"),
        learners => (format!("the {learners} learners"), "have", "are"),
    }
}

/// Whether to warn now: at first after `first`, then whenever the silence has doubled.
fn warning_is_due(learner_group: &LearnerGroup, silent: Duration, first: Duration) -> bool {
    silent > learner_group.warned.map_or(first, |last| last * 2)
}
