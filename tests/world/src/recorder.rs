//! The recorder's thread: the real ledger in a shell that follows
//! `orchestrator/recording/src/recorder/recorder_thread.rs`.
//!
//! A recording here is a file of records of one size, each with a digest of itself: what is torn is seen.

use crate::disk::SimulatedDisk;
use crate::environment::mix;
use crate::kernel::{MILLISECOND, Next, Note, Program, SECOND, World};
use crate::model::StepName;
use crate::service::TaskId;
use crate::setup::Mutation;
use crate::wire::Observations;
use proto::disk::Disk;
use proto::record::{RecordHeader, flag};
use recording::recorder::{Ledger, Tally, Verdict};
use std::path::{Path, PathBuf};
use wire::message::{Halves, Line, observation_kind};
use wire::{Receipt, Written};

/// A killed recorder loses at most this much.
const FLUSH_INTERVAL: u64 = SECOND;
/// Without samples for this long, it is done.
const QUIET: u64 = 20 * MILLISECOND;
const FOLDER: &str = "run/recordings";
/// Numbers of a record.
const NUMBERS: usize = 5;

pub struct Recorder {
    session: usize,
    ports: Vec<u32>,
    ledger: Ledger,
    tally: Tally,
    /// The last receipts that each learner was rung for.
    told: Vec<u64>,
    halves: Halves,
    /// By column: the transition that was last accounted for.
    taken: Vec<Option<(u32, u32, u32)>>,
    pending: Vec<u8>,
    flushed: u64,
    failed: bool,
}

fn path(session: usize) -> PathBuf {
    Path::new(FOLDER).join(format!("incarnation-{session:03}.mcap"))
}

impl Recorder {
    /// A recorder of a session. Its ports are opened before any actor is started.
    pub fn new(world: &World, session: usize) -> Self {
        let config = &world.setup.config;
        Self {
            session,
            ports: vec![],
            ledger: Ledger::new(config.actors.count),
            tally: Tally::default(),
            told: vec![0; config.learner.count as usize],
            halves: Halves::of(config.actors.environments_per_actor),
            taken: vec![None; config.environments()],
            pending: vec![],
            flushed: world.now,
            failed: false,
        }
    }

    fn open(&mut self, world: &mut World, me: TaskId) {
        let services = &mut world.wires[self.session].observations;
        self.ports = services.iter_mut().filter_map(|service| service.subscribe(me).ok()).collect();
    }

    /// Takes every sample that waits; returns how many.
    fn drain(&mut self, world: &mut World) -> u64 {
        let mut taken = 0;
        for rank in 0..self.ports.len() {
            loop {
                let service = &mut world.wires[self.session].observations[rank];
                let (sample, awake) = service.receive(self.ports[rank], &mut world.dice);
                world.ring_all(awake);
                let Some(sample) = sample else { break };
                self.sample(world, &sample.value);
                taken += 1;
            }
        }
        taken
    }

    fn sample(&mut self, world: &mut World, (header, observations): &Observations) {
        match header.kind {
            observation_kind::OBSERVATIONS => {}
            observation_kind::HELLO if self.ledger.has(header.actor) => {
                world.shared[self.session].met.insert(header.actor, header.actor_incarnation);
                return;
            }
            _ => return,
        }
        let missed = self.ledger.missed();
        let verdict = self.ledger.judge(header);
        let header = *header;
        world.note(|| format!("recorder: {header:?}: {verdict:?}"));
        if self.ledger.missed() > missed {
            world.note(|| format!("recorder: exchanges of actor {} that were never seen", header.actor));
        }
        let with_transitions = match verdict {
            Verdict::News => true,
            Verdict::RestorePoint => false,
            Verdict::Repeated | Verdict::Stale => return,
            Verdict::Alien => return world.violate(format!("the recorder got a sample of nobody: {header:?}")),
        };
        let first = header.actor as usize * self.taken.len() / world.setup.config.actors.count as usize;
        let mut steps = 0;
        for (index, record) in self.halves.range(header.half).zip(observations.iter()) {
            let record = RecordHeader::of(Line::bytes(record));
            let column = first + index;
            let taken = Some((header.learner_incarnation, record.acted_episode, record.acted_step));
            if record.has(flag::ACTED) && self.taken[column] != taken {
                self.taken[column] = taken;
                if with_transitions {
                    steps += 1;
                    if world.setup.has(Mutation::LosesSteps) && world.dice.once_in(50) {
                        continue;
                    }
                    self.write(column, record.acted_episode, record.acted_step, record.outcome_hash);
                }
            }
        }
        self.tally.record(header.learner_incarnation, steps);
        let receipt = Receipt { learner_incarnation: header.learner_incarnation, step: header.step };
        world.shared[self.session].receipts.insert((header.actor, header.half), receipt);
    }

