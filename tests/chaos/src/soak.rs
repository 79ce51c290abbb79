//! A soak: one long run with a fault now and then, whose processes are measured. What must not grow does not.
//!
//! A slope is the least-squares line through the samples of a process's life, pooled over all lives of processes of the
//! same name: a restart moves the level and not the slope. The first minute of a life is left out.

use crate::case_folder::{CaseFolder, Medium, Start};
use crate::draw::Draw;
use crate::fault::Who;
use crate::leftovers;
use crate::processes::{find, of_folder, signal};
use crate::session::{Session, wait_for_end};
use crate::slope::Slope;
use anyhow::{Context, Result, ensure};
use proto::run_folder::RunFolder;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;
use std::time::{Duration, Instant};
use system_tests::Run;
use system_tests::recording::steps_that_count;

/// Between two samples.
const SAMPLE: Duration = Duration::from_secs(5);
/// Of a life; then buffers have their size.
const WARM_UP: Duration = Duration::from_mins(1);
/// Between two faults: growth can be told from warming up only in lives that are much longer than a minute.
const FAULT_S: RangeInclusive<u64> = 300..=900;
/// No run of the soak's length has so many.
const FRAMES: u64 = 1_000_000_000;
/// What a process may grow by in an hour, beyond what the samples' scatter explains.
const GROWTH_MAX_MIB: f64 = 8.0;
const DESCRIPTORS_MAX: f64 = 1.0;
const MIB: f64 = (1 << 20) as f64;

/// Let a long run meet a fault now and then, and print how its processes and files grow
///
/// The exit status is 0 if no process grows, every step is recorded, files are within what `orchestrator doctor`
/// foretells, and nothing is left behind.
#[derive(Debug, Clone, clap::Args)]
pub struct Soak {
    /// How long
    #[arg(long, default_value_t = 120)]
    minutes: u64,
    /// Seed of what happens
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Learners
    #[arg(long, default_value_t = 1)]
    learners: u32,
}

/// Of one process: its number, the name it goes under, and the slopes of its memory and descriptors.
#[derive(Default)]
struct Life {
    name: String,
    begun: Option<Instant>,
    memory: Slope,
    descriptors: Slope,
}

struct Watch<'a> {
    soak: &'a Soak,
    place: &'a CaseFolder,
    folder: RunFolder,
    draw: Draw,
    begun: Instant,
    lives: BTreeMap<u32, Life>,
    /// Of /dev/shm, this run's files.
    shared: Slope,
    next_sample: Instant,
    next_fault: Instant,
    faults: u64,
}

impl Soak {
    /// Runs it; whether all is as it should be.
    pub fn run(&self) -> Result<bool> {
        let temporary = tempfile::Builder::new().prefix("soak-").tempdir().context("a temporary folder")?;
        let place = CaseFolder::new(temporary.path().join("soak"), Medium::Shared, false)?;
        let now = Instant::now();
        let mut watch = Watch {
            soak: self,
            folder: RunFolder::new(place.path("run")),
            place: &place,
            draw: Draw::new(self.seed, u32::MAX),
            begun: now,
            lives: BTreeMap::new(),
            shared: Slope::default(),
            next_sample: now,
            next_fault: now + Duration::from_secs(30),
            faults: 0,
        };
        println!("a soak of {} minutes, seed {}, in {}", self.minutes, self.seed, temporary.path().display());
        let is_good = watch.go()?;
        if !is_good {
            println!("files: {}", temporary.keep().display());
        }
        Ok(is_good)
    }
}

