//! Faults, carried out: those that happen to processes that run, and those that happen to files in between.

use crate::case_folder::{CaseFolder, Start};
use crate::fault::{Case, Damage, Fate, Fault, Journal, Phase, Planned, Who};
use crate::judge::explain;
use crate::privileges::Privileges;
use crate::processes::{find, of_folder, signal};
use crate::run_kind::Kind;
use crate::session::{Session, wait_for_end};
use crate::tally::Tally;
use anyhow::{Context, Result, bail};
use proto::checkpoint::Manifest;
use proto::digest::sha256;
use proto::run_folder::{RolloutName, RunFolder};
use rustix::process::Signal;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The longest wait for a process that takes a killed one's place.
const BACK: Duration = Duration::from_secs(15);

/// The file that a start names when lines of it are missing.
const METRICS: &str = "metrics.jsonl";

/// Starts a command again until it has left a file, disturbed by time; its folder, and how many starts that took.
/// `command`: the folder of a start by its number, and the words before that.
pub fn start_until_done<'a>(
    case: &Case,
    place: &CaseFolder,
    privileges: Privileges,
    tally: &mut Tally,
    command: impl Fn(usize) -> (PathBuf, &'a str),
    left: &str,
) -> Result<(PathBuf, usize)> {
    let is_suite = case.shape.kind == Kind::Suite;
    // One that is not done then gets nowhere.
    let starts_max = if is_suite { 15 } else { 12 };
    let mut plan: VecDeque<_> = case.faults.iter().copied().collect();
    for starts in 1..=starts_max {
        let (folder, words) = command(starts);
        let mut start = Start::default();
        let armed = plan.pop_front_if(|planned| planned.fault.phase() == Phase::Start).map(|planned| planned.fault);
        if let Some(fault) = armed {
            start.arm(fault);
        }
        let out = folder.display().to_string();
        let arguments: Vec<&str> = words.split(' ').chain([out.as_str()]).collect();
        let mut session = Session::start(place, format!("start-{starts:02}"), &arguments, &start)?;
        let mut recent = Vec::from_iter(armed);
        for (fault, fate) in disturb_by_time(&mut plan, &folder, place, privileges, &mut session)? {
            recent.extend(fault.in_force(fate));
            tally.add(fault, fate);
        }
        let ended = session.wait()?;
        if let Some(armed) = armed {
            // The deaths of the processes of a suite's runs are in the runs' own logs.
            let is_elsewhere = is_suite && matches!(armed, Fault::Point(point, _) if point.program != "orchestrator");
            tally.add(armed, if is_elsewhere || ended.shows(armed) { Fate::Landed } else { Fate::Missed });
        }
        ended.ensure_no_panic()?;
        wait_for_end(&folder)?;
        if ended.status.success() && folder.join(left).exists() {
            plan.drain(..).for_each(|planned| tally.add(planned.fault, Fate::Missed));
            return Ok((folder, starts));
        }
        // After a failure the next start tries again.
        explain(&ended, &recent).context("it is not done")?;
    }
    bail!("it is not done after {starts_max} starts")
}

