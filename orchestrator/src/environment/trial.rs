//! A trial of an environment while it goes on: what it is doing, for how long, and how it ends.

use crate::output::terminal::Live;
use crate::process_end::wait_for_child;
use rustix::process::{Pid, Signal, kill_process};
use serde::Deserialize;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ExitStatus};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use wire::HeldRequests;

/// To import a simulator, and to make an environment.
const IMPORTS_WITHIN: Duration = Duration::from_mins(3);
const SILENT_FOR: Duration = Duration::from_secs(2);
const LOOK: Duration = Duration::from_millis(100);
/// To write down where it is.
const WRITES_WITHIN: Duration = Duration::from_secs(1);

/// What an environment's process says before it does it: a method of the environment, or nothing, and what is done.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Call {
    call: String,
    place: String,
}

#[derive(Debug)]
pub struct Trial(Mutex<(Call, Instant)>);

pub enum Ended {
    Exited(ExitStatus),
    Late(Late),
    Interrupted,
}

#[derive(Debug)]
pub struct Late {
    call: Call,
    limit: Duration,
}

impl Default for Trial {
    fn default() -> Self {
        let call = Call { call: String::new(), place: "it is being imported".to_owned() };
        Self(Mutex::new((call, Instant::now())))
    }
}

impl Trial {
    fn doing(&self) -> MutexGuard<'_, (Call, Instant)> {
        // A panic while it is replaced leaves nothing that could be inconsistent.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads calls from standard output, and returns all else.
    pub fn read(&self, output: impl Read) -> std::io::Result<Vec<u8>> {
        let (mut output, mut answer, mut line) = (BufReader::new(output), vec![], vec![]);
        while output.read_until(b'\n', &mut line)? > 0 {
            match serde_json::from_slice(&line) {
                Ok(call) => *self.doing() = (call, Instant::now()),
                Err(_) => answer.append(&mut line),
            }
            line.clear();
        }
        Ok(answer)
    }

    /// Waits until the process has ended, is late, or this program is asked to end. Then it may still run.
    pub fn wait(&self, child: &mut Child, requests: &HeldRequests, deadline: Duration) -> std::io::Result<Ended> {
        let (mut live, began) = (Live::default(), Instant::now());
        let ended = loop {
            if let Some(status) = wait_for_child(child, LOOK)? {
                break Ended::Exited(status);
            }
            if requests.take() {
                break Ended::Interrupted;
            }
            let (call, since) = self.doing().clone();
            let limit = if call.call.is_empty() { IMPORTS_WITHIN } else { deadline };
            if since.elapsed() >= limit {
                // Python writes down where it is. Another program may end.
                let _ = kill_process(Pid::from_child(child), Signal::USR1);
                wait_for_child(child, WRITES_WITHIN)?;
                break Ended::Late(Late { call, limit });
            }
            if began.elapsed() >= SILENT_FOR && live.is_due(began.elapsed()) {
                live.show(format!("trying the environment: {}, {} s", call.place, since.elapsed().as_secs()));
            }
        };
        live.clear();
        Ok(ended)
    }
}

impl Late {
    /// `place`: where the process is in its program, if it has said so.
    pub fn sentence(&self, command: &str, place: Option<&str>) -> String {
        let Self { call: Call { call, place: doing }, limit } = self;
        let seconds = limit.as_secs_f64();
        let place = place.map_or_else(String::new, |place| format!(", and is in {place}"));
        if call.is_empty() {
            return format!("`{command}` has not described its environment: {doing} for {seconds} s{place}");
        }
        format!(
            "the environment's {call} has not returned for {seconds} s (last call: {doing}){place}; \
             learner.actor_deadline_s is its deadline"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_are_taken_out_of_what_a_process_says() {
        let trial = Trial::default();
        let call = r#"{"call": "reset()", "place": "reset() of the episode with seed 2"}"#;
        let said = format!("{call}\n{{ \"name\":\n \"mine\" }}");
        assert_eq!(trial.read(said.as_bytes()).unwrap(), b"{ \"name\":\n \"mine\" }");
        assert_eq!(trial.doing().0.call, "reset()");
    }

    #[test]
    fn an_import_that_is_late_is_no_call_that_is() {
        let call = Trial::default().doing().0.clone();
        let late = Late { call, limit: IMPORTS_WITHIN };
        assert_eq!(
            late.sentence("python3 mine.py", Some("/mine.py:3")),
            "`python3 mine.py` has not described its environment: it is being imported for 180 s, and is in /mine.py:3"
        );
    }
}
