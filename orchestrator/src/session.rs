//! One sitting of a run that trains, from the note that it began to its last line: what `up` and `resume` share.

use crate::format::{self, counted};
use crate::identity::{Ended, Identity, RunLock, unix_now};
use crate::metrics::History;
use crate::next_steps;
use crate::preflight::{device, disk, memory, processor, shared_memory};
pub use crate::sitting::Tools;
use crate::sitting::{EXIT_INTERRUPTED, Sitting};
use crate::summary::Summary;
use crate::supervisor::event::{End, Outcome};
use crate::terminal;
use crate::training::Training;
use crate::wall::{Last, Wall};
use anyhow::{Context, Result};
use proto::config::{ActorsConfig, Config};
use proto::run_folder::RunFolder;
use proto::stage::total_frames;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use wire::WireAddress;
use wire::fault;

/// Looks at everything that could keep this configuration from running here.
pub fn preflight(config: &Config, folder: &RunFolder, tools: &Tools) -> Result<()> {
    processor::check().demand()?;
    device::check(config, &tools.torch).demand()?;
    let on_gpu = device::is_cuda(config, &tools.torch);
    memory::check(config, on_gpu, memory::available().context("/proc/meminfo")?).demand()?;
    shared_memory::check(config).demand()?;
    disk::check(config, folder.root()).demand()
}

/// The processes of a run, in words.
pub fn shape(config: &Config) -> String {
    let learners = match config.learner.count {
        1 => String::new(),
        learners => format!("{learners} learners, "),
    };
    let ActorsConfig { count, environments_per_actor } = config.actors;
    let environments = counted(u64::from(environments_per_actor), "environment");
    format!("{learners}{} of {environments}", counted(u64::from(count), "actor"))
}

/// What a sitting starts from.
pub struct Session {
    /// The run folder, with config.toml in it.
    pub folder: RunFolder,
    /// What config.toml says.
    pub config: Config,
    /// What run.toml says.
    pub identity: Identity,
    /// The right to run it.
    pub lock: RunLock,
    /// Programs.
    pub tools: Tools,
}

impl Session {
    /// Runs it and reports; the exit status of the program.
    pub fn run(mut self) -> Result<ExitCode> {
        let begin = Instant::now();
        let (incarnation, address) = self.identity.begin_incarnation();
        self.identity.write(&self.folder)?;
        match self.sitting(incarnation, &address) {
            Ok((outcome, recording, history)) => self.report(&outcome, &recording, &history, begin.elapsed()),
            Err(error) => {
                self.note_end("failed", None, Some(format!("{error:#}")));
                Err(error)
            }
        }
    }

    /// Everything between the note that it began and the note how it ended.
    fn sitting(&mut self, incarnation: u32, address: &WireAddress) -> Result<(Outcome, Result<()>, History)> {
        let Self { folder, config, identity, lock, tools } = self;
        let sitting = Sitting { folder, config, incarnation, address, tools };
        sitting.begin_log()?;
        tracing::info!(
            "run {} in {}, start {incarnation}; {}, seed {}, {} frames",
            identity.id,
            folder.root().display(),
            shape(config),
            config.seed,
            format::count(total_frames(&config.stages))
        );
        fault::reach("orchestrator.after_lock");
        let mut training = Training::open(folder, config, incarnation)?;
        let (outcome, recording) = sitting.run(lock, &mut training)?;
        Ok((outcome, recording, training.history))
    }

    fn report(
        mut self,
        outcome: &Outcome,
        recording: &Result<()>,
        history: &History,
        wall: Duration,
    ) -> Result<ExitCode> {
        let how = outcome.end.word();
        let reason = match &outcome.end {
            End::Failed(reason) => Some(reason.clone()),
            End::Complete | End::Stopped | End::Interrupted => None,
        };
        let saved = outcome.saved.as_ref().map(|saved| (saved.frames, saved.weights.as_str()));
        let wall = Wall::read(&self.folder, &self.identity, Last::Took(wall))?;
        let summary = saved.map(|saved| Summary::of(&self.folder, &self.config, history, &self.identity, wall, saved));
        fault::reach("orchestrator.before_summary");
        if let Some(summary) = summary.as_ref().filter(|_| outcome.end == End::Complete) {
            summary.write(&self.folder)?;
        }
        self.note_end(how, outcome.saved.as_ref().map(|saved| (saved.frames, saved.weights.clone())), reason);
        if let Some(summary) = &summary {
            for line in summary.lines(&self.folder, &outcome.end) {
                terminal::out(&line);
            }
        } else if let End::Stopped | End::Interrupted = outcome.end {
            terminal::out(&format!("run {} {how}: the last checkpoint stands", self.identity.id));
        }
        if let Err(error) = recording {
            tracing::error!("the recording is incomplete: {error:#}");
        }
        let recorded = summary.is_some_and(|summary| !summary.recordings.is_empty());
        let preset = &self.config.preset;
        for line in next_steps::lines(&next_steps::program(), &self.folder, &outcome.end, preset, recorded) {
            terminal::note(&line);
        }
        Ok(match outcome.end {
            End::Complete | End::Stopped if recording.is_ok() => ExitCode::SUCCESS,
            End::Interrupted => ExitCode::from(EXIT_INTERRUPTED),
            End::Complete | End::Stopped | End::Failed(_) => ExitCode::FAILURE,
        })
    }

    fn note_end(&mut self, how: &str, saved: Option<(u64, String)>, reason: Option<String>) {
        let (frames, weights) = saved.unzip();
        self.identity.end_incarnation(Ended { how: how.to_owned(), at_unix_s: unix_now(), frames, weights, reason });
        if let Err(error) = self.identity.write(&self.folder) {
            tracing::warn!("{error:#}");
        }
    }
}
