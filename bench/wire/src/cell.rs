//! One measurement: the learner's side with its actors, and what an actor process does.

use crate::clock::processor_time;
use crate::end::{ActorArgs, EndArgs, LearnerEnd, MEASURED, Place, STOP, UNMEASURED, Way};
use crate::ways;
use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use wire::lifeline;

/// Exchanges of each half before anything is measured, and the least time that they take.
const WARM_UP: (u32, Duration) = (8, Duration::from_millis(300));

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Args)]
pub struct Setting {
    /// The way
    #[arg(long)]
    pub way: Way,
    /// Actor processes
    #[arg(long)]
    pub actors: u32,
    /// Frames of a half
    #[arg(long)]
    pub frames: u32,
    /// How long
    #[arg(long)]
    pub seconds: f64,
    /// A second process reads along, as the recorder does
    #[arg(long)]
    pub recorded: bool,
}

impl Setting {
    /// The same as a command line.
    pub fn arguments(&self) -> Vec<String> {
        let mut words = vec![format!("--way={}", self.way), format!("--actors={}", self.actors)];
        words.extend([format!("--frames={}", self.frames), format!("--seconds={}", self.seconds)]);
        words.extend(self.recorded.then(|| "--recorded".to_owned()));
        words
    }
}

/// What was measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Frames that the learner read in a second.
    pub frames_per_s: f64,
    /// From sending a half to its actions, microseconds: the median.
    pub p50_us: f64,
    /// The 99th percentile.
    pub p99_us: f64,
    /// Processor time of all processes together for a frame, microseconds.
    pub cpu_us: f64,
}

/// The children of a cell. Their standard input is their lifeline.
struct Children(Vec<Child>);

impl Children {
    fn start(&mut self, part: &str, arguments: &[String]) -> Result<()> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg(part).args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        self.0.push(command.spawn().with_context(|| format!("cannot start {part}"))?);
        Ok(())
    }

    fn processor_time(&self) -> Result<Duration> {
        let own = processor_time(std::process::id())?;
        self.0.iter().try_fold(own, |sum, child| Ok(sum + processor_time(child.id())?))
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        for child in &mut self.0 {
            // Most have ended by themselves.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

pub fn run(setting: &Setting) -> Result<()> {
    let place = Place::new(setting.actors, setting.frames)?;
    let mut learner = ways::learner(setting.way, &place)?;
    let mut children = Children(vec![]);
    let end = EndArgs { place: place.clone() };
    if setting.recorded {
        children.start("recorder", &end.arguments())?;
        let mut ready = String::new();
        let stdout = children.0[0].stdout.as_mut().context("a piped standard output")?;
        BufReader::new(stdout).read_line(&mut ready)?;
        ensure!(ready.trim() == "ready", "the recorder does not start");
    }
    for actor in 0..setting.actors {
        children.start("actor", &ActorArgs { way: setting.way, actor, end: end.clone() }.arguments())?;
    }
    let (frames, took, used) = exchange(&mut *learner, &place, setting, &children)?;

    let actors = &mut children.0[usize::from(setting.recorded)..];
    let mut trips: Vec<u32> = vec![];
    for actor in actors {
        let mut text = String::new();
        actor.stdout.as_mut().context("a piped standard output")?.read_to_string(&mut text)?;
        trips
            .extend(serde_json::from_str::<Vec<u32>>(text.trim()).with_context(|| format!("not round trips: {text}"))?);
    }
    ensure!(frames > 0 && !trips.is_empty(), "nothing crossed within {} s", setting.seconds);
    trips.sort_unstable();
    let percentile = |share: f64| f64::from(trips[((trips.len() - 1) as f64 * share) as usize]);
    let figures = Figures {
        frames_per_s: frames as f64 / took.as_secs_f64(),
        p50_us: percentile(0.5),
        p99_us: percentile(0.99),
        cpu_us: used.as_secs_f64() * 1e6 / frames as f64,
    };
    println!("{}", serde_json::to_string(&figures)?);
    drop(children);
    drop(learner);
    ways::sweep(&place);
    Ok(())
}

/// The learner's loop: frames read, the time, and the processor time of all. Both halves are stopped at the end.
fn exchange(
    learner: &mut dyn LearnerEnd,
    place: &Place,
    setting: &Setting,
    children: &Children,
) -> Result<(u64, Duration, Duration)> {
    let halves = place.halves();
    let mut steps = [0_u64; 2];
    let mut turn = |learner: &mut dyn LearnerEnd, half: u32, action: u8| -> Result<u64> {
        let step = steps[half as usize];
        let mut sound = true;
        learner.receive(half, &mut |actor, bytes| sound &= is_whole(bytes, place.pattern(actor, half, step)))?;
        ensure!(sound, "{}: what arrives in step {step} is not what was sent", setting.way);
        steps[half as usize] += 1;
        learner.answer(half, action)?;
        Ok(u64::from(place.actors) * u64::from(place.frames))
    };
    let warm_until = Instant::now() + WARM_UP.1;
    let mut warmed = 0;
    while warmed < WARM_UP.0 || Instant::now() < warm_until {
        (0..halves).try_for_each(|half| turn(learner, half, UNMEASURED).map(|_| ()))?;
        warmed += 1;
    }
    let (began, used_before) = (Instant::now(), children.processor_time()?);
    let mut frames = 0;
    while began.elapsed().as_secs_f64() < setting.seconds {
        for half in 0..halves {
            frames += turn(learner, half, MEASURED)?;
        }
    }
    let (took, used) = (began.elapsed(), children.processor_time()?.saturating_sub(used_before));
    (0..halves).try_for_each(|half| turn(learner, half, STOP).map(|_| ()))?;
    Ok((frames, took, used))
}

/// Reads every byte; whether all are `pattern`.
fn is_whole(bytes: &[u8], pattern: u8) -> bool {
    let expected = u64::from_ne_bytes([pattern; 8]);
    let (words, rest) = bytes.as_chunks::<8>();
    let differences = words.iter().fold(0, |sum, &word| sum | (u64::from_ne_bytes(word) ^ expected));
    differences == 0 && rest.is_empty()
}

/// An actor: sends its halves, waits for actions, sends again. Prints its round trips in microseconds.
pub fn act(args: &ActorArgs) -> Result<()> {
    // When the cell dies, so does this.
    lifeline::hold(|| std::process::exit(1)).context("cannot watch standard input")?;
    let place = &args.end.place;
    let mut end = ways::actor(args.way, place, args.actor)?;
    let mut steps = [0_u64; 2];
    let mut sent = [Instant::now(); 2];
    let mut trips: Vec<u32> = vec![];
    for half in 0..place.halves() {
        end.send(half, place.pattern(args.actor, half, 0))?;
    }
    let mut running = place.halves();
    let mut measured = [false; 2];
    while running > 0 {
        let (half, action) = end.wait()?;
        let index = half as usize;
        // The first trip of those that count began before they did.
        if std::mem::replace(&mut measured[index], action == MEASURED) && action != UNMEASURED {
            trips.push(sent[index].elapsed().as_micros() as u32);
        }
        if action == STOP {
            running -= 1;
            continue;
        }
        steps[index] += 1;
        sent[index] = Instant::now();
        end.send(half, place.pattern(args.actor, half, steps[index]))?;
    }
    println!("{}", serde_json::to_string(&trips)?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_wrong_byte_is_seen() {
        let mut bytes = vec![7; 64];
        assert!(is_whole(&bytes, 7) && !is_whole(&bytes, 8));
        bytes[63] = 6;
        assert!(!is_whole(&bytes, 7));
    }
}
