//! Recorded episodes, simulated again.
//!
//! The simulator is bit-identical for the same (kitchen, episode, actions). So every recorded episode is handed to
//! `actor replay`, which takes the actions again and compares the hash of every state on the way, and draws what the
//! camera saw where that is asked for. The work is divided by kitchen over as many actors as there are cores.

use crate::environment;
use crate::output::log_line::ERROR;
use crate::output::terminal::{self, Live};
use crate::preflight::programs;
use crate::process_end::wait_for_child;
use anyhow::{Context, Result, anyhow, bail, ensure};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::exit::how;
use proto::kitchen::KitchenId;
use proto::printable::printable;
use proto::replay::{Difference, RecordedEpisode, ReplayLine, ReplaySetup, ReplayVerdict};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, BufWriter, ErrorKind, Write};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

/// An actor without output for this long hangs: an episode takes well under a second, the first also builds its
/// kitchen.
const SILENCE_DEADLINE: Duration = Duration::from_mins(5);
/// The same where it draws: a film of two hundred steps takes a minute, a large one on a busy machine many.
const DRAWING_DEADLINE: Duration = Duration::from_hours(1);
const EXIT_DEADLINE: Duration = Duration::from_secs(10);
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

#[derive(Debug, Default)]
pub struct Totals {
    pub episodes: u64,
    pub compared: u64,
    pub images: u64,
    pub different: u64,
    /// Moments that are drawn, also of episodes without a verdict yet.
    drawn: u64,
    /// Kitchen, environment, episode, step of the first one, in that order, and what differs.
    pub first: Option<(u32, u32, u32, Difference)>,
    pub kinds: BTreeMap<String, u64>,
}

impl Totals {
    fn add(&mut self, verdict: &ReplayVerdict) {
        self.episodes += 1;
        self.compared += verdict.compared;
        self.images += verdict.images;
        if let Some(difference) = &verdict.first_difference {
            self.different += 1;
            *self.kinds.entry(difference.what.clone()).or_default() += 1;
            let EnvironmentId { kitchen, number } = verdict.environment;
            let place = (kitchen.number(), number, verdict.episode, difference.clone());
            self.first = self.first.take().into_iter().chain([place]).min();
        }
    }

    /// Of so many episodes. `frames`: where they are drawn, so many moments.
    fn progress(&self, total: usize, frames: Option<usize>, elapsed_s: f64) -> String {
        let Self { episodes, compared, different, drawn, .. } = self;
        if let Some(frames) = frames {
            return format!(
                "drawn {episodes} of {total} episodes, {drawn} of {frames} frames, {elapsed_s:.0} s, {different} differences"
            );
        }
        let rate = *compared as f64 / elapsed_s.max(1e-3);
        format!(
            "replayed {episodes} of {total} episodes, {compared} states, {rate:.0} a second, {different} differences"
        )
    }

    pub fn merge(&mut self, other: Self) {
        self.episodes += other.episodes;
        self.compared += other.compared;
        self.images += other.images;
        self.drawn += other.drawn;
        self.different += other.different;
        self.first = [self.first.take(), other.first].into_iter().flatten().min();
        for (kind, count) in other.kinds {
            *self.kinds.entry(kind).or_default() += count;
        }
    }
}

enum Report {
    Line(ReplayLine),
    Ended(usize, Result<()>),
}

pub fn simulate(setup: &ReplaySetup, episodes: Vec<RecordedEpisode>) -> Result<Totals> {
    let total = episodes.len();
    let frames = setup.images.as_ref().map(|_| episodes.iter().map(|episode| episode.hashes.len() + 1).sum());
    let deadline = if setup.images.is_some() { DRAWING_DEADLINE } else { SILENCE_DEADLINE };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let (reports, inbox) = channel();
    let mut actors = Actors(Vec::new());
    for (number, share) in divide(episodes, cores).into_iter().enumerate() {
        actors.start(number, setup, share, &reports)?;
    }
    drop(reports);

    let mut totals = Totals::default();
    let mut running = actors.0.len();
    let (mut live, began) = (Live::default(), Instant::now());
    // The first line is not due before there is something to say.
    live.is_due(Duration::ZERO);
    let mut last_answer = began;
    while running > 0 {
        match inbox.recv_timeout(PROGRESS_INTERVAL) {
            Ok(Report::Line(line)) => {
                match line {
                    ReplayLine::Verdict(verdict) => {
                        totals.add(&verdict);
                        if let Some(film) = &verdict.film {
                            terminal::note(&format!("drawn: {film}"));
                        }
                    }
                    ReplayLine::Drawn { drawn } => totals.drawn += drawn,
                }
                last_answer = Instant::now();
            }
            Ok(Report::Ended(number, outcome)) => {
                running -= 1;
                last_answer = Instant::now();
                // The process's exit status explains more than its truncated output.
                actors.reap(number)?;
                outcome?;
            }
            Err(RecvTimeoutError::Timeout) => {
                ensure!(
                    last_answer.elapsed() < deadline,
                    "no actor has answered for {} s: giving up",
                    deadline.as_secs()
                );
            }
            Err(RecvTimeoutError::Disconnected) => bail!("an actor's reader ended without a result"),
        }
        if live.is_due(began.elapsed()) {
            live.show(totals.progress(total, frames, began.elapsed().as_secs_f64()));
        }
    }
    live.clear();
    Ok(totals)
}

