//! A session of a run that trains, from the note that it began to its last line: what `up` and `resume` share.

use super::audience::TrainingAudience;
use crate::preflight::tools::Tools;
use crate::run::identity::{Ended, Identity, unix_now};
use crate::run::lock::RunLock;
use crate::showing::format;
use crate::showing::terminal;
use crate::supervisor::event::{Outcome, SessionEnd};
use crate::supervisor::session::{EXIT_INTERRUPTED, Session, shape};
use crate::training::next_steps;
use crate::training::summary::Summary;
use crate::training::wall::{Last, Wall};
use anyhow::Result;
use proto::config::Config;
use proto::run_folder::RunFolder;
use proto::run_state::Ending;
use proto::stage::total_frames;
use proto::trained::History;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use wire::{WireAddress, fault};

/// A run that trains, whose folder has been made.
pub struct TrainingRun {
    /// The run folder, with config.toml in it.
    pub folder: RunFolder,
    /// Contents of config.toml.
    pub config: Config,
    /// Contents of run.toml.
    pub identity: Identity,
    /// The right to run it.
    pub lock: RunLock,
    /// Programs.
    pub tools: Tools,
}

impl TrainingRun {
    /// Runs it and reports; the exit status of the program.
    pub fn run(mut self) -> Result<ExitCode> {
        let begin = Instant::now();
        // Before the lines are removed by which it is known how long a killed one lived.
        self.identity.note_signs_of_life(&Wall::signs_of_life(&self.folder)?);
        let (incarnation, address) = self.identity.begin_incarnation();
        self.identity.write(&self.folder)?;
        match self.session(incarnation, &address) {
            Ok((outcome, recording, history)) => self.report(&outcome, &recording, &history, begin.elapsed()),
            Err(error) => {
                self.note_end(Ending::Failed, None, Some(format!("{error:#}")));
                Err(error)
            }
        }
    }

    /// Everything between the note that it began and the note how it ended.
    fn session(&mut self, incarnation: u32, address: &WireAddress) -> Result<(Outcome, Result<()>, History)> {
        let Self { folder, config, identity, lock, tools } = self;
        let session = Session { folder, config, incarnation, address, tools };
        session.begin_log()?;
        tracing::info!(
            "run {} in {}, start {incarnation}; {}, seed {}, {} frames",
            identity.id,
            folder.root().display(),
            shape(config),
            config.seed,
            format::count(total_frames(&config.stages))
        );
        fault::reach("orchestrator.after_lock");
        let mut audience = TrainingAudience::open(folder, config, incarnation)?;
        let (outcome, recording) = session.run(lock, &mut audience)?;
        Ok((outcome, recording, audience.journal.history))
    }

    fn report(
        mut self,
        outcome: &Outcome,
        recording: &Result<()>,
        history: &History,
        wall: Duration,
    ) -> Result<ExitCode> {
        let how = outcome.end.ending();
        let reason = outcome.end.reason().map(str::to_owned);
        let saved = outcome.saved.as_ref().map(|saved| (saved.frames, saved.weights.as_str()));
        let wall = Wall::read(&self.folder, &self.identity, Last::Took(wall))?;
        let summary = saved.map(|saved| Summary {
            recording_complete: self.config.recording.enabled.then_some(recording.is_ok()),
            ..Summary::of(&self.folder, &self.config, history, &self.identity, wall, saved)
        });
        fault::reach("orchestrator.before_summary");
        if let Some(summary) = summary.as_ref().filter(|_| outcome.end == SessionEnd::Complete) {
            summary.write(&self.folder)?;
        }
        fault::reach("orchestrator.after_summary");
        self.note_end(how, outcome.saved.as_ref().map(|saved| (saved.frames, saved.weights.clone())), reason);
        if let Some(summary) = &summary {
            for line in summary.lines(&self.folder, &outcome.end) {
                terminal::out(&line);
            }
        } else if let SessionEnd::Stopped | SessionEnd::Interrupted = outcome.end {
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
            SessionEnd::Complete | SessionEnd::Stopped if recording.is_ok() => ExitCode::SUCCESS,
            SessionEnd::Interrupted => ExitCode::from(EXIT_INTERRUPTED),
            SessionEnd::Complete | SessionEnd::Stopped | SessionEnd::Failed(_) => ExitCode::FAILURE,
        })
    }

    fn note_end(&mut self, how: Ending, saved: Option<(u64, String)>, reason: Option<String>) {
        let (frames, weights) = saved.unzip();
        self.identity.end_incarnation(Ended { how, at_unix_s: unix_now(), frames, weights, reason });
        if let Err(error) = self.identity.write(&self.folder) {
            tracing::warn!("{error:#}");
        }
    }
}
