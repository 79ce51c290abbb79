//! The wire beside other ways to carry depth frames from many actors to one learner and actions back: raw shared memory
//! with semaphores, Unix sockets, ZeroMQ, gRPC. All on the same cores in one run, with the protocol of a rollout.
//!
//! ```text
//! main    rounds over all ways and sizes; the table
//! cell    one way with one size: the learner's side, which starts actors (and a recorder) and measures
//! end     what all ways have in common
//! ways    each way: an actor's end and the learner's end
//! ```

mod cell;
mod clock;
mod end;
mod table;
mod ways;

use anyhow::{Context, Result, ensure};
use cell::{Figures, Setting};
use clap::{Args, Parser, Subcommand};
use end::{ActorArgs, EndArgs, Way};
use std::process::{Command, Stdio};
use table::Row;

/// The wire beside raw shared memory, Unix sockets, ZeroMQ and gRPC
///
/// Actor processes send depth frames of 224 × 224 pixels with what belongs to them (125,696 bytes) and wait for their
/// actions. The learner waits until a half of every actor's environments is there, reads every byte and answers, while
/// the other half is on its way, as in a rollout.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    part: Option<Part>,
    #[command(flatten)]
    run: RunArgs,
}

#[derive(Debug, Args)]
struct RunArgs {
    /// Actor processes
    #[arg(long, default_value_t = 19, value_parser = clap::value_parser!(u32).range(1..=128))]
    actors: u32,
    /// Frames of one half of an actor's environments; 1 = an actor of one environment
    #[arg(long, value_delimiter = ',', default_values_t = [1, 8, 32])]
    frames: Vec<u32>,
    /// Ways to measure
    #[arg(long, value_delimiter = ',', default_values_t = Way::ALL)]
    ways: Vec<Way>,
    /// How long each is measured in a round, seconds
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
    /// Rounds; the median counts
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=99))]
    rounds: u32,
}

#[derive(Debug, Subcommand)]
enum Part {
    /// One way with one size, once; started by the whole
    #[command(hide = true)]
    Cell(Setting),
    /// An actor; started by a cell
    #[command(hide = true)]
    Actor(ActorArgs),
    /// A second reader of the wire's observations; started by a cell
    #[command(hide = true)]
    Recorder(EndArgs),
}

fn main() -> Result<()> {
    let Arguments { part, run } = Arguments::parse();
    wire::logging::to_stderr();
    wire::descriptors::raise_limit();
    match part {
        None => compare(&run),
        Some(Part::Cell(setting)) => cell::run(&setting),
        Some(Part::Actor(args)) => cell::act(&args),
        Some(Part::Recorder(args)) => ways::wire::record(&args),
    }
}

fn compare(args: &RunArgs) -> Result<()> {
    ensure!(args.seconds > 0.0 && args.seconds <= 600.0, "--seconds must be above 0 and at most 600");
    ensure!(args.frames.iter().all(|frames| (1..=128).contains(frames)), "--frames must be 1 to 128");
    let cores = std::thread::available_parallelism()?;
    let before = load();
    let mut rows: Vec<Row> = vec![];
    for round in 0..args.rounds {
        for &frames in &args.frames {
            for &way in &args.ways {
                for recorded in [false, true] {
                    if recorded && way != Way::Wire {
                        continue;
                    }
                    let setting = Setting { way, actors: args.actors, frames, seconds: args.seconds, recorded };
                    let figures = measure(&setting).with_context(|| format!("{way}, {frames} frames"))?;
                    eprintln!("round {}: {way}, {frames} frames: {:.0} frames/s", round + 1, figures.frames_per_s);
                    match rows.iter_mut().find(|row| row.is_of(&setting)) {
                        Some(row) => row.add(figures),
                        None => rows.push(Row::new(setting, figures)),
                    }
                }
            }
        }
    }
    rows.sort_by_key(|row| args.frames.iter().position(|&frames| frames == row.frames()));
    let machine = format!("{cores} cores; load {before} before, {} after", load());
    println!("{}", table::text(&rows, args.actors, &machine));
    Ok(())
}

/// Starts a cell in a process of its own and returns what it measured.
fn measure(setting: &Setting) -> Result<Figures> {
    let output = Command::new(std::env::current_exe()?)
        .arg("cell")
        .args(setting.arguments())
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()?;
    ensure!(output.status.success(), "the measurement ended with {}", output.status);
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(text.trim()).with_context(|| format!("not figures: {text}"))
}

/// Processes that ran or wanted to, mean over the last minute.
fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().unwrap_or("unknown").to_owned()
}
