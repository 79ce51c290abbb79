//! The recorder's thread: shared memory in, messages out.

use super::ledger::{Ledger, Verdict};
use super::note::{Note, RecorderError, RecorderSetup, RecordingSummary, now_ns};
use super::scribe::{Counts, Scribe};
use super::segment::{Preamble, SegmentError, Segments};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};
use wire::message::{Halves, Observation, ObservationHeader, observation_kind};
use wire::{Bells, ObservationSubscriber, PREFIX_MARK, ThreadBell, Wire, WireError};

/// A killed recorder loses at most this much.
const FLUSH_INTERVAL: Duration = Duration::from_secs(1);
/// After the finish message: the required time without samples, and the longest time to wait for it.
const QUIET: Duration = Duration::from_millis(20);
const DRAIN_DEADLINE: Duration = Duration::from_secs(5);

/// Runs until a note asks it to finish. `bell` rings when there are notes. Sends on `ready` once the subscriber exists;
/// an error before that is returned.
pub fn run(
    setup: &RecorderSetup,
    notes: &Receiver<(u64, Note)>,
    bell: &ThreadBell,
    failure: &OnceLock<String>,
    ready: &Sender<()>,
) -> Result<RecordingSummary, RecorderError> {
    let wire = Wire::join(&setup.address, setup.shape, "recorder")?;
    let learners = 0..setup.shape.shares.learners();
    let subscribers: Vec<_> =
        learners.clone().map(|rank| wire.observation_subscriber(rank)).collect::<Result<_, WireError>>()?;
    let wakeups: Vec<_> = learners.map(|rank| wire.observations_wakeup(rank)).collect::<Result<_, WireError>>()?;
    let bells = Bells::new()?;
    let waiting = bells.attach(&wakeups, bell)?;
    let mut desk = Desk::new(setup, failure)?;
    // The orchestrator may have given up waiting; then its end of the notes is closed too.
    let _ = ready.send(());

    let mut flushed = Instant::now();
    loop {
        if let Err(error) = waiting.wait(FLUSH_INTERVAL.saturating_sub(flushed.elapsed())) {
            tracing::debug!("recorder: {error}");
            // Without the bells it still sees every sample, only later.
            std::thread::sleep(Duration::from_millis(1));
        }
        drain(&subscribers, &mut desk)?;
        let mut finish = false;
        loop {
            match notes.try_recv() {
                Ok((_, Note::Finish)) | Err(std::sync::mpsc::TryRecvError::Disconnected) => {
                    finish = true;
                    break;
                }
                Ok((time_ns, note)) => desk.note(time_ns, note),
                Err(std::sync::mpsc::TryRecvError::Empty) => break,
            }
        }
        if finish {
            break;
        }
        if flushed.elapsed() >= FLUSH_INTERVAL {
            desk.attempt(|scribe| scribe.segments().flush());
            flushed = Instant::now();
        }
    }
    let deadline = Instant::now() + DRAIN_DEADLINE;
    while drain(&subscribers, &mut desk)? > 0 && Instant::now() < deadline {
        // What must be seen is that nothing comes: there is no bell for that.
        std::thread::sleep(QUIET);
    }
    desk.finish()
}

/// Takes every sample that waits; returns how many.
fn drain(subscribers: &[ObservationSubscriber], desk: &mut Desk<'_>) -> Result<u64, WireError> {
    let mut taken = 0;
    for subscriber in subscribers {
        while let Some(sample) = subscriber
            .receive()
            .map_err(|cause| WireError::Port { service: "observations".to_owned(), cause: format!("{cause:?}") })?
        {
            // Copied once, then checked: what lies in shared memory can change meanwhile.
            let header = *sample.user_header();
            desk.sample(&header, sample.payload());
            taken += 1;
        }
    }
    Ok(taken)
}

/// Where samples and notes arrive; it passes on new ones while writing still works.
struct Desk<'a> {
    /// None after a failed write.
    scribe: Option<Scribe>,
    ledger: Ledger,
    halves: Halves,
    failure: &'a OnceLock<String>,
    /// Times never go back, whatever the clock does.
    time_ns: u64,
    aliens: u64,
    missed: u64,
}

