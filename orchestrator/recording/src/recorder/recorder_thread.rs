use super::ledger::{Ledger, Verdict};
use super::message_writer::{Counts, MessageWriter};
use super::note::{Note, OBSERVATIONS, RecorderSetup, RecordingSummary, now_ns};
use super::segment::{Preamble, Segments};
use super::tally::Tally;
use crate::declared::Declared;
use anyhow::{Context, Result, bail};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, Sender};
use std::time::{Duration, Instant};
use wire::fault;
use wire::message::{Halves, Line, ObservationHeader, observation_kind};
use wire::warning_limiter::WarningLimiter;
use wire::{Bell, ObservationSubscriber, Receipt, ReceiptBook, Sleeper, Wire, WireError, WireShape, Written};

/// A killed recorder loses at most this much.
const FLUSH_INTERVAL: Duration = Duration::from_secs(1);
/// After the finish message: the required time without samples, and the longest time to wait for it.
const QUIET: Duration = Duration::from_millis(20);
const DRAIN_DEADLINE: Duration = Duration::from_secs(5);

/// Runs until a note asks it to finish; the recorder's bell rings when there are notes, too. Sends on `ready` once the
/// subscriber exists; an error before that is returned.
pub fn run(
    setup: &RecorderSetup,
    notes: &Receiver<(u64, Note)>,
    failure: &OnceLock<String>,
    ready: &Sender<()>,
) -> Result<RecordingSummary> {
    let wire = Wire::join(&setup.address, setup.shape, "recorder").context(OBSERVATIONS)?;
    let ranks = setup.ranks.clone();
    let subscribers = ranks.map(|rank| wire.observation_subscriber(rank)).collect::<Result<Vec<_>, WireError>>();
    let subscribers = subscribers.context(OBSERVATIONS)?;
    let wakeup = wire.bells().wakeup(Sleeper::Recorder);
    let mut learners = Learners::of(&wire, setup);
    let book = ReceiptBook::open(&setup.address, setup.shape.shares.actors()).context(OBSERVATIONS)?;
    let mut state = RecorderState::new(setup, failure, &book)?;
    // The orchestrator may have given up waiting; then its end of the notes is closed too.
    let _ = ready.send(());

    let mut flushed = Instant::now();
    loop {
        book.beat();
        wakeup.wait(FLUSH_INTERVAL.saturating_sub(flushed.elapsed()));
        drain(&subscribers, &mut state).inspect_err(|_| book.fail()).context(OBSERVATIONS)?;
        learners.tell(&state.ledger);
        let mut finish = false;
        loop {
            match notes.try_recv() {
                Ok((_, Note::Finish)) | Err(std::sync::mpsc::TryRecvError::Disconnected) => {
                    finish = true;
                    break;
                }
                Ok((time_ns, note)) => {
                    if state.note(time_ns, note) {
                        flushed = Instant::now();
                        learners.bells.first().into_iter().for_each(Bell::ring);
                    }
                }
                Err(std::sync::mpsc::TryRecvError::Empty) => break,
            }
        }
        if finish {
            break;
        }
        if flushed.elapsed() >= FLUSH_INTERVAL {
            state.attempt(|message_writer| message_writer.segments().flush());
            flushed = Instant::now();
        }
    }
    let deadline = Instant::now() + DRAIN_DEADLINE;
    while drain(&subscribers, &mut state).context(OBSERVATIONS)? > 0 && Instant::now() < deadline {
        // What must be seen is that nothing comes: there is no bell for that.
        std::thread::sleep(QUIET);
    }
    state.finish()
}

fn drain(subscribers: &[ObservationSubscriber], state: &mut RecorderState<'_>) -> Result<u64, WireError> {
    let mut taken = 0;
    for subscriber in subscribers {
        while let Some(sample) = subscriber
            .receive()
            .map_err(|cause| WireError::Port { service: "observations".to_owned(), cause: format!("{cause:?}") })?
        {
            fault::reach("recorder.after_receive");
            // Copied once, then checked: what lies in shared memory can change meanwhile.
            let header = *sample.user_header();
            state.sample(&header, sample.payload());
            state.book.beat();
            taken += 1;
        }
    }
    Ok(taken)
}

struct Learners {
    shape: WireShape,
    first: u32,
    bells: Vec<Bell>,
    told: Vec<Told>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Told {
    complete: [Option<Receipt>; 2],
    news: u64,
}

impl Learners {
    fn of(wire: &Wire, setup: &RecorderSetup) -> Self {
        let bells: Vec<_> = setup.ranks.clone().map(|rank| wire.bells().bell([Sleeper::Learner(rank)])).collect();
        Self { shape: setup.shape, first: setup.ranks.start, told: vec![Told::default(); bells.len()], bells }
    }

