//! A session of a run that trains, from the note that it began to its last line: what `up` and `resume` share.

use super::audience::TrainingAudience;
use crate::hosts::rendezvous::{Incomplete, Rendezvous};
use crate::output::events::are_told;
use crate::output::format;
use crate::output::terminal;
use crate::preflight::all::demand_all;
use crate::preflight::programs::Tools;
use crate::run::checkpoints::newest_readable;
use crate::run::identity::{Ended, Identity, ProcessCounts, unix_now};
use crate::run::lock::RunLock;
use crate::run::scale::with_actors;
use crate::supervisor::event::{Outcome, Saved, SessionEnd};
use crate::supervisor::remote_hosts::Order;
use crate::supervisor::session::{EXIT_INTERRUPTED, Session, Together, begin_log, part_of, shape};
use crate::supervisor::shell::Signals;
use crate::training::metrics::read_history;
use crate::training::summary::{Missing, Summary};
use crate::training::wall::{Wall, signs_of_life};
use crate::training::{events, next_steps};
use anyhow::{Context, Result};
use proto::config::Config;
use proto::exit::{EXIT_HOST_LOST, EXIT_REQUEUE};
use proto::hosts::Hosts;
use proto::run_folder::{RunFolder, write_atomically};
use proto::run_state::Ending;
use proto::stage::total_frames;
use proto::trained::History;
use std::process::ExitCode;
use wire::{WireAddress, fault};

pub struct TrainingRun {
    pub folder: RunFolder,
    pub config: Config,
    pub identity: Identity,
    pub lock: RunLock,
    pub tools: Tools,
    pub started: Started,
    /// A test follows, after which it is said what can be done next.
    pub is_tested: bool,
}

#[derive(Default)]
pub struct Started {
    /// A scheduler or launcher starts it, or flags name this host. Then SIGTERM also asks for another start.
    pub launched: bool,
    pub rendezvous: Option<Rendezvous>,
}

impl Started {
    pub fn part(&self, config: &Config) -> Config {
        let hosts = self.rendezvous.as_ref().map_or(1, Rendezvous::hosts);
        part_of(config, Hosts::new(hosts, config.shares()), 0)
    }
}

enum Next {
    End(u8),
    Start(Option<Box<Before>>),
}

struct Before {
    config: Config,
    commanded_actors: Option<u32>,
}

pub fn write_config(folder: &RunFolder, config: &Config) -> Result<()> {
    let path = folder.config();
    write_atomically(&path, config.to_toml().as_bytes()).with_context(|| format!("cannot write {}", path.display()))
}

/// What is left of a session: how it ended, its recording, its figures, what is missing, and the other hosts.
type Ran = (Outcome, Result<()>, (History, Vec<Missing>), Option<Together>);

fn farewell(end: &SessionEnd, recording: &Result<()>) -> String {
    match (end, recording) {
        // What that host recorded last is lost with it.
        (SessionEnd::HostLost(reason), _) => format!("the run ends: {reason}"),
        (_, Err(error)) => format!("the run ends, and the recording is incomplete: {error:#}"),
        (SessionEnd::Failed(reason), _) => format!("the run ends: {reason}"),
        (end, Ok(())) => format!("the run is {}", end.ending()),
    }
}

impl TrainingRun {
    pub fn run(mut self) -> Result<ExitCode> {
        let (mut signals, mut scaled) = (None, None);
        loop {
            match self.start(&mut signals, scaled)? {
                Next::End(status) => return Ok(ExitCode::from(status)),
                Next::Start(before) => scaled = before,
            }
        }
    }

