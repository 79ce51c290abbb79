//! The product's wire, with the services, settings and waits that actors, learner and recorder have.

use crate::end::{ActorEnd, EndArgs, LearnerEnd, Place};
use anyhow::{Context, Result, ensure};
use iceoryx2::sample::Sample;
use proto::config::Config;
use proto::record::RecordHeader;
use proto::shares::Shares;
use std::collections::BTreeMap;
use std::time::Duration;
use wire::message::{ActionHeader, Line, ObservationHeader, observation_kind};
use wire::{
    ActionPublisher, ActionSubscriber, Bell, Ipc, ObservationPublisher, ObservationReaders, ObservationSubscriber,
    Sleeper, UpdateConnections, Wakeup, Wire, WireAddress, WireHost, WireShape,
};

/// Longest sleep without a look around, as in the product.
const LOOK: Duration = Duration::from_millis(250);

pub fn address(place: &Place) -> WireAddress {
    WireAddress::new(&format!("bench{}", place.cell), 1)
}

fn shape(place: &Place) -> WireShape {
    WireShape::new(Shares::of_one(place.actors), place.environments(), Config::default().spec())
}

type Received = Sample<Ipc, [Line], ObservationHeader>;

/// The learner, and in the same process the host of all services.
pub struct Learner {
    // Ports before node and host: they are dropped in this order.
    held: [BTreeMap<u32, Received>; 2],
    observations: ObservationSubscriber,
    wakeup: Wakeup,
    actors: Vec<(ActionPublisher, Bell)>,
    steps: [u64; 2],
    frames: usize,
    _wire: Wire,
    _host: WireHost,
}

impl Learner {
    pub fn open(place: &Place) -> Result<Self> {
        let (address, shape) = (address(place), shape(place));
        let host = WireHost::create(&address, shape)?;
        let wire = Wire::join(&address, shape, "learner-0")?;
        let wakeup = wire.bells().wakeup(Sleeper::Learner(0));
        let bell = |actor| wire.bells().bell([Sleeper::Actor(actor)]);
        let actors = (0..place.actors).map(|actor| Ok((wire.action_publisher(actor)?, bell(actor))));
        Ok(Self {
            held: Default::default(),
            observations: wire.observation_subscriber(0)?,
            wakeup,
            actors: actors.collect::<Result<_>>()?,
            steps: [0; 2],
            frames: place.frames as usize,
            _wire: wire,
            _host: host,
        })
    }
}

fn bytes(sample: &Received) -> &[u8] {
    Line::bytes(sample.payload())
}

impl LearnerEnd for Learner {
    fn receive(&mut self, half: u32, each: &mut dyn FnMut(u32, &[u8])) -> Result<()> {
        loop {
            while let Some(sample) = self.observations.receive().context("cannot receive observations")? {
                let ObservationHeader { actor, half, step, .. } = *sample.user_header();
                ensure!(step == self.steps[half as usize], "actor {actor} is at another step");
                self.held[half as usize].insert(actor, sample);
            }
            if self.held[half as usize].len() == self.actors.len() {
                break;
            }
            // As the product's learner.
            let missing = self.actors.len() - self.held[half as usize].len();
            self.wakeup.wait_for((missing as u32).div_ceil(2), LOOK);
        }
        self.held[half as usize].iter().for_each(|(&actor, sample)| each(actor, bytes(sample)));
        Ok(())
    }

    fn answer(&mut self, half: u32, action: u8) -> Result<()> {
        let header = ActionHeader { step: self.steps[half as usize], half, ..Default::default() };
        // As the collector does: an actor that is woken finds its slot free.
        self.held[half as usize].clear();
        for (publisher, bell) in &self.actors {
            let mut sample = publisher.loan_slice_uninit(self.frames).context("cannot send actions")?;
            *sample.user_header_mut() = header;
            sample.write_from_fn(|_| action).send().context("cannot send actions")?;
            bell.ring();
        }
        self.steps[half as usize] += 1;
        Ok(())
    }
}

pub struct Actor {
    number: u32,
    lines: usize,
    steps: [u64; 2],
    observations: ObservationPublisher,
    readers: ObservationReaders,
    bell: Bell,
    actions: ActionSubscriber,
    wakeup: Wakeup,
    _wire: Wire,
}

impl Actor {
    pub fn open(place: &Place, actor: u32) -> Result<Self> {
        let wire = Wire::join(&address(place), shape(place), &format!("actor-{actor:02}"))?;
        Ok(Self {
            number: actor,
            lines: shape(place).lines(place.frames as usize),
            steps: [0; 2],
            actions: wire.action_subscriber(actor)?,
            wakeup: wire.bells().wakeup(Sleeper::Actor(actor)),
            bell: wire.observations_bell(actor),
            observations: wire.observation_publisher(actor)?,
            readers: wire.observation_readers(actor)?,
            _wire: wire,
        })
    }
}

impl ActorEnd for Actor {
    fn send(&mut self, half: u32, pattern: u8) -> Result<()> {
        self.observations.update_connections().context("cannot connect to the learner")?;
        let mut sample = self.observations.loan_slice_uninit(self.lines).context("no free slot")?;
        *sample.user_header_mut() = ObservationHeader {
            step: self.steps[half as usize],
            kind: observation_kind::OBSERVATIONS,
            actor: self.number,
            half,
            ..Default::default()
        };
        let slots = sample.payload_mut();
        // SAFETY: the slots are ours to write.
        unsafe { slots.as_mut_ptr().write_bytes(pattern, slots.len()) };
        // SAFETY: every byte was written, and a Line of any bytes is valid.
        let receivers = unsafe { sample.assume_init() }.send().context("cannot send observations")?;
        self.bell.ring_counted();
        ensure!(receivers == self.readers.count(), "{receivers} of {} readers got a sample", self.readers.count());
        self.steps[half as usize] += 1;
        Ok(())
    }

    fn wait(&mut self) -> Result<(u32, u8)> {
        loop {
            if let Some(sample) = self.actions.receive().context("cannot receive actions")? {
                return Ok((sample.user_header().half, sample.payload()[0]));
            }
            self.wakeup.wait(LOOK);
        }
    }
}

/// A second reader of the observations, which looks at what the product's recorder looks at in a step without its
/// frame. It runs until its standard input closes or it is killed.
pub fn record(args: &EndArgs) -> Result<()> {
    wire::lifeline::hold(|| std::process::exit(0)).context("cannot watch standard input")?;
    let shape = shape(&args.place);
    let wire = Wire::join(&address(&args.place), shape, "recorder")?;
    let wakeup = wire.bells().wakeup(Sleeper::Recorder);
    let observations = wire.observation_subscriber(0)?;
    println!("ready");
    let mut seen = 0_u64;
    loop {
        while let Some(sample) = observations.receive().context("cannot receive observations")? {
            let records = sample.payload().chunks_exact(shape.record_lines);
            let hashes = records.map(|record| RecordHeader::of(Line::bytes(record)).outcome_hash);
            seen = std::hint::black_box(hashes.fold(seen, u64::wrapping_add));
        }
        wakeup.wait(LOOK);
    }
}
