//! One start of a command, watched until it ends.

use crate::case_folder::{CaseFolder, Start};
use crate::fault::Fault;
use crate::processes;
use anyhow::{Result, bail};
use rustix::process::Signal;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

/// The longest that one start may take; no fault may end in a hang.
const DEADLINE: Duration = Duration::from_mins(4);
/// How long children that have lost their orchestrator may take to end.
const ORPHANS_LEAVE: Duration = Duration::from_mins(1);

pub struct Session<'a> {
    /// What its output is called.
    pub name: String,
    place: &'a CaseFolder,
    child: Child,
    begun: Instant,
    status: Option<ExitStatus>,
    deadline: Duration,
}

#[derive(Debug)]
pub struct Ended {
    pub status: ExitStatus,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
}

impl Ended {
    pub fn signal(&self) -> Option<i32> {
        self.status.signal()
    }

    /// Whether it shows that what was armed has struck: it died itself, or tells of the death of a child.
    pub fn shows(&self, armed: Fault) -> bool {
        match armed {
            Fault::Point(point, _) if point.program == "orchestrator" => self.signal() == Some(9),
            Fault::Point(point, _) => {
                let dead = |line: &str| line.contains(" died") && line.contains(&format!("{}-", point.program));
                self.stderr.lines().any(dead) || self.stderr.contains(&format!("{} died", point.program))
            }
            _ => true,
        }
    }

    /// An error with the place and words of a panic, if there was one, in it or in a process whose words it shows.
    pub fn ensure_no_panic(&self) -> Result<()> {
        let mut lines = self.stderr.lines().skip_while(|line| !line.contains("panicked at"));
        match lines.next() {
            None => Ok(()),
            Some(place) => bail!("a panic: {place} {}", lines.next().unwrap_or_default()),
        }
    }

    /// What it printed to standard error but information and warnings.
    pub fn complaints(&self) -> impl Iterator<Item = &str> {
        self.stderr.lines().filter(|line| !line.contains(" INFO ") && !line.contains(" WARN "))
    }

    /// Names of the checkpoints that could not be written.
    pub fn unwritten(&self) -> impl Iterator<Item = String> {
        let path = |line: &'_ str| {
            line.split_once("cannot write checkpoint ")?.1.split_once(": ").map(|(path, _)| path.to_owned())
        };
        let name = |path: String| Some(Path::new(&path).file_stem()?.to_string_lossy().into_owned());
        self.stderr.lines().filter_map(path).filter_map(name)
    }

    /// Whether a validation failed as often as it is tried: the next start makes it.
    pub fn leaves_a_validation(&self) -> bool {
        let is_left =
            |line: &str| line.contains(" the validation after rollout ") && line.contains(" times and is left to ");
        self.stderr.lines().any(is_left)
    }

    /// The last lines that it printed, for a message.
    pub fn last_words(&self) -> String {
        let lines: Vec<&str> = self.stderr.lines().rev().filter(|line| !line.is_empty()).take(6).collect();
        let lines: Vec<&str> = lines.into_iter().rev().collect();
        format!("{}: {}", self.status, lines.join(" / "))
    }
}

impl<'a> Session<'a> {
    /// Starts `orchestrator ARGUMENTS`.
    pub fn start(place: &'a CaseFolder, name: String, arguments: &[&str], start: &Start) -> Result<Self> {
        let child = place.start(&name, arguments, start)?;
        Ok(Self { name, place, child, begun: Instant::now(), status: None, deadline: DEADLINE })
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// It may take as long as it likes.
    pub fn unlimited(&mut self) {
        self.deadline = Duration::MAX;
    }

    /// It was told to end: from now on it has the usual time.
    pub fn must_end(&mut self) {
        self.deadline = self.begun.elapsed() + DEADLINE;
    }

    /// Whether it still runs; an error if it has hung.
    pub fn runs(&mut self) -> Result<bool> {
        if self.status.is_none() {
            self.status = self.child.try_wait()?;
        }
        if self.status.is_none() && self.begun.elapsed() > self.deadline {
            let stderr = self.said();
            let last = stderr.lines().last().unwrap_or_default();
            bail!("`{}` hung for {} s; its last line: {last}", self.name, self.deadline.as_secs());
        }
        Ok(self.status.is_none())
    }

    pub fn wait(mut self) -> Result<Ended> {
        while self.runs()? {
            std::thread::sleep(Duration::from_millis(10));
        }
        let [stdout, stderr] = self.place.printed(&self.name);
        let Some(status) = self.status else { bail!("`{}` has no exit status", self.name) };
        Ok(Ended { status, stdout, stderr })
    }

    /// What it has printed to standard error so far.
    pub fn said(&self) -> String {
        let [_, stderr] = self.place.printed(&self.name);
        stderr
    }

    /// Sleeps for so long, or until it ends.
    pub fn pass(&mut self, time: Duration) -> Result<()> {
        let begun = Instant::now();
        while begun.elapsed() < time && self.runs()? {
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }
}

impl Drop for Session<'_> {
    fn drop(&mut self) {
        if self.status.is_none() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// For tests: an end with this status of `wait` and this standard error.
#[cfg(test)]
pub fn ended(raw_status: i32, stderr: &str) -> Ended {
    Ended { status: ExitStatus::from_raw(raw_status), stdout: String::new(), stderr: stderr.to_owned() }
}

/// Waits until no process of this folder is left; an error, with the end of them, if some stay.
pub fn wait_for_end(folder: &Path) -> Result<()> {
    let begun = Instant::now();
    loop {
        let left = processes::of_folder(folder);
        if left.is_empty() {
            return Ok(());
        }
        if begun.elapsed() > ORPHANS_LEAVE {
            for one in &left {
                processes::signal(one.pid, Signal::KILL);
            }
            let lines: Vec<_> = left.into_iter().map(|one| one.line).collect();
            bail!("processes are left {} s after their orchestrator: {lines:?}", ORPHANS_LEAVE.as_secs());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}
