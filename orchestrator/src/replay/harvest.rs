use super::simulate::{Actor, feed};
use crate::output::terminal::Live;
use crate::preflight::programs;
use crate::process_end::wait_for_child;
use anyhow::{Context, Result, anyhow, bail};
use proto::dataset::{DatasetAnswer, DatasetRequest, DatasetSetup};
use proto::episode::EnvironmentId;
use proto::exit::how;
use proto::replay::Difference;
use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Stdio};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// An actor that says nothing for this long hangs: with pictures an episode takes minutes on a busy machine.
const SILENCE_DEADLINE: Duration = Duration::from_hours(1);
const EXIT_DEADLINE: Duration = Duration::from_secs(10);

#[derive(Debug, Default)]
pub struct Harvest {
    pub simulated: u64,
    /// Those of them that the recording ends in the middle of.
    pub unfinished: u64,
    pub compared: u64,
    pub written: Option<[u64; 3]>,
}

/// Makes the data set; an error if anything differs from the recording, and then there is none.
pub fn harvest(setup: DatasetSetup, requests: Vec<DatasetRequest>) -> Result<Harvest> {
    let total = requests.len();
    let program = programs::find("actor")?;
    let mut child = Command::new(&program)
        .arg("dataset")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start {}", program.display()))?;
    let input = child.stdin.take().context("the actor has no standard input")?;
    let output = BufReader::new(child.stdout.take().context("the actor has no standard output")?);
    let mut actor = Actor(child);
    // On threads of their own: neither pipe can fill up while we wait on the other.
    thread::Builder::new().name("dataset-in".to_owned()).spawn(move || feed(input, &setup, &requests))?;
    let (answers, inbox) = channel();
    thread::Builder::new().name("dataset-out".to_owned()).spawn(move || listen(output, &answers))?;

    let mut harvest = Harvest::default();
    let (mut live, began) = (Live::default(), Instant::now());
    let (mut whole, mut problem) = (false, None);
    loop {
        match inbox.recv_timeout(SILENCE_DEADLINE) {
            // The actor then ends by itself and removes what it has written; killed at once, it would leave it.
            Ok(answer) => match answer.and_then(|answer| harvest.take(answer)) {
                Ok(is_last) => whole |= is_last,
                Err(found) => problem = Some(found),
            },
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => bail!("the actor has said nothing for an hour: giving up"),
        }
        if live.is_due(began.elapsed()) {
            live.show(format!(
                "{} of {total} episodes simulated, cut-off ones too, {} states compared",
                harvest.simulated, harvest.compared
            ));
        }
    }
    live.clear();
    let ended = wait_for_child(&mut actor.0, EXIT_DEADLINE).context("cannot wait for the actor")?;
    match (ended, problem) {
        // What it left unfinished says less.
        (Some(status), _) if status.signal().is_some() => {
            bail!("no data set was written: `actor dataset` {}", how(status))
        }
        (_, Some(problem)) => Err(problem),
        (Some(status), _) if !status.success() => {
            bail!("no data set was written: the actor's last message is above")
        }
        (Some(_), _) if whole => Ok(harvest),
        (Some(_), _) => bail!("the actor ended without a result"),
        (None, _) => bail!("the actor closed its output but did not exit"),
    }
}

impl Harvest {
    /// Counts an answer; whether it is the last. A difference from the recording is an error.
    fn take(&mut self, answer: DatasetAnswer) -> Result<bool> {
        match answer {
            DatasetAnswer::Simulated { verdict, unfinished, .. } => {
                if let Some(Difference { step, what }) = verdict.first_difference {
                    let EnvironmentId { kitchen, number } = verdict.environment;
                    bail!(
                        "no data set was written: the simulation differs from the recording in kitchen {kitchen}, \
                         environment {number}, episode {}, step {step}: {what}; `orchestrator replay --check` compares all of it",
                        verdict.episode
                    );
                }
                self.simulated += 1;
                self.unfinished += u64::from(unfinished);
                self.compared += verdict.compared;
                Ok(false)
            }
            DatasetAnswer::Written { episodes, steps, bytes } => {
                self.written = Some([episodes, steps, bytes]);
                Ok(true)
            }
            DatasetAnswer::Nothing => Ok(true),
        }
    }
}

fn listen(output: impl BufRead, answers: &Sender<Result<DatasetAnswer>>) {
    for line in output.lines() {
        let answer = line.context("cannot read from an actor").and_then(|line| {
            serde_json::from_str(&line).map_err(|_| anyhow!("an actor printed a line that is no answer: {line}"))
        });
        if answers.send(answer).is_err() {
            return;
        }
    }
}