    /// Rings for each learner that now has the receipts of all its actors for the next exchange of a half; for other
    /// receipts, with which a learner may go on where those act who are ready, it is rung, counted.
    fn tell(&mut self, ledger: &Ledger) {
        for ((rank, bell), told) in (self.first..).zip(&self.bells).zip(&mut self.told) {
            let actors = self.shape.shares.actors_of(rank);
            let now =
                Told { complete: [0, 1].map(|half| ledger.complete(actors.clone(), half)), news: ledger.news(actors) };
            if now.complete != told.complete {
                bell.ring();
            } else if now.news != told.news {
                bell.ring_counted();
            }
            *told = now;
        }
    }
}

struct RecorderState<'a> {
    /// None after a failed write.
    message_writer: Option<MessageWriter>,
    ledger: Ledger,
    tally: Tally,
    book: &'a ReceiptBook,
    halves: Halves,
    lines: [usize; 2],
    failure: &'a OnceLock<String>,
    /// Times never go back, whatever the clock does.
    time_ns: u64,
    missed: u64,
    limiter: WarningLimiter,
}

impl<'a> RecorderState<'a> {
    fn new(setup: &RecorderSetup, failure: &'a OnceLock<String>, book: &'a ReceiptBook) -> Result<Self> {
        let time_ns = now_ns();
        let preamble = Preamble {
            run_id: setup.run_id.clone(),
            host: setup.host,
            incarnation: setup.incarnation,
            config: setup.config.clone(),
        };
        let segments = Segments::create(setup.folder.clone(), preamble, time_ns)?;
        let declared = Declared::of(&setup.config).map_err(anyhow::Error::msg)?;
        let message_writer = MessageWriter::new(segments, setup.shape, setup.incarnation, &setup.config, declared);
        let halves = Halves::of(setup.shape.environments_per_actor);
        Ok(Self {
            message_writer: Some(message_writer),
            ledger: Ledger::new(setup.shape.shares.actors()),
            tally: Tally::default(),
            book,
            halves,
            lines: [0, halves.count() - 1].map(|half| setup.shape.lines(halves.range(half).len())),
            failure,
            time_ns,
            missed: 0,
            limiter: WarningLimiter::default(),
        })
    }

    fn sample(&mut self, header: &ObservationHeader, records: &[Line]) {
        match header.kind {
            observation_kind::OBSERVATIONS => {}
            observation_kind::HELLO if self.ledger.has(header.actor) => {
                return self.book.meet(header.actor, header.actor_incarnation);
            }
            _ => return,
        }
        let fits = header.half < self.halves.count() && self.lines[header.half as usize] == records.len();
        let with_transitions = match if fits { self.ledger.judge(header) } else { Verdict::Alien } {
            Verdict::News => true,
            Verdict::RestorePoint => false,
            Verdict::Repeated | Verdict::Stale => return,
            Verdict::Alien => {
                let text = format_args!("recorder: left out a sample that fits no actor of this run: {header:?}");
                return self.limiter.warn("samples that fit no actor", text);
            }
        };
        if self.ledger.missed() > self.missed {
            self.missed = self.ledger.missed();
            if self.limiter.due("exchanges missed", Instant::now()).is_some() {
                let (missed, actor) = (self.missed, header.actor);
                tracing::error!(missed, actor, "recorder: exchanges that were never seen");
            }
        }
        let time_ns = self.tick(now_ns());
        let mut steps = 0;
        self.attempt(|message_writer| {
            steps = message_writer.observations(time_ns, header, records, with_transitions)?;
            Ok(())
        });
        let ObservationHeader { actor, half, learner_incarnation, step, .. } = *header;
        self.tally.record(learner_incarnation, steps);
        // Also after a failure: the learner goes on until it hears of that.
        self.book.take(actor, half, Receipt { learner_incarnation, step });
    }

    /// Writes a note down; true if a learner may wait for what was done.
    fn note(&mut self, time_ns: u64, note: Note) -> bool {
        let time_ns = self.tick(time_ns);
        match note {
            Note::Began { learner_incarnation, frames } => self.tally.begin(learner_incarnation, frames),
            Note::Collected { learner_incarnation, rollout, frames, here } => {
                self.collected(learner_incarnation, rollout, [here, frames]);
                return true;
            }
            note => self.attempt(|message_writer| write_note(message_writer, time_ns, note)),
        }
        false
    }

