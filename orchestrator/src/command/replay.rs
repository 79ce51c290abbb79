//! `orchestrator replay`: proves a recording by simulating it again.
//!
//! The simulator is bit-identical for the same (kitchen, episode, actions). So every recorded episode is handed to
//! `actor replay`, which takes the actions again and compares the hash of every state on the way, and draws what the
//! camera saw where that is asked for. The work is divided by kitchen over as many actors as there are cores.

use crate::recording::episodes::{Recorded, Wanted, gather};
use crate::recording::files_at;
use crate::terminal;
use anyhow::{Context, Result, anyhow, bail, ensure};
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::replay::{ImageFormat, RecordedEpisode, ReplayImages, ReplaySetup, ReplayVerdict};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, BufWriter, ErrorKind, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::str::FromStr;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

/// An actor that says nothing for so long hangs: an episode takes well under a second, the first also builds its
/// kitchen.
const SILENCE_DEADLINE: Duration = Duration::from_mins(5);
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);
const PROGRESS_LINE_INTERVAL: Duration = Duration::from_secs(10);

/// Simulate recorded episodes again: compare every state, draw depth images if asked.
#[derive(Debug, clap::Args)]
pub struct ReplayArgs {
    /// Recordings (.mcap), or a run folder: all its recordings.
    #[arg(required = true, value_name = "FILE|RUN")]
    paths: Vec<PathBuf>,
    /// Write depth images into this folder.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// png: a 16-bit picture (millimetres) a frame; video: an animated PNG an episode, near is bright.
    #[arg(long, default_value = "png", requires = "images")]
    format: Format,
    /// Width and height of the images in pixels.
    #[arg(long, default_value_t = 224, value_parser = clap::value_parser!(u32).range(8..=4096), requires = "images")]
    side: u32,
    /// Only this environment: kitchen number and environment number within the kitchen.
    #[arg(long, value_name = "K/N")]
    environment: Option<EnvironmentChoice>,
    /// Only episodes of this number.
    #[arg(long, value_name = "I")]
    episode: Option<u32>,
    /// At most this many episodes.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    limit: Option<u64>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Format {
    Png,
    Video,
}

#[derive(Debug, Clone, Copy)]
struct EnvironmentChoice(EnvironmentId);

impl FromStr for EnvironmentChoice {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not an environment (expected e.g. 1/0: kitchen 1, environment 0)");
        let (kitchen, number) = text.split_once('/').ok_or_else(wrong)?;
        let kitchen = KitchenId::new(kitchen.parse().map_err(|_| wrong())?).map_err(|error| error.to_string())?;
        Ok(Self(EnvironmentId { kitchen, number: number.parse().map_err(|_| wrong())? }))
    }
}

/// Runs the command. An error if any state differs from the recording.
pub fn run(args: &ReplayArgs) -> Result<()> {
    let mut files = Vec::new();
    for path in &args.paths {
        files.extend(files_at(path)?);
    }
    let wanted = Wanted { environment: args.environment.map(|choice| choice.0), episode: args.episode };
    let Recorded { config, mut episodes, headless, broken, steps, complaints } = gather(&files, wanted)?;
    for complaint in complaints {
        tracing::warn!("{complaint}");
    }
    if headless > 0 {
        tracing::warn!("{headless} episodes begin before these recordings and are left out");
    }
    if broken > 0 {
        tracing::warn!("{broken} episodes have a hole in the recording and are replayed up to it");
    }
    if let Some(limit) = args.limit {
        episodes.truncate(usize::try_from(limit).unwrap_or(usize::MAX));
    }
    ensure!(
        !episodes.is_empty(),
        "there is no such episode in {} with {steps} steps",
        if files.len() == 1 { files[0].display().to_string() } else { format!("{} recordings", files.len()) }
    );

    let images = args.images.as_ref().map(|folder| -> Result<ReplayImages> {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        // The actors run elsewhere; a relative folder is the user's.
        let folder = std::path::absolute(folder)?;
        Ok(ReplayImages {
            folder: folder.to_str().context("the folder of images has a name that is not text")?.to_owned(),
            format: match args.format {
                Format::Png => ImageFormat::Png,
                Format::Video => ImageFormat::Video,
            },
            side: args.side,
        })
    });
    let setup = ReplaySetup { config, images: images.transpose()? };
    let totals = simulate(&setup, episodes)?;

    terminal::out(&format!("episodes: {}", totals.episodes));
    terminal::out(&format!("states compared: {}", totals.compared));
    if let Some(images) = &setup.images {
        terminal::out(&format!("images: {} in {}", totals.images, images.folder));
    }
    terminal::out(&format!("differences: {}", totals.different));
    match totals.first {
        None => Ok(()),
        Some((kitchen, environment, episode, step)) => bail!(
            "the simulation differs from the recording, first in kitchen {kitchen}, environment {environment}, episode \
             {episode}, step {step}"
        ),
    }
}

