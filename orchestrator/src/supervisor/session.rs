//! One session: one start of the orchestrator on a run folder, from the claim on names in shared memory to the last
//! process's end. A run's and an evaluation's alike. `run.toml` counts them as incarnations.

use super::event::Outcome;
use super::process::Launch;
use super::shell::{Audience, Shell, Signals};
use crate::preflight::cores;
use crate::preflight::tools::Tools;
use crate::recording::recorder::{Recorder, RecorderSetup};
use crate::run::lock::RunLock;
use crate::run::remains;
use crate::showing::format::{self, counted};
use crate::showing::terminal;
use anyhow::{Context, Result};
use proto::config::{ActorsConfig, Config};
use proto::plain_file::open_plain;
use proto::run_folder::RunFolder;
use std::fs::OpenOptions;
use std::time::Duration;
use wire::{WireAddress, WireHost, WireShape, fault};

/// Status after a second Ctrl-C: what a shell reports for a program that SIGINT ended.
pub const EXIT_INTERRUPTED: u8 = 130;

/// What a session needs.
#[derive(Debug)]
pub struct Session<'a> {
    /// The folder, with config.toml in it.
    pub folder: &'a RunFolder,
    /// Contents of config.toml.
    pub config: &'a Config,
    /// Number of this start.
    pub incarnation: u32,
    /// Address of its services.
    pub address: &'a WireAddress,
    /// Programs.
    pub tools: &'a Tools,
}

impl Session<'_> {
    /// Has the log go to the folder, too.
    pub fn begin_log(&self) -> Result<()> {
        let path = self.folder.log("orchestrator");
        let log = open_plain(&path, OpenOptions::new().create(true).append(true));
        terminal::log_to_file(log.with_context(|| format!("cannot open {}", path.display()))?);
        Ok(())
    }

    /// Runs everything to its end; the second result is the recording's.
    pub fn run(&self, lock: &mut RunLock, audience: &mut impl Audience) -> Result<(Outcome, Result<()>)> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("tokio")?;
        let result = runtime.block_on(self.supervise(lock, audience));
        // In any case no process and no shared memory of this incarnation remains.
        drop(runtime);
        if let Err(error) = remains::sweep(self.address, Duration::from_secs(2)) {
            tracing::warn!("{error:#}");
        }
        result
    }

    async fn supervise(&self, lock: &mut RunLock, audience: &mut impl Audience) -> Result<(Outcome, Result<()>)> {
        let Self { folder, config, incarnation, address, tools } = *self;
        let signals = Signals::install()?;
        // `stop` signals the process that has signed the lock. So it signs only after it handles signals as requests.
        lock.sign(incarnation)?;
        let run = std::path::absolute(folder.root()).context("run folder")?;
        let _claim = remains::claim(address, &run)?;
        let shape = WireShape::of(config);
        let host = WireHost::create(address, shape)?;
        fault::reach("orchestrator.after_wire");
        let setup = || RecorderSetup {
            address: address.clone(),
            shape,
            folder: folder.clone(),
            incarnation,
            config: config.clone(),
        };
        // Before the actors: none of their samples is missed.
        let recorder = config.recording.enabled.then(|| Recorder::start(setup())).transpose()?;
        let placement = cores::placement(config, &tools.torch)?;
        if let Some(placement) = &placement {
            tracing::info!("cores: {}", placement.describe());
        }
        let launch = Launch {
            programs: tools.programs.clone(),
            learners: config.learner.count,
            threads: config.learner.threads,
            evaluates: config.evaluation.is_some(),
            folder: folder.clone(),
            address: address.clone(),
            placement,
        };
        let shell = Shell { config, host: &host, recorder: recorder.as_ref(), signals };
        let outcome = shell.supervise(launch, audience).await;
        fault::reach("orchestrator.before_recorder_finish");
        let recording = match recorder.map(Recorder::finish) {
            None => Ok(()),
            Some(Ok(recorded)) => {
                tracing::info!(
                    "recorded {}, {} and {} in {}, {}",
                    counted(recorded.steps, "step"),
                    counted(recorded.episodes, "episode"),
                    counted(recorded.depth_frames, "depth frame"),
                    counted(recorded.files.len() as u64, "file"),
                    format::bytes(recorded.bytes)
                );
                match &outcome {
                    Ok(Outcome { saved: Some(saved), .. }) if config.evaluation.is_none() => {
                        all_recorded(recorded.frames, saved.frames)
                    }
                    _ => Ok(()),
                }
            }
            Some(Err(error)) => Err(anyhow::Error::new(error)),
        };
        Ok((outcome?, recording))
    }
}

/// Compares the frames of a run with those that the recorder has confirmed, rollout by rollout. It may have confirmed a
/// rollout that a stop then left aside.
fn all_recorded(confirmed: Option<u64>, frames: u64) -> Result<()> {
    let confirmed = confirmed.unwrap_or(0);
    anyhow::ensure!(
        confirmed >= frames,
        "the run has {frames} frames, but only of {confirmed} was every step recorded"
    );
    Ok(())
}

/// The processes of a run, as text.
pub fn shape(config: &Config) -> String {
    let learners = match config.learner.count {
        1 => String::new(),
        learners => format!("{learners} learners, "),
    };
    let ActorsConfig { count, environments_per_actor } = config.actors;
    let environments = counted(u64::from(environments_per_actor), "environment");
    format!("{learners}{} of {environments}", counted(u64::from(count), "actor"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_whose_steps_are_not_all_recorded_are_an_error() {
        assert!(all_recorded(Some(1200), 1200).is_ok());
        assert!(all_recorded(Some(1260), 1200).is_ok(), "a stop left the last rollout aside");
        let message = all_recorded(Some(1185), 1200).unwrap_err().to_string();
        assert!(message.contains("1200 frames, but only of 1185"), "{message}");
        assert!(all_recorded(None, 1200).is_err(), "no learner ever began");
    }
}
