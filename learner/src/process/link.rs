//! The learner's ports in shared memory. All on the thread that made them.

use super::ringers::Ringers;
use crate::collector::{ActionBatch, HalfSample};
use crate::record::Frame;
use anyhow::{Context, Result};
use iceoryx2::port::ReceiveError;
use iceoryx2::sample::Sample as IoxSample;
use proto::camera::DepthFrame;
use proto::config::Config;
use std::time::Duration;
use wire::fault;
use wire::message::{EnvironmentState, Line, ObservationHeader, RestoreHeader, StageAnnouncement};
use wire::{
    ActionPublisher, Bell, Ipc, ObservationSubscriber, Receipt, Receipts, RestorePublisher, Sleeper, StageSubscriber,
    Standstill, Wakeup, Wire, WireAddress, WireShape, Written,
};

/// A received sample: borrowed from shared memory until it is dropped. A subscriber may hold two of each actor.
#[derive(Debug)]
pub struct Sample {
    borrowed: IoxSample<Ipc, [Line], ObservationHeader>,
    /// All but images of whole numbers, copied before anything is checked: what lies in shared memory can change between the check
    /// and the use. Every value of a pixel is sound, so the images stay where they are.
    small: Vec<Line>,
    frame: Frame,
}

impl Sample {
    fn of(borrowed: IoxSample<Ipc, [Line], ObservationHeader>, frame: Frame) -> Self {
        let [record, small] = frame.lines();
        let records = borrowed.payload().chunks_exact(record);
        let mut copied = Vec::with_capacity(records.len() * small);
        records.for_each(|record| copied.extend_from_slice(&record[..small]));
        Self { borrowed, small: copied, frame }
    }

    /// A record where it lies, images included.
    fn whole(&self, i: usize) -> &[u8] {
        let [record, _] = self.frame.lines();
        Line::bytes(&self.borrowed.payload()[i * record..][..record])
    }
}

impl HalfSample for Sample {
    fn len(&self) -> usize {
        self.small.len() / self.frame.lines()[1]
    }
    fn record(&self, i: usize) -> &[u8] {
        let [_, small] = self.frame.lines();
        Line::bytes(&self.small[i * small..][..small])
    }
    fn has_frame(&self, i: usize) -> bool {
        self.frame.is_there(self.header(i))
    }
    fn frame(&self, i: usize) -> Option<DepthFrame<'_>> {
        self.frame.read(self.whole(i), self.header(i))
    }
    fn images(&self, i: usize) -> impl Iterator<Item = &[u8]> {
        self.frame.images(self.record(i), self.whole(i))
    }
}

struct ActorPorts {
    actions: ActionPublisher,
    restores: RestorePublisher,
}

pub struct Ports {
    ringers: Ringers,
    // Ports before the node: they are dropped in this order.
    observations: ObservationSubscriber,
    stage: StageSubscriber,
    /// None where nothing is recorded.
    receipts: Option<Receipts>,
    /// Rings for whatever may have come: observations, announcements, receipts.
    wakeup: Wakeup,
    /// The run's number of the first of [`Self::actors`].
    first_actor: u32,
    actors: Vec<ActorPorts>,
    frame: Frame,
    rank: u32,
    wire: Wire,
}

impl Ports {
    /// Joins the services of an orchestrator incarnation: for the learner `rank` of a run with this configuration.
    pub fn open(address: &WireAddress, config: &Config, rank: u32) -> Result<Self> {
        let (shape, recorder) = (WireShape::of(config), config.recording.enabled);
        let wire = Wire::join(address, shape, &format!("learner-{rank}"))?;
        let observations = wire.observation_subscriber(rank)?;
        let stage = wire.stage_subscriber()?;
        let receipts = recorder.then(|| Receipts::open(address, shape.shares.actors())).transpose()?;
        let actors = shape
            .shares
            .actors_of(rank)
            .map(|actor| {
                Ok(ActorPorts { actions: wire.action_publisher(actor)?, restores: wire.restore_publisher(actor)? })
            })
            .collect::<Result<_>>()?;
        let first_actor = shape.shares.actors_of(rank).start;
        let wakeup = wire.bells().wakeup(Sleeper::Learner(rank));
        let ringers = Ringers::start(wire.bells(), shape.shares.actors_of(rank))?;
        Ok(Self {
            ringers,
            observations,
            stage,
            receipts,
            wakeup,
            first_actor,
            actors,
            frame: Frame::of(config),
            rank,
            wire,
        })
    }