    fn start(&mut self, signals: &mut Option<Signals>, scaled: Option<Box<Before>>) -> Result<Next> {
        // Before the lines are removed by which it is known how long a killed one lived.
        self.identity.note_signs_of_life(&signs_of_life(&read_history(&self.folder)?));
        let (incarnation, address) = self.identity.begin_incarnation();
        self.identity.note_shape(self.shape()?);
        self.identity.write(&self.folder)?;
        match self.session(incarnation, &address, signals) {
            Ok((Outcome { end: SessionEnd::Scaled(actors), saved }, Ok(()), _, together)) => {
                let before = self.scale(actors, saved)?;
                if let Some(together) = together {
                    together.remote_hosts.order_all(&Order::Again);
                }
                Ok(Next::Start(before))
            }
            Ok((outcome, recording, left, together)) => {
                let reported = self.report(&outcome, &recording, left);
                let (status, text) = match &reported {
                    Ok(status) => (*status, farewell(&outcome.end, &recording)),
                    // Its figures cannot be written, for example.
                    Err(error) => {
                        let reason = format!("{error:#}");
                        self.note_end(Ending::Failed, None, Some(reason.clone()));
                        events::failed(&self.folder, &self.identity.id, &reason);
                        (1, format!("the run ends: {reason}"))
                    }
                };
                if let Some(together) = together {
                    together.remote_hosts.order_all(&Order::Dismiss { status, text });
                }
                reported.map(Next::End)
            }
            Err(error) => {
                self.note_end(Ending::Failed, None, Some(format!("{error:#}")));
                let incomplete = error.is::<Incomplete>();
                if incomplete {
                    tracing::error!("{error:#}");
                }
                if let (Some(Incomplete::Refuses(..)), Some(before)) = (error.downcast_ref(), scaled) {
                    // The host's refusal is the reason that counts.
                    if let Err(error) = self.take_back(*before) {
                        tracing::error!("{error:#}");
                    }
                }
                // The last of all events.
                events::failed(&self.folder, &self.identity.id, &format!("{error:#}"));
                if incomplete { Ok(Next::End(EXIT_HOST_LOST as u8)) } else { Err(error) }
            }
        }
    }

    fn hosts(&self) -> u32 {
        self.started.rendezvous.as_ref().map_or(1, Rendezvous::hosts)
    }

    fn shape(&self) -> Result<ProcessCounts> {
        let (newest, _) = newest_readable(&self.folder)?;
        let (rollout, frames) = newest.map_or((0, 0), |manifest| (manifest.rollout, manifest.frames));
        let hosts = self.hosts();
        let (learners, actors) = (self.config.learner.count, self.config.actors.count);
        Ok(ProcessCounts { hosts, learners, actors, rollout, frames })
    }

    /// Notes the end of a start that is followed by one with another number of actors. Where this machine cannot have so
    /// many, the run goes on as it was.
    fn scale(&mut self, actors: u32, saved: Option<Saved>) -> Result<Option<Box<Before>>> {
        let before = self.config.actors.count;
        let saved = saved.map(|saved| (saved.frames, saved.weights));
        self.note_end(Ending::Stopped, saved, Some(format!("goes on with {actors} actors instead of {before}")));
        let scaled = with_actors(&self.config, actors).and_then(|new| {
            demand_all(&self.started.part(&new), &self.folder, &self.tools)?;
            Ok(new)
        });
        match scaled {
            Ok(new) => {
                let commanded_actors = self.identity.commanded_actors;
                self.identity.note_scale(before);
                // First: a launcher's command must not undo it, whatever happens in between.
                self.identity.write(&self.folder)?;
                let config = std::mem::replace(&mut self.config, new);
                events::scaled(before, actors);
                write_config(&self.folder, &self.config)?;
                Ok(Some(Box::new(Before { config, commanded_actors })))
            }
            Err(error) => {
                tracing::error!("the run goes on with {before} actors, not with {actors}: {error:#}");
                Ok(None)
            }
        }
    }

    /// Gives the run the number of actors back that it had: a host has no room for the new one, and every start with that
    /// would end as this one.
    fn take_back(&mut self, Before { config, commanded_actors }: Before) -> Result<()> {
        let refused = std::mem::replace(&mut self.config, config).actors.count;
        let actors = self.config.actors.count;
        tracing::error!("it will go on with {actors} actors, not with {refused}, when it is started again");
        write_config(&self.folder, &self.config)?;
        self.identity.commanded_actors = commanded_actors;
        self.identity.write(&self.folder)
    }