    /// Rings for each learner that has new receipts.
    fn tell(&mut self, world: &mut World, me: TaskId) {
        let shares = world.setup.config.shares();
        for (rank, told) in (0..).zip(&mut self.told) {
            let news = self.ledger.news(shares.actors_of(rank));
            if std::mem::replace(told, news) != news {
                ring_learner(world, self.session, rank, me);
            }
        }
    }

    /// Does what it is told.
    fn heed(&mut self, world: &mut World, me: TaskId, note: Note) {
        match note {
            Note::Began { learner_incarnation, frames } => self.tally.begin(learner_incarnation, frames),
            Note::Collected { learner_incarnation, rollout, frames, here } => {
                if !self.failed && !world.setup.has(Mutation::IgnoresReceipts) {
                    match self.tally.collect(learner_incarnation, rollout, [here, frames]) {
                        Ok(()) if world.setup.has(Mutation::WritesLater) => {}
                        Ok(()) => self.flush(world),
                        Err(gap) => self.fail(world, gap.to_string()),
                    }
                }
                if !self.failed {
                    let written = Written { learner_incarnation, rollout: rollout + 1 };
                    world.note(|| format!("recorder: {written:?}"));
                    world.shared[self.session].written = Some(written);
                }
                ring_learner(world, self.session, 0, me);
            }
        }
    }

    fn fail(&mut self, world: &mut World, why: String) {
        world.note(|| format!("recorder: {why}"));
        self.failed = true;
        world.shared[self.session].failure = Some(why);
    }

    fn write(&mut self, column: usize, episode: u32, step: u32, hash: u64) {
        let numbers = [column as u64, u64::from(episode), u64::from(step), hash];
        for number in numbers.into_iter().chain([mix(numbers)]) {
            self.pending.extend(number.to_le_bytes());
        }
    }

    fn flush(&mut self, world: &mut World) {
        self.flushed = world.now;
        if self.failed {
            return self.pending.clear();
        }
        match world.disk.append(&path(self.session), &self.pending) {
            Ok(()) => self.pending.clear(),
            Err(error) => self.fail(world, error.to_string()),
        }
    }
}

impl Program for Recorder {
    fn turn(&mut self, world: &mut World, me: TaskId) -> Next {
        if self.ports.is_empty() {
            self.open(world, me);
            world.shared[self.session].ready = true;
        }
        let lag = world.shared[self.session].lags_until.saturating_sub(world.now);
        if lag > 0 {
            return Next::After(lag);
        }
        let taken = self.drain(world);
        self.tell(world, me);
        while let Some(note) = world.shared[self.session].notes.pop_front() {
            self.heed(world, me, note);
        }
        if world.shared[self.session].finish {
            if taken > 0 {
                return Next::After(QUIET);
            }
            self.flush(world);
            if !self.failed && world.disk.sync_whole(&path(self.session)).is_err() {
                world.shared[self.session].failure = Some("it cannot be synchronised".to_owned());
            }
            world.shared[self.session].confirmed = self.tally.frames();
            world.shared[self.session].finished = true;
            return Next::Wait(u64::from(u32::MAX));
        }
        if world.now - self.flushed >= FLUSH_INTERVAL {
            self.flush(world);
        }
        if taken > 0 {
            return Next::After(world.dice.between(20, 300));
        }
        Next::Wait((self.flushed + FLUSH_INTERVAL - world.now).max(1))
    }
}

/// Rings for the learner with this rank.
fn ring_learner(world: &mut World, session: usize, rank: u32, me: TaskId) {
    let listeners = world.wires[session].observations[rank as usize].listeners();
    world.ring_all(listeners.into_iter().filter(|&task| task != me));
}

/// Every step in the recordings of a run, with the hash of the state that it led to. What is torn is left out.
pub fn recorded(disk: &SimulatedDisk) -> Vec<(StepName, u64)> {
    let mut steps = vec![];
    for file in disk.list(Path::new(FOLDER)).unwrap_or_default() {
        let bytes = disk.read(&file, u64::MAX).unwrap_or_default();
        for record in bytes.chunks_exact(NUMBERS * 8) {
            let number = |i: usize| {
                let mut bytes = [0; 8];
                bytes.copy_from_slice(&record[i * 8..][..8]);
                u64::from_le_bytes(bytes)
            };
            let numbers = [number(0), number(1), number(2), number(3)];
            if number(4) == mix(numbers) {
                steps.push(((numbers[0] as u32, numbers[1] as u32, numbers[2] as u32), numbers[3]));
            }
        }
    }
    steps
}