    /// A rollout is collected: if all of it is there, it is written out and the learner may train on it.
    fn collected(&mut self, learner_incarnation: u32, rollout: u64, frames: [u64; 2]) {
        if self.message_writer.is_none() {
            return;
        }
        match self.tally.collect(learner_incarnation, rollout, frames) {
            Ok(()) => self.attempt(|message_writer| message_writer.segments().flush()),
            Err(gap) => self.fail(&gap.into()),
        }
        if self.message_writer.is_some() {
            self.book.write(Written { learner_incarnation, rollout: rollout + 1 });
        }
    }

    fn tick(&mut self, time_ns: u64) -> u64 {
        self.time_ns = self.time_ns.max(time_ns);
        self.time_ns
    }

    /// Writes, unless writing has failed before. The first failure ends the recording but not the draining.
    fn attempt(&mut self, write: impl FnOnce(&mut MessageWriter) -> Result<()>) {
        let Some(message_writer) = &mut self.message_writer else { return };
        if let Err(error) = write(message_writer) {
            self.fail(&error);
        }
    }

    fn fail(&mut self, error: &anyhow::Error) {
        let message = format!("{error:#}");
        tracing::error!("recording ends here, and the run is saved and ended: {message}");
        // Only this thread sets it, and only once: the message writer is gone afterwards.
        let _ = self.failure.set(message);
        self.book.fail();
        if let Some(message_writer) = self.message_writer.take() {
            message_writer.into_segments().abandon();
        }
    }

    fn finish(mut self) -> Result<RecordingSummary> {
        self.attempt(MessageWriter::finish);
        let Some(message_writer) = self.message_writer else {
            bail!(self.failure.get().cloned().unwrap_or_default());
        };
        let Counts { steps, episodes, depth_frames } = message_writer.counts;
        let segments = message_writer.into_segments();
        Ok(RecordingSummary {
            files: segments.files.clone(),
            steps,
            episodes,
            depth_frames,
            bytes: segments.bytes(),
            frames: self.tally.frames(),
        })
    }
}

fn write_note(message_writer: &mut MessageWriter, time_ns: u64, note: Note) -> Result<()> {
    match note {
        Note::Trained(trained) => message_writer.metrics(time_ns, &trained),
        Note::Stage(stage) => message_writer.stage(time_ns, &stage),
        Note::Validation(figures) => message_writer.validation(time_ns, &figures),
        Note::Log { level, process, line } => message_writer.log(time_ns, level, &process, line),
        Note::Began { .. } | Note::Collected { .. } | Note::Finish => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::Config;
    use proto::shares::Shares;
    use wire::{Bells, WireAddress, WireHost};

    #[test]
    fn a_learner_is_rung_for_every_receipt_and_at_once_for_the_last_of_a_half() {
        // One half and two.
        assert_rung(1);
        assert_rung(2);
    }

    fn assert_rung(environments_per_actor: u32) {
        const LONG: Duration = Duration::from_secs(20);
        const SHORT: Duration = Duration::from_millis(30);
        let shape = WireShape::new(Shares::of_one(2), environments_per_actor, Config::default().spec());
        let address = WireAddress::new(&format!("rtell{}", std::process::id()), environments_per_actor);
        let host = WireHost::create(&address, shape).unwrap();
        {
            let bells = Bells::open(&address, shape).unwrap();
            let learner = bells.wakeup(Sleeper::Learner(0));
            let own = vec![bells.bell([Sleeper::Learner(0)])];
            let mut learners = Learners { shape, first: 0, bells: own, told: vec![Told::default()] };
            let mut ledger = Ledger::new(2);
            let mut tell = |samples: &[(u32, u64)]| {
                for &(actor, step) in samples {
                    ledger.judge(&ObservationHeader { actor, step, learner_incarnation: 1, ..Default::default() });
                }
                learners.tell(&ledger);
            };
            let wakes = |counted, longest| {
                let began = Instant::now();
                learner.wait_for(counted, longest);
                began.elapsed() < longest / 2
            };
            learner.wait(Duration::ZERO);
            tell(&[(0, 0)]);
            assert!(wakes(1, LONG), "who waits for any receipt");
            tell(&[(0, 1)]);
            assert!(!wakes(2, SHORT), "who waits for more than that");
            tell(&[(1, 0)]);
            assert!(wakes(9, LONG), "a half has come from all");
            tell(&[(1, 0)]);
            assert!(!wakes(1, SHORT), "nothing is new");
        }
        drop(host);
        address.sweep().unwrap();
    }
}