fn replayer(setup: &ReplaySetup) -> Result<Command> {
    let config = Config::from_toml(&setup.config, "the configuration of the recording")?;
    let Some(environment) = &config.environment else {
        let mut command = Command::new(programs::find("actor")?);
        command.arg("replay");
        return Ok(command);
    };
    environment::demand(&config, Path::new(setup.folder.as_deref().unwrap_or("RUN")))?;
    let mut command = environment.program();
    command.arg("--replay").stderr(Stdio::piped());
    Ok(command)
}

/// Passes on what a process says but for the sentence that it ends with, which comes back.
fn overheard(number: usize, errors: ChildStderr) -> Result<Receiver<String>> {
    let (said, problem) = channel();
    std::thread::Builder::new().name(format!("replay-{number}-err")).spawn(move || {
        for line in BufReader::new(errors).split(b'\n').map_while(std::io::Result::ok) {
            let line = String::from_utf8_lossy(&line);
            match line.strip_prefix(ERROR) {
                // Where another process has failed before, nothing receives it.
                Some(sentence) => drop(said.send(printable(sentence).into_owned())),
                None => terminal::note(&line),
            }
        }
    })?;
    Ok(problem)
}

fn divide(episodes: Vec<RecordedEpisode>, shares: usize) -> Vec<Vec<RecordedEpisode>> {
    let mut kitchens: BTreeMap<KitchenId, Vec<RecordedEpisode>> = BTreeMap::new();
    for episode in episodes {
        kitchens.entry(episode.environment.kitchen).or_default().push(episode);
    }
    let mut kitchens: Vec<(usize, Vec<RecordedEpisode>)> = kitchens
        .into_values()
        .map(|episodes| (episodes.iter().map(|episode| episode.hashes.len() + 1).sum(), episodes))
        .collect();
    // The largest first, each to the smallest share so far. Stable, so the same files are always divided alike.
    kitchens.sort_by_key(|(steps, _)| std::cmp::Reverse(*steps));
    let mut divided: Vec<(usize, Vec<RecordedEpisode>)> = vec![(0, Vec::new()); shares.min(kitchens.len())];
    for (steps, episodes) in kitchens {
        let share = divided.iter_mut().min_by_key(|(steps, _)| *steps).expect("there is a share for any kitchen");
        share.0 += steps;
        share.1.extend(episodes);
    }
    divided.into_iter().map(|(_, episodes)| episodes).collect()
}

/// A process that is killed and reaped when this is dropped, if it still runs then.
pub(super) struct Actor(pub Child);

impl Drop for Actor {
    fn drop(&mut self) {
        if let Ok(None) = self.0.try_wait() {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }
}

/// With the sentence that a process of the user's environment ends with.
struct Actors(Vec<(Actor, Option<Receiver<String>>)>);

impl Actors {
    fn start(
        &mut self,
        number: usize,
        setup: &ReplaySetup,
        share: Vec<RecordedEpisode>,
        reports: &Sender<Report>,
    ) -> Result<()> {
        let mut command = replayer(setup)?;
        let program = command.get_program().to_owned();
        let started = command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = started.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        let problem = child.stderr.take().map(|errors| overheard(number, errors)).transpose()?;
        let input = child.stdin.take().context("the actor has no standard input")?;
        let output = child.stdout.take().context("the actor has no standard output")?;
        self.0.push((Actor(child), problem));
        let expected: Vec<_> = share.iter().map(|episode| (episode.environment, episode.episode)).collect();
        let setup = setup.clone();
        // Reading and writing on threads of their own: neither pipe can fill up while we wait on the other.
        std::thread::Builder::new().name(format!("replay-{number}-in")).spawn(move || feed(input, &setup, &share))?;
        let reports = reports.clone();
        std::thread::Builder::new().name(format!("replay-{number}-out")).spawn(move || {
            let outcome = listen(output, &expected, &reports);
            // Nobody listens any more once another actor has failed.
            let _ = reports.send(Report::Ended(number, outcome));
        })?;
        Ok(())
    }

