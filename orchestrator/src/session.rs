//! One sitting of a run, from the claim on its names in shared memory to its last line: what `up` and `resume` share.

use crate::format;
use crate::identity::{Ended, Identity, RunLock, unix_now};
use crate::metrics::{History, Journal};
use crate::preflight::{disk, libtorch, memory, processor, programs, shared_memory};
use crate::recorder::{Recorder, RecorderSetup};
use crate::summary::Summary;
use crate::supervisor::machine::{End, Outcome};
use crate::supervisor::process::{Launch, Programs};
use crate::supervisor::shell::{Shell, Signals};
use crate::{remains, terminal};
use anyhow::{Context, Result};
use proto::config::{Config, DeviceChoice};
use proto::fault;
use proto::run_folder::RunFolder;
use proto::wire::{WireAddress, WireHost, WireShape};
use std::fs::OpenOptions;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Status after a second Ctrl-C: what a shell reports for a program that SIGINT ended.
const EXIT_INTERRUPTED: u8 = 130;

/// The programs, found and proven to start.
#[derive(Debug, Clone)]
pub struct Tools {
    /// Where they are.
    pub programs: Programs,
    /// What the learner computes with.
    pub torch: libtorch::Torch,
}

impl Tools {
    /// Finds both programs and has the learner load its libtorch.
    pub fn find() -> Result<Self> {
        let learner = programs::find("learner")?;
        let actor = programs::find("actor")?;
        let learner_environment = libtorch::environment()?;
        let torch = libtorch::check(&learner, &learner_environment)?;
        Ok(Self { programs: Programs { learner, actor, learner_environment }, torch })
    }
}

/// Looks at everything that could keep this configuration from running here.
pub fn preflight(config: &Config, folder: &RunFolder, tools: &Tools) -> Result<()> {
    processor::check().demand()?;
    let cuda = tools.torch.has_cuda();
    if config.learner.device == DeviceChoice::Cuda && !cuda {
        anyhow::bail!(
            "learner.device = \"cuda\", but torch {} at {} finds no CUDA device here (it finds: {}). A torch with CUDA is \
             named by LIBTORCH; `orchestrator doctor` shows what is found",
            tools.torch.version,
            tools.torch.library,
            tools.torch.devices.join(", ")
        );
    }
    let on_gpu = cuda && config.learner.device != DeviceChoice::Cpu;
    memory::check(config, on_gpu, memory::available().context("/proc/meminfo")?).demand()?;
    shared_memory::check(config).demand()?;
    disk::check(config, folder.root()).demand()
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
        let log_path = self.folder.log("orchestrator");
        let log = OpenOptions::new().create(true).append(true).open(&log_path);
        terminal::log_to_file(log.with_context(|| format!("cannot open {}", log_path.display()))?);
        tracing::info!(
            "run {} in {}, start {incarnation}; {} actors of {} environments, seed {}",
            self.identity.id,
            self.folder.root().display(),
            self.config.actors.count,
            self.config.actors.environments_per_actor,
            self.config.seed
        );
        fault::reach("orchestrator.after_lock");

        let mut history = History::read(&self.folder)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("tokio")?;
        let result = runtime.block_on(self.sit(incarnation, address, &mut history));
        // Whatever happened: no process and nothing in shared memory stays of this incarnation.
        drop(runtime);
        if let Err(error) = remains::sweep(address, Duration::from_secs(2)) {
            tracing::warn!("{error:#}");
        }
        result.map(|(outcome, recording)| (outcome, recording, history))
    }

    /// From the claim to the last process's end.
    async fn sit(
        &mut self,
        incarnation: u32,
        address: &WireAddress,
        history: &mut History,
    ) -> Result<(Outcome, Result<()>)> {
        let signals = Signals::install()?;
        // `stop` signals whoever has signed: not before a signal is a request rather than the end.
        self.lock.sign(incarnation)?;
        let run = std::path::absolute(self.folder.root()).context("run folder")?;
        let _claim = remains::claim(address, &run)?;
        let shape = WireShape {
            actors: self.config.actors.count,
            environments_per_actor: self.config.actors.environments_per_actor,
        };
        let host = WireHost::create(address, shape)?;
        fault::reach("orchestrator.after_wire");
        let setup = || RecorderSetup {
            address: address.clone(),
            shape,
            folder: self.folder.clone(),
            incarnation,
            config: self.config.clone(),
        };
        // Before the actors: none of their samples is missed.
        let recorder = self.config.recording.enabled.then(|| Recorder::start(setup())).transpose()?;
        let launch = Launch {
            programs: self.tools.programs.clone(),
            threads: self.config.learner.threads,
            folder: self.folder.clone(),
            address: address.clone(),
        };
        let journal = Journal::open(&self.folder)?;
        let shell = Shell {
            config: &self.config,
            incarnation,
            host: &host,
            recorder: recorder.as_ref(),
            history,
            journal,
            signals,
        };
        let outcome = shell.supervise(launch).await;
        fault::reach("orchestrator.before_recorder_finish");
        let recording = match recorder.map(Recorder::finish) {
            None => Ok(()),
            Some(Ok(recorded)) => {
                tracing::info!(
                    "recorded {} steps, {} episodes and {} depth frames in {} files, {}",
                    format::count(recorded.steps),
                    format::count(recorded.episodes),
                    format::count(recorded.depth_frames),
                    recorded.files.len(),
                    format::bytes(recorded.bytes)
                );
                Ok(())
            }
            Some(Err(error)) => Err(anyhow::Error::new(error)),
        };
        Ok((outcome?, recording))
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
        let incarnations = self.identity.incarnations.len() as u32;
        let summary =
            saved.map(|saved| Summary::of(&self.folder, &self.config, history, &self.identity.id, incarnations, saved));
        fault::reach("orchestrator.before_summary");
        if let Some(summary) = summary.as_ref().filter(|_| outcome.end == End::Complete) {
            summary.write(&self.folder)?;
        }
        self.note_end(how, outcome.saved.as_ref().map(|saved| (saved.frames, saved.weights.clone())), reason);
        if outcome.end != End::Complete {
            terminal::note(&format!("go on with: orchestrator resume {}", self.folder.root().display()));
        }
        if let Some(summary) = &summary {
            for line in summary.lines(&self.folder, &outcome.end, Some(wall)) {
                terminal::out(&line);
            }
        } else if let End::Stopped | End::Interrupted = outcome.end {
            terminal::out(&format!("run {} {how}: the last checkpoint stands", self.identity.id));
        }
        if let Err(error) = recording {
            tracing::error!("the recording is incomplete: {error:#}");
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
