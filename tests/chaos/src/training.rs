//! A run that trains: started, disturbed, resumed until it is complete.

use crate::case_folder::{CaseFolder, Start};
use crate::fault::{Case, Fate, Fault, Phase, Planned};
use crate::inject::{carry_out, damage};
use crate::judge::explain;
use crate::leftovers;
use crate::privileges::Privileges;
use crate::processes::signal;
use crate::run_kind::RunKind;
use crate::session::{Ended, Session, wait_for_end};
use crate::tally::Tally;
use anyhow::{Result, ensure};
use proto::exit::EXIT_INCOMPLETE;
use proto::run_folder::RunFolder;
use rustix::process::Signal;
use std::collections::{BTreeSet, VecDeque};
use std::path::Path;
use std::time::{Duration, Instant};
use system_tests::{Evidence, Run};

/// A run that is not complete after so many starts gets nowhere.
const STARTS_MAX: usize = 20;

pub struct Complete {
    pub evidence: Evidence,
    /// Digest of its weights and number of frames, as printed.
    pub result: (String, u64),
    /// What `orchestrator replay` printed of its recordings, and how it failed, if it did.
    pub replay: String,
    pub starts: usize,
    /// Damaged files that no start complained of.
    pub unsaid: Vec<String>,
    /// What it left behind in memory.
    pub left: Vec<String>,
}

struct Training<'a> {
    shape: RunKind,
    place: &'a CaseFolder,
    folder: RunFolder,
    plan: VecDeque<Planned>,
    privileges: Privileges,
    /// Rollouts trained at some time.
    reached: u64,
    /// With the next start.
    start: Start,
    /// What has happened in this start, and what is armed in it.
    recent: Vec<Fault>,
    armed: Option<Fault>,
    /// Damaged files that no start has complained of since.
    unsaid: Vec<String>,
    /// Checkpoints that a full disk kept from being written.
    unwritten: BTreeSet<String>,
}

/// Runs a case to its end and reads what it left. What happened on the way is counted in `tally`.
pub fn train(case: &Case, place: &CaseFolder, privileges: Privileges, tally: &mut Tally) -> Result<Complete> {
    let shape = case.shape;
    std::fs::write(place.path("config.toml"), shape.config())?;
    if let Some(disk) = place.disk() {
        disk.settle()?;
    }
    let mut training = Training {
        shape,
        place,
        folder: RunFolder::new(place.path("run")),
        plan: case.faults.iter().copied().collect(),
        privileges,
        reached: 0,
        start: Start::default(),
        recent: vec![],
        armed: None,
        unsaid: vec![],
        unwritten: BTreeSet::new(),
    };
    let mut starts = 0;
    let result = loop {
        starts += 1;
        ensure!(starts <= STARTS_MAX, "it is not complete after {STARTS_MAX} starts");
        if let Some(result) = training.start(starts, tally)? {
            break result;
        }
    };
    for planned in training.plan.drain(..) {
        tally.add(planned.fault, Fate::Missed);
    }
    let Training { folder, unsaid, unwritten, .. } = training;
    wait_for_end(folder.root())?;
    let left = leftovers::of_run(&folder)?;
    if place.disk().is_some() {
        recover(place, &folder)?;
    }
    let replay = replay(place, folder.root())?;
    let mut evidence = Evidence::read(&Run { folder })?;
    evidence.unwritten = unwritten;
    Ok(Complete { evidence, result, replay, starts, unsaid, left })
}

/// Repairs the recordings, as one does after a power failure: the end of one that was open may be damaged.
fn recover(place: &CaseFolder, folder: &RunFolder) -> Result<()> {
    let mut recordings: Vec<_> = std::fs::read_dir(folder.recordings())?.flatten().map(|entry| entry.path()).collect();
    recordings.sort_unstable();
    for (number, path) in recordings.iter().enumerate() {
        // Nothing was written, or nothing of it had reached the disk.
        if std::fs::metadata(path)?.len() == 0 {
            continue;
        }
        let name = path.display().to_string();
        let ended =
            Session::start(place, format!("recover-{number:02}"), &["recover", &name], &Start::default())?.wait()?;
        let is_told = [0, EXIT_INCOMPLETE].map(Some).contains(&ended.status.code());
        ensure!(is_told, "{name} is not repaired: {}", ended.last_words());
        let old = format!("{name}.cut");
        if Path::new(&old).exists() {
            std::fs::remove_file(old)?;
        }
    }
    Ok(())
}

/// Simulates the recordings again; what was printed.
fn replay(place: &CaseFolder, folder: &Path) -> Result<String> {
    let path = folder.display().to_string();
    let ended = Session::start(place, "replay".to_owned(), &["replay", "--check", &path], &Start::default())?.wait()?;
    // What a power failure took from the end of a recording is told again; the steps were made again.
    let is_told = place.disk().is_some() && ended.status.code() == Some(EXIT_INCOMPLETE);
    let agrees = ended.stdout.lines().any(|line| line == "differences: 0");
    let is_good = agrees && (ended.status.success() || is_told);
    let said = if is_good { String::new() } else { ended.last_words() };
    Ok(ended.stdout.lines().chain(said.lines()).collect::<Vec<_>>().join(", "))
}