    /// The next observation sample, if one is waiting.
    pub fn receive(&self) -> Result<Option<(ObservationHeader, Sample)>> {
        match self.observations.receive() {
            Ok(sample) => Ok(sample.map(|sample| (*sample.user_header(), Sample::of(sample, self.frame.clone())))),
            // All that is left comes from actors of which two samples are held: it can only be something that was
            // sent twice, and waits until one of those is let go.
            Err(ReceiveError::ExceedsMaxBorrows) => Ok(None),
            Err(cause) => Err(anyhow::anyhow!("cannot receive observations: {cause:?}")),
        }
    }

    /// Sleeps until something may have come, or observations of so many actors, at most for `longest`.
    pub fn wait(&self, observations: u32, longest: Duration) {
        self.wakeup.wait_for(observations, longest);
    }

    pub fn own_bell(&self) -> Bell {
        self.wire.bells().bell([Sleeper::Learner(self.rank)])
    }

    pub fn recorded(&self) -> bool {
        self.receipts.is_some()
    }

    /// The recorder's newest receipts: actor, half, receipt.
    pub fn receipts(&self) -> impl Iterator<Item = (u32, u32, Receipt)> {
        let actors = self.first_actor..self.first_actor + self.actors.len() as u32;
        self.receipts.iter().flat_map(move |receipts| {
            let of = |(actor, half)| receipts.of(actor, half).map(|receipt| (actor, half, receipt));
            actors.clone().flat_map(|actor| [(actor, 0), (actor, 1)]).filter_map(of)
        })
    }

    pub fn written(&self) -> Option<Written> {
        self.receipts.as_ref().and_then(Receipts::written)
    }

    /// Looks whether the recorder stands still, if there is one; for how long, if it does.
    pub fn look_at_recorder(&self, standstill: &mut Standstill) -> Option<Duration> {
        self.receipts.as_ref().and_then(|receipts| standstill.look(receipts))
    }

    /// Whether nothing more can be recorded.
    pub fn recording_failed(&self) -> bool {
        self.receipts.as_ref().is_some_and(Receipts::failed)
    }

    /// Announcements made since the last call, the newest last.
    pub fn announcements(&self) -> Result<Vec<StageAnnouncement>> {
        let mut heard = vec![];
        while let Some(sample) =
            self.stage.receive().map_err(|cause| anyhow::anyhow!("cannot receive stage announcements: {cause:?}"))?
        {
            heard.push(*sample.payload());
        }
        Ok(heard)
    }

    fn ports_of(&self, actor: u32) -> &ActorPorts {
        &self.actors[(actor - self.first_actor) as usize]
    }

    /// Sends actions to actors, and has them all woken. An actor that is not there gets its own with its restore.
    pub fn send_actions(&self, batches: &[ActionBatch]) -> Result<()> {
        for batch in batches {
            let failed = || format!("cannot send actions to actor {}", batch.actor);
            fault::reach("learner.before_loan");
            let publisher = &self.ports_of(batch.actor).actions;
            let mut sample = publisher.loan_slice_uninit(batch.actions.len()).with_context(failed)?;
            fault::reach("learner.after_loan");
            *sample.user_header_mut() = batch.header;
            sample.write_from_slice(&batch.actions).send().with_context(failed)?;
            fault::reach("learner.after_send");
        }
        for run in batches.chunk_by(|batch, next| next.actor <= batch.actor + 1) {
            self.ringers.ring(run[0].actor..run[run.len() - 1].actor + 1);
        }
        Ok(())
    }