impl Watch<'_> {
    fn go(&mut self) -> Result<bool> {
        let mut starts = 0;
        while !self.is_over() {
            starts += 1;
            self.start(starts)?;
            ensure!(starts < 20 + self.soak.minutes as usize, "too many starts");
        }
        wait_for_end(self.folder.root())?;
        self.report(starts)
    }

    fn is_over(&self) -> bool {
        self.begun.elapsed() >= Duration::from_mins(self.soak.minutes)
    }

    /// One start of the orchestrator, until it ends or the time is over.
    fn start(&mut self, number: usize) -> Result<()> {
        let folder = self.folder.root().display().to_string();
        let (learners, frames) = (self.soak.learners.to_string(), FRAMES.to_string());
        let mut arguments = vec!["resume", &folder];
        if !self.folder.identity().exists() {
            let words = "up --preset demo --seed 1 --actors 2 --set learner.threads=1 --set checkpoint.interval_s=10";
            arguments = words.split(' ').chain(["--set", "recording.segment_bytes=8388608"]).collect();
            arguments.extend(["--run", &folder, "--learners", &learners, "--frames", &frames]);
        }
        let mut session = Session::start(self.place, format!("start-{number:03}"), &arguments, &Start::default())?;
        session.unlimited();
        let first = session.pid();
        while session.runs()? {
            let now = Instant::now();
            if self.is_over() {
                signal(first, Signal::INT);
                session.must_end();
                break;
            }
            if now >= self.next_sample {
                self.next_sample = now + SAMPLE;
                self.sample(first)?;
            }
            if now >= self.next_fault {
                self.next_fault = now + Duration::from_secs(self.draw.within(FAULT_S));
                self.disturb(first);
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        let ended = session.wait()?;
        let expected = ended.status.success() || ended.signal() == Some(9);
        ensure!(expected, "it failed: {}", ended.last_words());
        Ok(())
    }

    fn disturb(&mut self, first: u32) {
        let learner = Who::Learner(self.draw.within(0..=u64::from(self.soak.learners) - 1) as u32);
        let actor = Who::Actor(self.draw.within(0..=1) as u32);
        let choices = [
            (6, (actor, Signal::KILL)),
            (3, (learner, Signal::KILL)),
            (1, (Who::Orchestrator, Signal::KILL)),
            (1, (Who::Orchestrator, Signal::INT)),
            (2, (actor, Signal::STOP)),
            (2, (learner, Signal::STOP)),
            (1, (Who::Orchestrator, Signal::STOP)),
        ];
        let (who, how) = self.draw.weighed(&choices);
        let Some(pid) = find(who, self.folder.root(), first) else { return };
        if signal(pid, how) {
            self.faults += 1;
            if how == Signal::STOP {
                std::thread::sleep(Duration::from_millis(self.draw.within(100..=2000)));
                signal(pid, Signal::CONT);
            }
        }
    }

    fn sample(&mut self, first: u32) -> Result<()> {
        let now = Instant::now();
        let hours = self.begun.elapsed().as_secs_f64() / 3600.0;
        let mut seen = of_folder(self.folder.root());
        seen.retain(|one| one.pid == first || one.line.contains("/learner ") || one.line.contains("/actor "));
        for one in seen {
            let life = self.lives.entry(one.pid).or_default();
            life.name = one.name();
            let begun = *life.begun.get_or_insert(now);
            // One that has just ended has no figures.
            let (Some(memory), Some(descriptors)) = (memory_bytes(one.pid), descriptors(one.pid)) else { continue };
            if now - begun >= WARM_UP {
                life.memory.add(hours, memory as f64 / MIB);
                life.descriptors.add(hours, descriptors as f64);
            }
        }
        self.shared.add(hours, shared_bytes(&self.folder)? as f64 / MIB);
        Ok(())
    }

    fn report(&self, starts: usize) -> Result<bool> {
        let hours = self.begun.elapsed().as_secs_f64() / 3600.0;
        let mut is_good = true;
        println!("{:.1} minutes, {} faults, {starts} starts", hours * 60.0, self.faults);
        let mut names: Vec<&str> = self.lives.values().map(|life| life.name.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        for name in names {
            let lives: Vec<&Life> = self.lives.values().filter(|life| life.name == name).collect();
            let memory = Slope::pooled(lives.iter().map(|life| &life.memory));
            let descriptors = Slope::pooled(lives.iter().map(|life| &life.descriptors));
            println!("{name:14} {:3} lives  memory {memory} MiB  descriptors {descriptors}", lives.len());
            is_good &= !memory.exceeds(GROWTH_MAX_MIB) && !descriptors.exceeds(DESCRIPTORS_MAX);
        }
        println!("/dev/shm       {} MiB", self.shared.line());
        is_good &= self.disk(hours)?;
        let left = leftovers::of_run(&self.folder)?;
        if !left.is_empty() {
            println!("left behind: {left:?}");
            is_good = false;
        }
        println!("{}", if is_good { "good: nothing grows that should not" } else { "NOT GOOD" });
        Ok(is_good)
    }

    /// Files against what doctor foretells for as many frames.
    fn disk(&self, hours: f64) -> Result<bool> {
        let trained = last_frames(&self.folder);
        let recorded = steps_that_count(&Run { folder: self.folder.clone() })?;
        let size = |path: &Path| bytes_under(path).map(|bytes| bytes as f64);
        let checkpoints = size(&self.folder.checkpoints())?;
        let recordings = size(&self.folder.recordings())?;
        let metrics = std::fs::metadata(self.folder.metrics())?.len() as f64;
        let logs = size(&self.folder.logs())?;
        let [checkpoints_told, recordings_told] = self.foretold(trained)?;
        let mib = |bytes: f64| bytes / MIB;
        println!("frames         {trained} trained, {recorded} steps recorded, {:.0} frames/h", trained as f64 / hours);
        println!("checkpoints    {:.1} MiB, foretold at most {:.1}", mib(checkpoints), mib(checkpoints_told));
        println!("recordings     {:.1} MiB, foretold {:.1}", mib(recordings), mib(recordings_told));
        println!(
            "metrics.jsonl  {:.2} MiB, logs {:.2} MiB: {:.1} MiB/h",
            mib(metrics),
            mib(logs),
            mib(metrics + logs) / hours
        );
        Ok(recorded >= trained && checkpoints <= checkpoints_told && recordings <= recordings_told)
    }

    /// What doctor says that checkpoints and recordings of so many frames take, bytes.
    fn foretold(&self, frames: u64) -> Result<[f64; 2]> {
        let frames = frames.to_string();
        let folder = self.place.path("elsewhere").display().to_string();
        let arguments =
            ["doctor", "--json", "--preset", "demo", "--actors", "2", "--frames", &frames, "--run", &folder];
        let ended = Session::start(self.place, "doctor".to_owned(), &arguments, &Start::default())?.wait()?;
        let value: serde_json::Value = serde_json::from_str(&ended.stdout).context("doctor --json")?;
        let checks = value["checks"].as_array().context("doctor's checks")?;
        let disk = checks.iter().find(|check| check["name"] == "disk").context("doctor's line on the disk")?;
        foretold(disk["text"].as_str().unwrap_or_default())
    }
}

/// The two sizes in doctor's line on the disk.
fn foretold(text: &str) -> Result<[f64; 2]> {
    let after = |words: &str| {
        let rest = text.split_once(words)?.1;
        let (number, rest) = rest.split_once(' ')?;
        let unit = rest.split([',', ';', ' ']).next()?;
        let power = ["bytes", "KiB", "MiB", "GiB", "TiB"].iter().position(|name| *name == unit)?;
        Some(number.parse::<f64>().ok()? * 1024_f64.powi(power as i32))
    };
    let both = after("checkpoints take up to ").zip(after("recordings about "));
    let (checkpoints, recordings) = both.with_context(|| format!("doctor says of the disk: {text}"))?;
    Ok([checkpoints, recordings])
}

/// Memory of a process that is its own: without what it shares with the others.
fn memory_bytes(pid: u32) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    Some(line.trim().split(' ').next()?.parse::<u64>().ok()? << 10)
}

fn descriptors(pid: u32) -> Option<usize> {
    Some(std::fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count())
}

fn shared_bytes(folder: &RunFolder) -> Result<u64> {
    use std::os::unix::fs::MetadataExt;
    let Some(id) = folder.id() else { return Ok(0) };
    let names = leftovers::of_id(&id)?;
    let in_memory = names.iter().filter(|name| name.starts_with(wire::SHARED_MEMORY));
    Ok(in_memory.filter_map(|name| Some(std::fs::metadata(name).ok()?.blocks() * 512)).sum())
}

fn bytes_under(folder: &Path) -> Result<u64> {
    let mut sum = 0;
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        sum += entry?.metadata()?.len();
    }
    Ok(sum)
}

fn last_frames(folder: &RunFolder) -> u64 {
    let text = std::fs::read_to_string(folder.metrics()).unwrap_or_default();
    let last = text.lines().rev().find_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    last.and_then(|line| line["frames"].as_u64()).unwrap_or(0)
}