impl<'a> Desk<'a> {
    fn new(setup: &RecorderSetup, failure: &'a OnceLock<String>) -> Result<Self, SegmentError> {
        let time_ns = now_ns();
        let preamble = Preamble {
            run_id: run_id(setup.address.prefix()).to_owned(),
            incarnation: setup.incarnation,
            config: setup.config.clone(),
        };
        let segments = Segments::create(setup.folder.clone(), preamble, time_ns)?;
        let scribe = Scribe::new(segments, setup.shape, setup.incarnation, &setup.config);
        Ok(Self {
            scribe: Some(scribe),
            ledger: Ledger::new(setup.shape.shares.actors()),
            halves: Halves::of(setup.shape.environments_per_actor),
            failure,
            time_ns,
            aliens: 0,
            missed: 0,
        })
    }

    fn sample(&mut self, header: &ObservationHeader, observations: &[Observation]) {
        if header.kind != observation_kind::OBSERVATIONS {
            return;
        }
        let fits = header.half < self.halves.count() && self.halves.range(header.half).len() == observations.len();
        let with_transitions = match if fits { self.ledger.judge(header) } else { Verdict::Alien } {
            Verdict::News => true,
            Verdict::RestorePoint => false,
            Verdict::Repeated | Verdict::Stale => return,
            Verdict::Alien => {
                self.aliens += 1;
                if self.aliens == 1 {
                    tracing::warn!(?header, "recorder: left out a sample that fits no actor of this run");
                }
                return;
            }
        };
        if self.ledger.missed() > self.missed {
            self.missed = self.ledger.missed();
            tracing::warn!(missed = self.missed, actor = header.actor, "recorder: exchanges that were never seen");
        }
        let time_ns = self.tick(now_ns());
        self.attempt(|scribe| scribe.observations(time_ns, header, observations, with_transitions));
    }

    fn note(&mut self, time_ns: u64, note: Note) {
        let time_ns = self.tick(time_ns);
        self.attempt(|scribe| match note {
            Note::Trained(trained) => scribe.metrics(time_ns, &trained),
            Note::Stage(stage) => scribe.stage(time_ns, &stage),
            Note::Validation(figures) => scribe.validation(time_ns, &figures),
            Note::Log { level, process, line } => scribe.log(time_ns, level, &process, line),
            Note::Finish => Ok(()),
        });
    }

    fn tick(&mut self, time_ns: u64) -> u64 {
        self.time_ns = self.time_ns.max(time_ns);
        self.time_ns
    }

    /// Writes, unless writing has failed before. The first failure ends the recording but not the draining.
    fn attempt(&mut self, write: impl FnOnce(&mut Scribe) -> Result<(), SegmentError>) {
        let Some(scribe) = &mut self.scribe else { return };
        if let Err(error) = write(scribe) {
            let message = RecorderError::from(error).to_string();
            tracing::error!("recording ends here, and the run is saved and ended: {message}");
            // Only this thread sets it, and only once: the scribe is gone afterwards.
            let _ = self.failure.set(message);
            if let Some(scribe) = self.scribe.take() {
                scribe.into_segments().abandon();
            }
        }
    }

    fn finish(mut self) -> Result<RecordingSummary, RecorderError> {
        self.attempt(|scribe| scribe.segments().finish());
        let Some(scribe) = self.scribe else {
            return Err(RecorderError::Failed(self.failure.get().cloned().unwrap_or_default()));
        };
        let Counts { steps, episodes, depth_frames } = scribe.counts();
        let segments = scribe.into_segments();
        Ok(RecordingSummary {
            files: segments.files().to_vec(),
            steps,
            episodes,
            depth_frames,
            bytes: segments.bytes(),
        })
    }
}

/// The run id in a wire address's prefix.
fn run_id(prefix: &str) -> &str {
    let rest = prefix.strip_prefix(PREFIX_MARK).unwrap_or(prefix);
    rest.split('_').next().unwrap_or(rest)
}