    pub fn send_restore(&self, actor: u32, header: RestoreHeader, states: &[EnvironmentState]) -> Result<()> {
        let ports = self.ports_of(actor);
        let failed = || format!("cannot send a restore to actor {actor}");
        fault::reach("learner.before_restore");
        let payload = EnvironmentState::encode(states);
        let mut sample = ports.restores.loan_slice_uninit(payload.len()).with_context(failed)?;
        *sample.user_header_mut() = header;
        sample.write_from_slice(&payload).send().with_context(failed)?;
        fault::reach("learner.after_restore");
        self.ringers.ring(actor..actor + 1);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::named;
    use proto::record::RecordHeader;
    use std::mem::offset_of;
    use std::ptr::{addr_of_mut, write_volatile};
    use wire::WireHost;

    /// An actor that goes on writing into a sample that it has sent: what was checked is what is used.
    #[test]
    fn what_was_received_stays_as_it_was_whatever_its_sender_writes() {
        let mut config = Config::default();
        (config.actors.count, config.actors.environments_per_actor) = (1, 2);
        config.recording.enabled = false;
        let shape = WireShape::of(&config);
        let address = WireAddress::new(&format!("testlink{}", std::process::id()), 1);
        let host = WireHost::create(&address, shape).unwrap();
        {
            let ports = Ports::open(&address, &config, 0).unwrap();
            let actor = Wire::join(&address, shape, "actor-0").unwrap();
            let publisher = actor.observation_publisher(0).unwrap();
            let mut loan = publisher.loan_slice_uninit(shape.lines(1)).unwrap();
            *loan.user_header_mut() = ObservationHeader { half: 1, ..Default::default() };
            let header = std::ptr::from_mut(loan.user_header_mut());
            let [disturbance_m, target, depth_mm] =
                ["disturbance_m", "target", "depth_mm"].map(|name| named(config.spec(), name));
            let mut loan = loan.write_from_fn(|_| Line([0; 64]));
            let record = Line::bytes_mut(loan.payload_mut());
            *RecordHeader::of_mut(record) = RecordHeader { environment: 1, bulk: 1, ..Default::default() };
            disturbance_m.of_mut(record)[0] = 0.5_f32;
            target.of_mut(record)[0] = 3_u32;
            depth_mm.of_mut::<u16>(record).fill(1234);
            let bytes = record.as_mut_ptr();
            loan.send().unwrap();

            let (received, sample) = ports.receive().unwrap().expect("what was sent is there");
            let reports = [target.offset, disturbance_m.offset, offset_of!(RecordHeader, bulk)];
            // SAFETY: the sample's memory is mapped until the publisher is dropped; nobody else writes to it.
            unsafe {
                write_volatile(addr_of_mut!((*header).half), 7);
                write_volatile(bytes.add(offset_of!(RecordHeader, environment)), 99);
                for offset in reports {
                    write_volatile(bytes.add(offset).cast(), u32::MAX);
                }
                write_volatile(bytes.add(depth_mm.offset + 14).cast(), 4321_u16);
            }
            assert_eq!(sample.borrowed.user_header().half, 7, "the sender reaches what the learner reads");
            assert_eq!(received.half, 1);
            assert_eq!((sample.len(), sample.header(0).environment), (1, 1));
            let record = sample.record(0);
            assert_eq!((disturbance_m.number(record), target.number(record)), (0.5, 3.0));
            assert!(sample.has_frame(0));
            let frame = sample.frame(0).expect("the task has a frame");
            assert_eq!(frame.numbers()[7], 4321, "frames are not copied");
        }
        drop(host);
        address.sweep().unwrap();
    }
}