/// Lets the first faults of a plan happen to a session, each after its delay, until it ends or the next one is for
/// another time; what became of each.
fn disturb_by_time(
    plan: &mut VecDeque<Planned>,
    folder: &Path,
    place: &CaseFolder,
    privileges: Privileges,
    session: &mut Session<'_>,
) -> Result<Vec<(Fault, Fate)>> {
    let begun = Instant::now();
    let mut done = vec![];
    while session.runs()? {
        if let Some(planned) = plan.front().filter(|planned| planned.fault.phase() == Phase::Running).copied()
            && begun.elapsed() >= Duration::from_millis(planned.delay_ms)
        {
            plan.pop_front();
            let fate = if planned.fault.is_allowed(privileges) {
                carry_out(planned.fault, folder, place, session)?
            } else {
                Fate::Skipped
            };
            done.push((planned.fault, fate));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(done)
}

/// Lets a fault happen to what runs under `folder`, of which `session` is the first command.
pub fn carry_out(fault: Fault, folder: &Path, place: &CaseFolder, session: &mut Session<'_>) -> Result<Fate> {
    let first = session.pid();
    let find = |who| find(who, folder, first);
    let hit = |who, how| find(who).is_some_and(|pid| signal(pid, how));
    let landed = |landed| if landed { Fate::Landed } else { Fate::Missed };
    Ok(match fault {
        Fault::Kill(who) => landed(hit(who, Signal::KILL)),
        Fault::Terminate(who) => landed(hit(who, Signal::TERM)),
        Fault::Interrupt => landed(signal(first, Signal::INT)),
        // Both or none: what has been struck alone would count as undisturbed.
        Fault::KillTwo(one, other) => match [one, other].map(find) {
            [Some(one), Some(other)] => {
                let killed = [one, other].map(|pid| signal(pid, Signal::KILL));
                landed(killed.contains(&true))
            }
            _ => Fate::Missed,
        },
        Fault::KillAll => landed(kill_all(folder, first, || Ok(()))? > 0),
        Fault::LosePower => {
            let disk = place.disk().context("a case in which the power fails has a disk of its own")?;
            let killed = kill_all(folder, first, || disk.fail())?;
            while session.runs()? {
                std::thread::sleep(Duration::from_millis(10));
            }
            wait_for_end(folder)?;
            disk.restore()?;
            // What had filled the disk before may be back: its end had not reached the disk.
            place.clear()?;
            landed(killed > 0)
        }
        Fault::KillAgain(who, ms) => match kill_and_await(who, folder, session)? {
            None => Fate::Missed,
            Some(pid) => {
                session.pass(Duration::from_millis(ms))?;
                landed(signal(pid, Signal::KILL))
            }
        },
        Fault::KillAndHold(actor, ms) => match kill_and_await(Who::Actor(actor), folder, session)? {
            None => Fate::Missed,
            Some(_) => pause(first, ms, session)?,
        },
        Fault::Pause(who, ms) => match find(who) {
            None => Fate::Missed,
            Some(pid) => pause(pid, ms, session)?,
        },
        Fault::FullDisk(ms) => {
            let filler = place.fill(None)?;
            session.pass(Duration::from_millis(ms))?;
            drop(filler);
            Fate::Landed
        }
        Fault::FullMemory(ms) => {
            // The command that has just been started may not have its own /dev/shm yet, or may have ended.
            let Ok(filler) = place.fill(Some(first)) else { return Ok(Fate::Missed) };
            session.pass(Duration::from_millis(ms))?;
            drop(filler);
            Fate::Landed
        }
        Fault::Point(..) | Fault::FewDescriptors(_) | Fault::Checkpoint(_) | Fault::Metrics(_) => Fate::Missed,
    })
}

/// Kills everybody after `before`; how many. Stopped first, so that none sees another's death.
fn kill_all(folder: &Path, first: u32, before: impl FnOnce() -> Result<()>) -> Result<usize> {
    let mut everyone: Vec<u32> = of_folder(folder).into_iter().map(|one| one.pid).collect();
    // One that has ended has no command line any more.
    if !everyone.contains(&first) && std::fs::read(format!("/proc/{first}/cmdline")).is_ok_and(|line| !line.is_empty())
    {
        everyone.push(first);
    }
    for &pid in &everyone {
        signal(pid, Signal::STOP);
    }
    before()?;
    Ok(everyone.iter().filter(|&&pid| signal(pid, Signal::KILL)).count())
}

fn kill_and_await(who: Who, folder: &Path, session: &mut Session<'_>) -> Result<Option<u32>> {
    let first = session.pid();
    let Some(pid) = find(who, folder, first) else { return Ok(None) };
    if !signal(pid, Signal::KILL) {
        return Ok(None);
    }
    let begun = Instant::now();
    while begun.elapsed() < BACK && session.runs()? {
        match find(who, folder, first) {
            Some(other) if other != pid => return Ok(Some(other)),
            _ => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    Ok(None)
}

fn pause(pid: u32, ms: u64, session: &mut Session<'_>) -> Result<Fate> {
    if !signal(pid, Signal::STOP) {
        return Ok(Fate::Missed);
    }
    let passed = session.pass(Duration::from_millis(ms));
    signal(pid, Signal::CONT);
    passed.map(|()| Fate::Landed)
}

/// Damages a file of a run that nobody runs; the name that the next start has to complain of, if it happened and loses
/// anything.
pub fn damage(fault: Fault, folder: &RunFolder) -> Result<(Fate, Option<String>)> {
    match fault {
        Fault::Checkpoint(how) => damage_checkpoint(how, folder),
        Fault::Metrics(how) => {
            let fate = damage_lines(how, &folder.metrics())?;
            let loses = fate == Fate::Landed && how != Journal::Torn;
            Ok((fate, loses.then(|| METRICS.to_owned())))
        }
        _ => Ok((Fate::Missed, None)),
    }
}

/// The manifests of a run's whole checkpoints, the newest last.
fn manifests(folder: &RunFolder) -> Vec<PathBuf> {
    let is_whole = |path: &PathBuf| {
        let tensors = std::fs::read(path.with_extension("safetensors"));
        let manifest = Manifest::read(path).ok().zip(tensors.ok());
        manifest.is_some_and(|(manifest, tensors)| sha256(&tensors) == manifest.tensors_sha256)
    };
    let entries = std::fs::read_dir(folder.checkpoints()).into_iter().flatten().flatten();
    let mut found: Vec<_> = entries
        .map(|entry| entry.path())
        .filter(|path| RolloutName::Manifest.rollout_of(path).is_some() && is_whole(path))
        .collect();
    found.sort();
    found
}

fn damage_checkpoint(how: Damage, folder: &RunFolder) -> Result<(Fate, Option<String>)> {
    let manifests = manifests(folder);
    // With a single one there is nothing to go back to.
    let [.., _, newest] = manifests.as_slice() else { return Ok((Fate::Missed, None)) };
    let tensors = newest.with_extension("safetensors");
    match how {
        Damage::FlippedBit => {
            let mut bytes = std::fs::read(&tensors)?;
            let middle = bytes.len() / 2;
            bytes[middle] ^= 16;
            std::fs::write(&tensors, bytes)?;
        }
        Damage::ShortTensors => shorten(&tensors)?,
        Damage::NoTensors => std::fs::remove_file(&tensors)?,
        Damage::ShortManifest => shorten(newest)?,
        Damage::ZeroManifest => std::fs::write(newest, vec![0; std::fs::metadata(newest)?.len() as usize])?,
    }
    let name = newest.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    Ok((Fate::Landed, name))
}

fn shorten(path: &Path) -> Result<()> {
    let file = std::fs::OpenOptions::new().write(true).open(path)?;
    Ok(file.set_len(file.metadata()?.len() / 2)?)
}

fn damage_lines(how: Journal, path: &Path) -> Result<Fate> {
    let Ok(mut bytes) = std::fs::read(path) else { return Ok(Fate::Missed) };
    if bytes.split(|&byte| byte == b'\n').count() < 3 {
        return Ok(Fate::Missed);
    }
    match how {
        Journal::Torn => bytes.extend_from_slice(b"{\"rollout\":7,\"fra"),
        Journal::Garbled => {
            let middle = bytes.len() / 2;
            bytes[middle..middle + 8].fill(0xff);
        }
        Journal::Missing => {
            std::fs::remove_file(path)?;
            return Ok(Fate::Landed);
        }
    }
    std::fs::write(path, bytes)?;
    Ok(Fate::Landed)
}
