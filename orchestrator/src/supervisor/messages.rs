use super::event::{Exit, Process};
use crate::output::log_line::{LogLine, error_in};
use proto::actor_notes::LastPlace;
use std::time::Duration;
use tracing::Level;

const LAST_CALL: &str = "its last call was in ";

pub fn rewinds(learners: usize, evaluates: bool) -> String {
    match learners {
        _ if evaluates => "it begins again".to_owned(),
        1 => "it goes on from the last checkpoint".to_owned(),
        _ => format!("all {learners} learners go on from the last checkpoint"),
    }
}

pub fn stopping(learners: usize, evaluates: bool) -> String {
    let what = match learners {
        _ if evaluates => "an evaluation that is cut off leaves no result",
        1 => "the learner saves",
        _ => "the learners save",
    };
    format!("stopping: {what}")
}

pub fn ready(rank: u32, device: &str, parameters: u64, checkpoint: Option<String>, frames: u64) -> String {
    let origin = checkpoint.map_or_else(String::new, |path| format!(" from {path},"));
    let who = Process::Learner(rank);
    format!("{who} ready on {device}, {parameters} parameters,{origin} {frames} frames trained")
}

pub fn connected(actors: u32) -> String {
    match actors {
        1 => "the actor connected".to_owned(),
        actors => format!("all {actors} actors connected"),
    }
}

/// That an actor leaves its learner waiting; it is killed now if it is not given more time.
pub fn unanswering(who: &str, waited: Duration, given: Option<Duration>) -> String {
    let then = given
        .map_or_else(|| " and is killed".to_owned(), |given| format!("; it is killed after {} s", given.as_secs()));
    format!("{who} has not answered for {} s{then}", waited.as_secs())
}

pub fn recorder_stands_still(rank: u32, waited_s: f64) -> String {
    let who = Process::Learner(rank);
    format!(
        "{who} waits for the recording, which has not got on for {waited_s:.0} s: its disk is slow or hangs, or its \
         orchestrator was stopped. No process is killed for that; the run waits up to ten minutes"
    )
}

/// Where an actor was in the code of others, the last line of one that has not said itself why it died. `at`: in which
/// line of Python.
pub fn last_call(place: LastPlace, at: Option<&str>) -> String {
    format!("{LAST_CALL}{place}{}", at.map_or_else(String::new, |at| format!(", at {at}")))
}

pub fn actor_died(who: &str, exit: &Exit, last_words: &[String], next: u32) -> String {
    let call = last_words.last().filter(|line| line.starts_with(LAST_CALL));
    let call = call.map_or_else(String::new, |call| format!(", {call}"));
    let error = environment_error(exit, last_words).map_or_else(String::new, |error| format!(", {error}"));
    format!("{who} died: {exit}{call}{error}; start number {next} follows")
}

/// Of a line of the log that says that a process was started again: which process, and why.
pub fn restart_in(text: &str) -> Option<(&str, &str)> {
    let (who, rest) = text.split_once(" died: ")?;
    let (why, next) = rest.rsplit_once("; start number ")?;
    next.contains(" follows").then_some((who, why))
}

/// What an environment of the user did wrong, and at which step, if an actor ended because of that.
pub fn environment_error<'a>(exit: &Exit, last_words: &'a [String]) -> Option<&'a str> {
    let error =
        last_words.iter().rev().map(|line| LogLine::parse(line)).find(|line| line.level == Some(Level::ERROR))?;
    of_environment(error.text).filter(|_| matches!(exit, Exit::Code(_)))
}

/// The same of one log line's text.
pub fn of_environment(text: &str) -> Option<&str> {
    let (actor, error) = text.split_once(": ")?;
    let is_placed = error.starts_with("environment ") && error.contains(", episode ") && error.contains(", step ");
    (actor.starts_with("actor ") && is_placed).then_some(error)
}

/// An environment's error that has come again where it came before: its seed and actions lead there at every start.
pub fn environment_fails(who: &str, error: &str) -> String {
    format!("{who} died twice of the same error: {error}; mend the environment, then resume the run")
}

pub fn died_at_stop(who: Process, evaluates: bool, exit: &Exit, last_words: &[String]) -> String {
    let words = quote(last_words);
    if evaluates {
        format!("{who} died while it stopped ({exit}){words}")
    } else {
        format!("{who} died while it saved ({exit}); the last checkpoint stands{words}")
    }
}

pub fn killed_for_it(learners: usize, late: &str) -> String {
    let are = if learners == 1 { "it is" } else { "they are" };
    format!("{late}: {are} killed, and save once more")
}

pub fn killed_unready(learners: usize, late: &str) -> String {
    match learners {
        1 => format!("{late}. It is killed"),
        learners => format!("{late}. All {learners} learners are killed: they start together"),
    }
}

pub fn immortal(who: &str) -> String {
    format!("SIGKILL does not end {who}: the kernel holds on")
}

pub fn also(failure: Option<&str>, then: &str) -> String {
    failure.map_or_else(|| then.to_owned(), |failure| format!("{failure}\n{then}"))
}

/// Who is given up when learners fall too often, and who of them died last, where they are several.
pub fn learners_given_up(learners: usize, last: Process) -> (String, String) {
    match learners {
        1 => (last.to_string(), String::new()),
        _ => ("the learners".to_owned(), format!("{last} ")),
    }
}

pub fn given_up(who: &str, last: &str, deaths: usize, exit: &Exit, last_words: &[String]) -> String {
    let words = quote(last_words);
    let how = match exit {
        Exit::Code(_) | Exit::Signal(_) => format!("with {exit}"),
        Exit::Killed | Exit::NotStarted(_) => exit.to_string(),
    };
    format!("{who} died {deaths} times while the run got no further, last {last}{how}{words}")
}

/// What to do about an actor that is killed again and again.
pub fn needs_more_time(deadline: Duration) -> String {
    let deadline_s = deadline.as_secs_f64();
    format!(
        "\nIf an answer may take longer than {deadline_s} s, raise learner.actor_deadline_s in the run's config.toml, then \
         resume the run"
    )
}

/// A process's last lines, indented below the report of its death: from its last logged error on, if there is one.
pub fn quote(last_words: &[String]) -> String {
    if last_words.is_empty() {
        return String::new();
    }
    let error = last_words.iter().rposition(|line| error_in(line).is_some()).unwrap_or(0);
    format!("; its last messages:\n    {}", last_words[error..].join("\n    "))
}