#[derive(Debug, Default)]
struct Totals {
    episodes: u64,
    compared: u64,
    images: u64,
    /// Episodes with a difference.
    different: u64,
    /// Kitchen, environment, episode, step of the first one, in that order.
    first: Option<(u8, u32, u32, u64)>,
}

impl Totals {
    fn add(&mut self, verdict: &ReplayVerdict) {
        self.episodes += 1;
        self.compared += verdict.compared;
        self.images += verdict.images;
        if let Some(step) = verdict.first_difference {
            self.different += 1;
            let EnvironmentId { kitchen, number } = verdict.environment;
            let place = (kitchen.number(), number, verdict.episode, step);
            self.first = Some(self.first.map_or(place, |first| first.min(place)));
        }
    }
}

/// What comes back from an actor's reader.
enum Report {
    Verdict(Box<ReplayVerdict>),
    /// Its output has ended, after all verdicts or not.
    Ended(usize, Result<()>),
}

fn simulate(setup: &ReplaySetup, episodes: Vec<RecordedEpisode>) -> Result<Totals> {
    let total = episodes.len();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let (reports, inbox) = channel();
    let mut actors = Actors(Vec::new());
    for (number, share) in divide(episodes, cores).into_iter().enumerate() {
        actors.start(number, setup, share, &reports)?;
    }
    drop(reports);

    let mut totals = Totals::default();
    let mut running = actors.0.len();
    let mut progress = Progress::new(total);
    let mut heard = Instant::now();
    while running > 0 {
        match inbox.recv_timeout(PROGRESS_INTERVAL) {
            Ok(Report::Verdict(verdict)) => {
                totals.add(&verdict);
                heard = Instant::now();
            }
            Ok(Report::Ended(number, outcome)) => {
                running -= 1;
                heard = Instant::now();
                // How the process ended says more than what its output lacks.
                actors.reap(number)?;
                outcome?;
            }
            Err(RecvTimeoutError::Timeout) => {
                ensure!(
                    heard.elapsed() < SILENCE_DEADLINE,
                    "no actor has answered for {} s: giving up",
                    SILENCE_DEADLINE.as_secs()
                );
            }
            Err(RecvTimeoutError::Disconnected) => bail!("an actor's reader ended without a word"),
        }
        progress.show(&totals);
    }
    progress.clear();
    Ok(totals)
}