    fn reap(&mut self, number: usize) -> Result<()> {
        let (actor, problem) = &mut self.0[number];
        match wait_for_child(&mut actor.0, EXIT_DEADLINE).context("cannot wait for an actor")? {
            Some(status) if status.success() => Ok(()),
            Some(status) => {
                // What it has left behind may hold the pipe.
                let said = problem.as_ref().and_then(|problem| problem.recv_timeout(PROGRESS_INTERVAL).ok());
                let problem =
                    said.unwrap_or_else(|| format!("`actor replay` {}; its last messages are above", how(status)));
                bail!("{problem}")
            }
            None => bail!("an actor closed its output but did not exit"),
        }
    }
}

/// Writes the work to an actor. The reader reports a broken pipe, because it sees how the actor ended.
pub(super) fn feed(input: ChildStdin, setup: &impl Serialize, share: &[impl Serialize]) {
    let mut input = BufWriter::new(input);
    let mut write = || -> std::io::Result<()> {
        serde_json::to_writer(&mut input, setup)?;
        input.write_all(b"\n")?;
        for each in share {
            serde_json::to_writer(&mut input, each)?;
            input.write_all(b"\n")?;
        }
        input.flush()
    };
    if let Err(error) = write()
        && error.kind() != ErrorKind::BrokenPipe
    {
        tracing::error!("cannot write to an actor: {error}");
    }
}

fn listen(output: ChildStdout, expected: &[(EnvironmentId, u32)], reports: &Sender<Report>) -> Result<()> {
    let mut answered = 0;
    for line in BufReader::new(output).lines() {
        let line = line.context("cannot read from an actor")?;
        let line: ReplayLine = serde_json::from_str(&line)
            .with_context(|| format!("an actor printed a line that is no verdict: {line}"))?;
        if let ReplayLine::Verdict(verdict) = &line {
            let asked = expected.get(answered);
            ensure!(
                asked == Some(&(verdict.environment, verdict.episode)),
                "an actor answered for another episode than it was asked"
            );
            answered += 1;
        }
        reports.send(Report::Line(line)).map_err(|_| anyhow!("replay was given up"))?;
    }
    ensure!(answered == expected.len(), "an actor answered {answered} of {} episodes", expected.len());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(kitchen: u32, episode: u32, steps: usize) -> RecordedEpisode {
        RecordedEpisode {
            environment: EnvironmentId { kitchen: KitchenId::new(kitchen).unwrap(), number: 0 },
            episode,
            start_hash: None,
            actions: vec![0; steps],
            hashes: vec![0; steps],
            digests: Vec::new(),
            start: Vec::new(),
        }
    }

    #[test]
    fn work_is_divided_by_kitchen_and_evenly() {
        let episodes = vec![episode(1, 0, 100), episode(3, 0, 60), episode(4, 0, 50), episode(1, 1, 10)];
        let shares = divide(episodes, 2);
        let kitchens: Vec<Vec<u32>> = shares
            .iter()
            .map(|share| share.iter().map(|episode| episode.environment.kitchen.number()).collect())
            .collect();
        assert_eq!(kitchens, [vec![1, 1], vec![3, 4]]);
        assert_eq!(divide(vec![episode(1, 0, 3)], 8).len(), 1);
    }

    #[test]
    fn frames_are_counted_while_an_episode_is_drawn() {
        let totals = Totals { episodes: 1, compared: 52, drawn: 83, ..Totals::default() };
        let expected = "drawn 1 of 4 episodes, 83 of 208 frames, 36 s, 0 differences";
        assert_eq!(totals.progress(4, Some(208), 36.2), expected);
        let expected = "replayed 1 of 4 episodes, 52 states, 26 a second, 0 differences";
        assert_eq!(totals.progress(4, None, 2.0), expected);
    }

    #[test]
    fn the_first_difference_is_the_first_in_order_not_in_time() {
        let mut totals = Totals::default();
        let reward_at = |step| Difference { step, what: "reward_r".to_owned() };
        let verdict = |kitchen: u32, difference: Option<u64>| ReplayVerdict {
            environment: EnvironmentId { kitchen: KitchenId::new(kitchen).unwrap(), number: 1 },
            episode: 2,
            compared: 3,
            first_difference: difference.map(reward_at),
            images: 0,
            film: None,
        };
        for (kitchen, difference) in [(9, Some(1)), (3, Some(2)), (1, None)] {
            totals.add(&verdict(kitchen, difference));
        }
        assert_eq!((totals.different, totals.first.clone()), (2, Some((3, 1, 2, reward_at(2)))));
        let mut other = Totals::default();
        other.add(&verdict(2, Some(7)));
        totals.merge(other);
        assert_eq!((totals.episodes, totals.compared, totals.different), (4, 12, 3));
        assert_eq!(totals.first, Some((2, 1, 2, reward_at(7))));
        assert_eq!(totals.kinds, BTreeMap::from([("reward_r".to_owned(), 3)]));
    }
}