    fn session(&mut self, incarnation: u32, address: &WireAddress, signals: &mut Option<Signals>) -> Result<Ran> {
        let Self { folder, config, identity, lock, tools, started, .. } = self;
        let session = Session { folder, config, incarnation, address, tools, launched: started.launched };
        begin_log(folder)?;
        tracing::info!(
            "run {} in {}, start {incarnation}; {}, seed {}, {} frames",
            identity.id,
            folder.root().display(),
            shape(config),
            config.seed,
            format::count(total_frames(&config.stages))
        );
        events::started(folder, config, identity, incarnation);
        fault::reach("orchestrator.after_lock");
        let start = identity.incarnations.last().context("a start that was begun is noted")?;
        let mut audience = TrainingAudience::open(folder, config, start)?;
        let gather = |door: &Rendezvous| door.gather(folder, &identity.id, incarnation, config);
        let mut together = started.rendezvous.as_ref().map(gather).transpose()?;
        let (outcome, recording) = session.run(lock, &mut audience, together.as_mut(), signals)?;
        let missing = if outcome.end == SessionEnd::Complete { audience.missing() } else { Vec::new() };
        Ok((outcome, recording, (audience.journal.history, missing), together))
    }

    fn report(
        &mut self,
        outcome: &Outcome,
        recording: &Result<()>,
        (history, missing): (History, Vec<Missing>),
    ) -> Result<u8> {
        let how = outcome.end.ending();
        let reason = outcome.end.reason().map(str::to_owned);
        let saved = outcome.saved.as_ref().map(|saved| (saved.frames, saved.weights.as_str()));
        let wall = Wall::of(&self.identity, &signs_of_life(&history), true);
        let summary = saved.map(|saved| Summary {
            recording_complete: self.config.recording.enabled.then_some(recording.is_ok()),
            missing,
            ..Summary::of(&self.folder, &self.config, &history, &self.identity, wall, saved)
        });
        let whole = recording.is_ok() && summary.as_ref().is_none_or(Summary::is_whole);
        fault::reach("orchestrator.before_summary");
        if let Some(summary) = summary.as_ref().filter(|_| outcome.end == SessionEnd::Complete) {
            summary.write(&self.folder)?;
        }
        fault::reach("orchestrator.after_summary");
        self.note_end(how, outcome.saved.as_ref().map(|saved| (saved.frames, saved.weights.clone())), reason);
        if let Err(error) = recording {
            tracing::error!("the recording is incomplete: {error:#}");
        }
        // The last of all events.
        events::ended(&self.folder, &self.identity.id, &outcome.end, summary.as_ref());
        if are_told() {
            // Nothing else comes on standard output.
        } else if let Some(summary) = &summary {
            for line in summary.lines(&self.config.spec().shown(), &self.folder, &outcome.end) {
                terminal::out(&line);
            }
        } else if let SessionEnd::Stopped | SessionEnd::Requeued | SessionEnd::Interrupted = outcome.end {
            terminal::out(&format!("run {} {how}: the last checkpoint stands", self.identity.id));
        }
        let recorded = summary.is_some_and(|summary| !summary.recordings.is_empty());
        let program = next_steps::program();
        let next = match outcome.end {
            SessionEnd::Complete if self.is_tested => Vec::new(),
            SessionEnd::Complete => next_steps::complete(&program, &self.folder, &self.config, recorded),
            _ => next_steps::unfinished(&program, &self.folder, self.hosts()),
        };
        for line in &next {
            terminal::note(line);
        }
        Ok(match outcome.end {
            SessionEnd::Complete | SessionEnd::Stopped if whole => 0,
            SessionEnd::Requeued if whole => EXIT_REQUEUE as u8,
            SessionEnd::Interrupted => EXIT_INTERRUPTED,
            SessionEnd::HostLost(_) => EXIT_HOST_LOST as u8,
            SessionEnd::Complete
            | SessionEnd::Stopped
            | SessionEnd::Requeued
            | SessionEnd::Scaled(_)
            | SessionEnd::Failed(_) => 1,
        })
    }

    fn note_end(&mut self, how: Ending, saved: Option<(u64, String)>, reason: Option<String>) {
        let (frames, weights) = saved.unzip();
        self.identity.end_incarnation(Ended { how, at_unix_s: unix_now(), wall_s: None, frames, weights, reason });
        if let Err(error) = self.identity.write(&self.folder) {
            tracing::warn!("{error:#}");
        }
    }
}