impl Training<'_> {
    /// One start, to its end: the result if the run is complete then.
    fn start(&mut self, number: usize, tally: &mut Tally) -> Result<Option<(String, u64)>> {
        self.arm_the_first();
        let start = std::mem::take(&mut self.start);
        let arguments = self.arguments();
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let name = format!("start-{number:02}");
        let mut session = Session::start(self.place, name, &arguments, &start)?;
        self.disturb(&mut session, tally)?;
        let ended = session.wait()?;
        if let Some(armed) = self.armed.take() {
            // A death that the harness itself caused does not show that a point was reached.
            let own = |fault: &Fault| {
                use Fault::{Kill, KillAgain, KillAll, KillAndHold, KillTwo, LosePower};
                matches!(fault, Kill(_) | KillTwo(..) | KillAll | KillAgain(..) | KillAndHold(..) | LosePower)
            };
            let unclear = matches!(armed, Fault::Point(..)) && self.recent.iter().any(own);
            tally.add(armed, if ended.shows(armed) && !unclear { Fate::Landed } else { Fate::Missed });
            self.recent.push(armed);
        }
        self.unsaid.retain(|name| !ended.stderr.contains(name));
        self.unwritten.extend(ended.unwritten());
        ended.ensure_no_panic()?;
        let recent = std::mem::take(&mut self.recent);
        if let Some(result) = self.result(&ended, &recent)? {
            return Ok(Some(result));
        }
        while let Some(planned) = self.plan.front().copied()
            && planned.fault.phase() == Phase::Between
            && self.reached >= planned.rollout
        {
            self.plan.pop_front();
            wait_for_end(self.folder.root())?;
            let (fate, complaint) = damage(planned.fault, &self.folder)?;
            tally.add(planned.fault, fate);
            self.unsaid.extend(complaint);
        }
        Ok(None)
    }

    /// What is to happen with this start, if that is next.
    fn arm_the_first(&mut self) {
        let Some(planned) = self.plan.front().copied() else { return };
        if planned.fault.phase() != Phase::Start || self.reached < planned.rollout {
            return;
        }
        self.plan.pop_front();
        self.start.arm(planned.fault);
        self.armed = Some(planned.fault);
    }

    fn arguments(&self) -> Vec<String> {
        let folder = self.folder.root().display().to_string();
        if self.folder.identity().exists() {
            return vec!["resume".to_owned(), folder];
        }
        let RunKind { actors, environments, learners, frames, .. } = self.shape;
        let words = "up --config config.toml --seed 5 --run";
        let mut arguments: Vec<String> = words.split(' ').map(str::to_owned).collect();
        arguments.push(folder);
        arguments.extend(self.shape.words());
        for (flag, value) in [
            ("--actors", u64::from(actors)),
            ("--envs-per-actor", u64::from(environments)),
            ("--learners", u64::from(learners)),
            ("--frames", frames),
        ] {
            arguments.extend([flag.to_owned(), value.to_string()]);
        }
        arguments
    }

    /// Lets happen what is due while the command runs.
    fn disturb(&mut self, session: &mut Session<'_>, tally: &mut Tally) -> Result<()> {
        let mut due = None;
        while session.runs()? {
            self.reached = self.reached.max(reached(&self.folder));
            if let Some(planned) = self.plan.front().copied()
                && self.reached >= planned.rollout
            {
                let due_at = *due.get_or_insert_with(|| Instant::now() + Duration::from_millis(planned.delay_ms));
                if Instant::now() >= due_at {
                    due = None;
                    self.happen(planned.fault, session, tally)?;
                }
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    fn happen(&mut self, fault: Fault, session: &mut Session<'_>, tally: &mut Tally) -> Result<()> {
        match fault.phase() {
            // The start that it is to happen with comes after a stop, that which is damaged in between after a death.
            Phase::Start => {
                if self.armed.is_none_or(|armed| !matches!(armed, Fault::Point(..))) {
                    signal(session.pid(), Signal::INT);
                    self.recent.push(Fault::Interrupt);
                } else {
                    signal(session.pid(), Signal::KILL);
                    self.recent.push(Fault::KillAll);
                }
                while session.runs()? {
                    std::thread::sleep(Duration::from_millis(10));
                }
            }
            Phase::Between => {
                signal(session.pid(), Signal::KILL);
                self.recent.push(Fault::KillAll);
                while session.runs()? {
                    std::thread::sleep(Duration::from_millis(10));
                }
            }
            Phase::Running => {
                self.plan.pop_front();
                if !fault.is_allowed(self.privileges) {
                    tally.add(fault, Fate::Skipped);
                    return Ok(());
                }
                let fate = carry_out(fault, self.folder.root(), self.place, session)?;
                self.recent.extend(fault.in_force(fate));
                tally.add(fault, fate);
            }
        }
        Ok(())
    }

    /// The result, if the run is complete; an error if it ended in a way that nothing which happened explains.
    fn result(&self, ended: &Ended, recent: &[Fault]) -> Result<Option<(String, u64)>> {
        if ended.status.success() {
            let line = |prefix: &str| ended.stdout.lines().rev().find_map(|line| line.strip_prefix(prefix));
            let result = line("weights: ").zip(line("frames: ").and_then(|frames| frames.parse().ok()));
            if let Some((weights, frames)) = result.filter(|_| self.folder.summary().exists()) {
                return Ok(Some((weights.to_owned(), frames)));
            }
        }
        explain(ended, recent)?;
        Ok(None)
    }
}

/// Rollouts that a run has trained so far, by its metrics.
fn reached(folder: &RunFolder) -> u64 {
    let bytes = std::fs::read(folder.metrics()).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let numbers = text.lines().filter_map(|line| line.strip_prefix("{\"rollout\":")?.split(',').next()?.parse().ok());
    numbers.max().map_or(0, |newest: u64| newest + 1)
}