/// Divides episodes by kitchen into at most `shares` shares of about as many steps each.
fn divide(episodes: Vec<RecordedEpisode>, shares: usize) -> Vec<Vec<RecordedEpisode>> {
    let mut kitchens: BTreeMap<KitchenId, Vec<RecordedEpisode>> = BTreeMap::new();
    for episode in episodes {
        kitchens.entry(episode.environment.kitchen).or_default().push(episode);
    }
    let mut kitchens: Vec<(usize, Vec<RecordedEpisode>)> = kitchens
        .into_values()
        .map(|episodes| (episodes.iter().map(|episode| episode.actions.len() + 1).sum(), episodes))
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

/// The actors at work; those that still run when this is dropped are killed and reaped.
struct Actors(Vec<Child>);

impl Actors {
    fn start(
        &mut self,
        number: usize,
        setup: &ReplaySetup,
        share: Vec<RecordedEpisode>,
        reports: &Sender<Report>,
    ) -> Result<()> {
        let program = std::env::current_exe().context("cannot find this program's folder")?.with_file_name("actor");
        let mut child = Command::new(&program)
            .arg("replay")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {}", program.display()))?;
        let input = child.stdin.take().context("the actor has no standard input")?;
        let output = child.stdout.take().context("the actor has no standard output")?;
        self.0.push(child);
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
        let child = &mut self.0[number];
        let deadline = Instant::now() + Duration::from_secs(10);
        loop {
            match child.try_wait().context("cannot wait for an actor")? {
                Some(status) if status.success() => return Ok(()),
                Some(status) => bail!("the actor that replays ended with {status}; its last words are above"),
                None if Instant::now() > deadline => bail!("an actor closed its output but did not exit"),
                None => std::thread::sleep(Duration::from_millis(5)),
            }
        }
    }
}

impl Drop for Actors {
    fn drop(&mut self) {
        for child in &mut self.0 {
            if let Ok(None) = child.try_wait() {
                let _ = child.kill();
                let _ = child.wait();
            }
        }
    }
}

/// Writes the work to an actor. A broken pipe is the reader's to report: it knows how the actor ended.
fn feed(input: ChildStdin, setup: &ReplaySetup, share: &[RecordedEpisode]) {
    let mut input = BufWriter::new(input);
    let mut write = || -> std::io::Result<()> {
        serde_json::to_writer(&mut input, setup)?;
        input.write_all(b"\n")?;
        for episode in share {
            serde_json::to_writer(&mut input, episode)?;
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

/// Reads verdicts until the output ends; they must be those that were asked for.
fn listen(output: ChildStdout, expected: &[(EnvironmentId, u32)], reports: &Sender<Report>) -> Result<()> {
    let mut answered = 0;
    for line in BufReader::new(output).lines() {
        let line = line.context("cannot read from an actor")?;
        let verdict: ReplayVerdict =
            serde_json::from_str(&line).with_context(|| format!("an actor said what is no verdict: {line}"))?;
        let asked = expected.get(answered);
        ensure!(
            asked == Some(&(verdict.environment, verdict.episode)),
            "an actor answered for another episode than it was asked"
        );
        answered += 1;
        reports.send(Report::Verdict(Box::new(verdict))).map_err(|_| anyhow!("replay was given up"))?;
    }
    ensure!(answered == expected.len(), "an actor answered {answered} of {} episodes", expected.len());
    Ok(())
}

/// What the user sees meanwhile: a line that is refreshed, or one now and then where that cannot be.
struct Progress {
    total: usize,
    started: Instant,
    shown: Instant,
    interactive: bool,
}

impl Progress {
    fn new(total: usize) -> Self {
        let now = Instant::now();
        Self { total, started: now, shown: now, interactive: terminal::interactive() }
    }

    fn show(&mut self, totals: &Totals) {
        let interval = if self.interactive { PROGRESS_INTERVAL } else { PROGRESS_LINE_INTERVAL };
        if self.shown.elapsed() < interval {
            return;
        }
        self.shown = Instant::now();
        let rate = totals.compared as f64 / self.started.elapsed().as_secs_f64().max(1e-3);
        let line = format!(
            "replayed {} of {} episodes, {} states, {rate:.0} a second, {} differences",
            totals.episodes, self.total, totals.compared, totals.different
        );
        if self.interactive {
            terminal::progress(vec![line]);
        } else {
            terminal::note(&line);
        }
    }

    fn clear(&self) {
        if self.interactive {
            terminal::progress(Vec::new());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(kitchen: u8, episode: u32, steps: usize) -> RecordedEpisode {
        RecordedEpisode {
            environment: EnvironmentId { kitchen: KitchenId::new(kitchen).unwrap(), number: 0 },
            episode,
            start_hash: None,
            actions: vec![0; steps],
            hashes: vec![0; steps],
        }
    }

    #[test]
    fn work_is_divided_by_kitchen_and_evenly() {
        let episodes = vec![episode(1, 0, 100), episode(3, 0, 60), episode(4, 0, 50), episode(1, 1, 10)];
        let shares = divide(episodes, 2);
        let kitchens: Vec<Vec<u8>> = shares
            .iter()
            .map(|share| share.iter().map(|episode| episode.environment.kitchen.number()).collect())
            .collect();
        assert_eq!(kitchens, [vec![1, 1], vec![3, 4]]);
        assert_eq!(divide(vec![episode(1, 0, 3)], 8).len(), 1);
    }

    #[test]
    fn the_first_difference_is_the_first_in_order_not_in_time() {
        let mut totals = Totals::default();
        let verdict = |kitchen: u8, first_difference| ReplayVerdict {
            environment: EnvironmentId { kitchen: KitchenId::new(kitchen).unwrap(), number: 1 },
            episode: 2,
            compared: 3,
            first_difference,
            images: 0,
        };
        for (kitchen, difference) in [(9, Some(1)), (3, Some(2)), (1, None)] {
            totals.add(&verdict(kitchen, difference));
        }
        assert_eq!((totals.different, totals.first), (2, Some((3, 1, 2, 2))));
    }

    #[test]
    fn environments_are_named_kitchen_slash_number() {
        let EnvironmentChoice(id) = "13/2".parse().unwrap();
        assert_eq!((id.kitchen.number(), id.number), (13, 2));
        assert!("28/0".parse::<EnvironmentChoice>().unwrap_err().contains("no kitchen 28"));
        assert!("3".parse::<EnvironmentChoice>().unwrap_err().contains("expected e.g. 1/0"));
    }
}
