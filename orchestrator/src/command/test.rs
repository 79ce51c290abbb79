//! `orchestrator test`: proves an installation. This machine is checked, a short run must end in weights that are known,
//! and so must the same run after its orchestrator was killed and it was resumed.

use super::doctor::{self, DoctorArgs};
use super::overrides::Overrides;
use crate::output::{format, terminal};
use crate::process_end::wait_for_child;
use crate::run::checkpoints::newest_readable;
use crate::run::lifeline::this_program;
use crate::training::summary::Summary;
use anyhow::{Context, Result, bail, ensure};
use proto::run_folder::RunFolder;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitCode, Stdio};
use std::time::{Duration, Instant};

/// Prove this installation: check the machine, train for a moment, kill a run and resume it
///
/// Trains the demonstration's first frames twice on the CPU, where the same seed gives the same weights on every
/// x86-64 processor: once undisturbed, once killed on the way and resumed. Both must end in the weights that this version
/// is known to give; on ARM both in the same weights. It takes up to two minutes on two cores, and leaves nothing
/// behind; if something is wrong its runs stay, and are named.
#[derive(Debug, clap::Args)]
pub struct TestArgs {}

const PRESET: &str = "demo";
const FRAMES: u64 = 4000;
/// SHA-256 of the weights after so many frames with seed 1.
const WEIGHTS: &str = "0aefd082f03328f6c0e1dd03b427f60f17399b82d56017b49704908a5211a33f";
/// Over the preset: the CPU whatever there is, few processes, and a checkpoint after each rollout.
const SETTINGS: [&str; 4] =
    ["learner.device=cpu", "actors.count=2", "actors.environments_per_actor=4", "checkpoint.interval_s=0"];
/// Two minutes on a slow machine, twenty under an emulator.
const PATIENCE: Duration = Duration::from_hours(1);
const LOOK: Duration = Duration::from_millis(20);

pub fn run(_: &TestArgs) -> Result<ExitCode> {
    let set = SETTINGS.iter().map(|setting| setting.parse()).collect::<Result<_, _>>().map_err(anyhow::Error::msg)?;
    let overrides = Overrides { set, frames: Some(FRAMES), seed: Some(1), ..Overrides::default() };
    if doctor::run(&DoctorArgs::of(PRESET, overrides))? != ExitCode::SUCCESS {
        bail!("this machine cannot run it: see what is marked PROBLEM");
    }
    let place = tempfile::Builder::new().prefix("stillroom-test-").tempdir().context("no temporary folder")?;
    if let Err(error) = [("digest", undisturbed as Proof), ("kill, resume", killed)]
        .into_iter()
        .try_for_each(|(name, proof)| prove(name, proof, place.path()))
    {
        return Err(error.context(format!("the test failed; its runs are in {}", place.keep().display())));
    }
    terminal::out("this installation works");
    Ok(ExitCode::SUCCESS)
}

type Proof = fn(&Path) -> Result<String>;

fn prove(name: &str, proof: Proof, place: &Path) -> Result<()> {
    let began = Instant::now();
    let text = proof(place)?;
    terminal::out(&format!("{name:14} {:8} {text}, {}", "ok", format::duration(began.elapsed())));
    Ok(())
}

fn undisturbed(place: &Path) -> Result<String> {
    let folder = RunFolder::new(place.join("undisturbed"));
    finish(&mut up(&folder)?, &folder)?;
    let weights = weights(&folder)?;
    if cfg!(target_arch = "x86_64") {
        demand(&weights, WEIGHTS)?;
    }
    Ok(format!("{FRAMES} frames end in the weights {}", &weights[..8]))
}

/// A run whose orchestrator is killed after its first checkpoint: no other process outlives it.
fn killed(place: &Path) -> Result<String> {
    let folder = RunFolder::new(place.join("killed"));
    let mut child = up(&folder)?;
    let began = Instant::now();
    let frames = loop {
        let checkpoint = newest_readable(&folder).ok().and_then(|(manifest, _)| manifest);
        if let Some(manifest) = checkpoint.filter(|manifest| manifest.frames > 0) {
            break manifest.frames;
        }
        ensure!(wait_for_child(&mut child, LOOK)?.is_none(), "it ended before it could be killed: {}", said(&folder));
        ensure!(began.elapsed() < PATIENCE, "it wrote no checkpoint: {}", said(&folder));
    };
    child.kill().context("cannot kill the run")?;
    child.wait().context("cannot wait for the run")?;
    ensure!(frames < FRAMES && Summary::read(&folder)?.is_none(), "it was complete before it could be killed");
    finish(&mut start(&folder, &["resume"])?, &folder)?;
    demand(&weights(&folder)?, &weights(&RunFolder::new(place.join("undisturbed")))?)?;
    Ok(format!("killed after {frames} frames and resumed, it ends in the same"))
}

fn up(folder: &RunFolder) -> Result<Child> {
    let frames = FRAMES.to_string();
    let mut words = vec!["up", "--preset", PRESET, "--seed", "1", "--frames", &frames];
    words.extend(SETTINGS.iter().flat_map(|setting| ["--set", setting]));
    words.push("--run");
    start(folder, &words)
}

/// Starts a command of this program on a run, which ends with this process; what it says goes to a file beside the run.
fn start(folder: &RunFolder, words: &[&str]) -> Result<Child> {
    let log = File::create(log(folder)).context("cannot write to the temporary folder")?;
    let mut command = this_program();
    command.args(["--parent", &std::process::id().to_string()]).args(words).arg(folder.root());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log).spawn().context("cannot start a run")
}

fn log(folder: &RunFolder) -> PathBuf {
    folder.root().with_extension("log")
}

/// Why a run failed, as it said; else its last line.
fn said(folder: &RunFolder) -> String {
    let text = proto::bounded::read_text(&log(folder)).unwrap_or_default();
    let mut lines = text.lines().rev();
    let reason = lines.clone().find(|line| line.starts_with("error: ")).or_else(|| lines.next());
    reason.unwrap_or("it said nothing").to_owned()
}

fn finish(child: &mut Child, folder: &RunFolder) -> Result<()> {
    match wait_for_child(child, PATIENCE)? {
        Some(status) if status.success() => Ok(()),
        Some(status) => bail!("{}: {}", proto::exit::how(status), said(folder)),
        None => bail!("it has not ended within an hour: {}", said(folder)),
    }
}

fn weights(folder: &RunFolder) -> Result<String> {
    let summary = Summary::read(folder)?.context("the run has no summary")?;
    ensure!(summary.frames == FRAMES, "it ended after {} frames", summary.frames);
    Ok(summary.weights)
}

fn demand(weights: &str, expected: &str) -> Result<()> {
    ensure!(weights == expected, "{FRAMES} frames end in the weights {weights}, and not in {expected}");
    Ok(())
}
