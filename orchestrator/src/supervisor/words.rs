//! Sentences about deaths for the user. Pure.

use super::event::Exit;
use crate::showing::log_line::error_in;

/// How the run goes on after a learner died.
pub fn rewinds(learners: usize, evaluates: bool) -> String {
    match learners {
        _ if evaluates => "it begins again".to_owned(),
        1 => "it goes on from the last checkpoint".to_owned(),
        _ => format!("all {learners} learners go on from the last checkpoint"),
    }
}

/// The report that a process is not started again. `last`: which of several died last.
pub fn given_up(who: &str, last: &str, deaths: usize, exit: &Exit, last_words: &[String]) -> String {
    let words = quote(last_words);
    format!("{who} died {deaths} times while the run got no further, last {last}with {exit}{words}")
}

/// A process's last lines, indented below the report of its death: from its last logged error on, if there is one.
pub fn quote(last_words: &[String]) -> String {
    if last_words.is_empty() {
        return String::new();
    }
    let error = last_words.iter().rposition(|line| error_in(line).is_some()).unwrap_or(0);
    format!("; its last messages:\n    {}", last_words[error..].join("\n    "))
}
