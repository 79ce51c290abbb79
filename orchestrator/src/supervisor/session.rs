//! One session: one start of the orchestrator on a run folder, from the claim on names in shared memory to the last
//! process's end. A run's and an evaluation's alike. `run.toml` counts them as incarnations.

use super::event::{Outcome, SessionEnd};
use super::process::{Launch, LearnersNetwork};
use super::remote_hosts::RemoteHosts;
use super::shell::{Audience, Shell, Signals};
use crate::environment;
use crate::output::format::{self, counted};
use crate::output::terminal;
use crate::preflight::placement;
use crate::preflight::placement::Placement;
use crate::preflight::programs::Tools;
use crate::run::lock::RunLock;
use crate::run::remains::{self, Claim};
use anyhow::{Context, Result};
use proto::config::{ActorsConfig, Config};
use proto::hosts::Hosts;
use proto::plain_file::open_plain;
use proto::run_folder::RunFolder;
use recording::recorder::{Recorder, RecorderSetup};
use std::fs::OpenOptions;
use std::time::Duration;
use wire::{WireAddress, WireHost, WireShape, fault};

/// Status after a second Ctrl-C: what a shell reports for a program that SIGINT ended.
pub const EXIT_INTERRUPTED: u8 = 130;

/// After the end of its last process another host completes its recording: that takes so long at most.
const RECORDED: Duration = Duration::from_secs(30);
/// The same after the loss of a host: all is to end within `--host-deadline`.
const RECORDED_AFTER_LOSS: Duration = Duration::from_secs(5);

pub struct Session<'a> {
    pub folder: &'a RunFolder,
    pub config: &'a Config,
    pub incarnation: u32,
    pub address: &'a WireAddress,
    pub tools: &'a Tools,
    pub launched: bool,
}

pub struct Together {
    pub hosts: Hosts,
    pub remote_hosts: RemoteHosts,
    pub network: LearnersNetwork,
}

pub fn begin_log(folder: &RunFolder) -> Result<()> {
    let path = folder.log("orchestrator");
    let log = open_plain(&path, OpenOptions::new().create(true).append(true));
    terminal::log_to_file(log.with_context(|| format!("cannot open {}", path.display()))?);
    Ok(())
}

impl Session<'_> {
    /// Runs everything to its end; the second result is the recording's. `together`: where the run has several hosts.
    /// `signals`: made by the first of several sessions, so that none is lost between two.
    pub fn run(
        &self,
        lock: &mut RunLock,
        audience: &mut impl Audience,
        together: Option<&mut Together>,
        signals: &mut Option<Signals>,
    ) -> Result<(Outcome, Result<()>)> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("tokio")?;
        let result = runtime.block_on(self.supervise(lock, audience, together, signals));
        // In any case no process and no shared memory of this incarnation remains.
        drop(runtime);
        if let Err(error) = remains::sweep(self.address, Duration::from_secs(2)) {
            tracing::warn!("{error:#}");
        }
        result
    }

    async fn supervise(
        &self,
        lock: &mut RunLock,
        audience: &mut impl Audience,
        mut together: Option<&mut Together>,
        signals: &mut Option<Signals>,
    ) -> Result<(Outcome, Result<()>)> {
        let Self { folder, config, incarnation, address, launched, .. } = *self;
        environment::demand(config, folder.root())?;
        let signals = Signals::kept(signals, launched)?;
        // `stop` signals the process that has signed the lock. So it signs only after it handles signals as requests.
        lock.sign(incarnation)?;
        let hosts = together.as_ref().map_or_else(|| Hosts::of_one(config.shares()), |together| together.hosts);
        let network = together.as_ref().map(|together| together.network.clone());
        let Part { _claim, host, recorder, launch } = Part::begin(self, address.run_id(), hosts, 0, network)?;
        let remote_hosts = together.as_mut().map(|together| &mut together.remote_hosts);
        let scaled = config.evaluation.is_none().then_some((folder, incarnation));
        let shell = Shell { config, host: &host, recorder: recorder.as_ref(), signals, remote_hosts, scaled };
        let mut outcome = shell.supervise(launch, audience).await;
        fault::reach("orchestrator.before_recorder_finish");
        let saved = outcome.as_ref().ok().and_then(|outcome| outcome.saved.as_ref()).map(|saved| saved.frames);
        let saved = saved.filter(|_| config.evaluation.is_none());
        let mut recording = recorder.map_or(Ok(()), |recorder| recorded(recorder, saved));
        let lost = matches!(&outcome, Ok(Outcome { end: SessionEnd::HostLost(_), .. }));
        let patience = if lost { RECORDED_AFTER_LOSS } else { RECORDED };
        if let Some(together) = together
            && let [first, rest @ ..] = &together.remote_hosts.finish(saved, patience).await[..]
        {
            for missing in rest {
                tracing::error!("{missing}");
            }
            if together.remote_hosts.is_short()
                && let Ok(Outcome { end: end @ (SessionEnd::Scaled(_) | SessionEnd::Requeued), .. }) = &mut outcome
            {
                // It was to go on, and without that host it does not.
                *end = SessionEnd::HostLost(first.clone());
            }
            recording = recording.and(Err(anyhow::anyhow!("{first}")));
        }
        Ok((outcome?, recording))
    }
}

/// What a session has on one of the run's hosts.
pub struct Part {
    pub _claim: Claim,
    pub host: WireHost,
    pub recorder: Option<Recorder>,
    pub launch: Launch,
}

impl Part {
    pub fn begin(
        session: &Session<'_>,
        run_id: &str,
        hosts: Hosts,
        host: u32,
        network: Option<LearnersNetwork>,
    ) -> Result<Self> {
        let Session { folder, config, incarnation, address, tools, .. } = *session;
        let run = std::path::absolute(folder.root()).context("run folder")?;
        let claim = remains::claim(address, &run)?;
        let (shape, ranks) = (WireShape::of(config), hosts.ranks_of(host));
        let wire_host = WireHost::create_part(address, shape, ranks.clone())?;
        fault::reach("orchestrator.after_wire");
        let setup = || RecorderSetup {
            address: address.clone(),
            shape,
            run_id: run_id.to_owned(),
            host,
            ranks: ranks.clone(),
            folder: folder.clone(),
            incarnation,
            config: config.clone(),
        };
        // Before the actors: none of their samples is missed.
        let recorder = config.recording.enabled.then(|| Recorder::start(setup())).transpose()?;
        let launch = Launch {
            placement: placed(&part_of(config, hosts, host), tools)?,
            programs: tools.programs.clone(),
            environment: config.environment.clone(),
            learners: config.learner.count,
            threads: config.learner.threads,
            evaluates: config.evaluation.is_some(),
            folder: folder.clone(),
            address: address.clone(),
            first: [ranks.start, hosts.actors_of(host).start],
            network,
        };
        Ok(Self { _claim: claim, host: wire_host, recorder, launch })
    }
}

/// What one host has of a run, as a configuration for what looks at this machine.
pub fn part_of(config: &Config, hosts: Hosts, host: u32) -> Config {
    let mut part = config.clone();
    part.learner.count = hosts.ranks_of(host).len() as u32;
    part.learner.shards = config.learner.shards / config.learner.count * part.learner.count;
    part.actors.count = hosts.actors_of(host).len() as u32;
    part
}

fn placed(part: &Config, tools: &Tools) -> Result<Option<Placement>> {
    let placement = placement::placement(part, &tools.torch)?;
    if let Some(placement) = &placement {
        tracing::info!("cores: {}", placement.describe());
    }
    Ok(placement)
}

/// Completes a recording. An error if it is not all of the `frames` that were saved.
pub fn recorded(recorder: Recorder, saved: Option<u64>) -> Result<()> {
    let recorded = recorder.finish()?;
    tracing::info!(
        "recorded {}, {} and {} in {}, {}",
        counted(recorded.steps, "step"),
        counted(recorded.episodes, "episode"),
        counted(recorded.depth_frames, "depth frame"),
        counted(recorded.files.len() as u64, "file"),
        format::bytes(recorded.bytes)
    );
    saved.map_or(Ok(()), |frames| all_recorded(recorded.frames, frames))
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
