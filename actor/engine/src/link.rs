//! The actor's ends of the shared-memory services.

use crate::error::EngineError;
use crate::shm::{self, Written};
use proto::config::Config;
use std::time::Duration;
use wire::fault;
use wire::message::{ActionHeader, EnvironmentState, Line, ObservationHeader, RestoreHeader};
use wire::{
    ActionSubscriber, Bell, ObservationPublisher, ObservationReaders, Receipts, RestoreSubscriber, Sleeper,
    UpdateConnections, Wakeup, Wire, WireAddress, WireShape,
};

/// What has arrived, copied: what lies in shared memory can change after it was checked.
#[derive(Debug, Default)]
pub(crate) struct Arrived {
    /// Restores, in the order in which they were sent.
    pub restores: Vec<(RestoreHeader, Vec<EnvironmentState>)>,
    /// Action batches, in the order in which they were sent. They may build on the restores.
    pub actions: Vec<(ActionHeader, Vec<u8>)>,
}

pub struct Link {
    observations: ObservationPublisher,
    readers: ObservationReaders,
    bell: Bell,
    restores: RestoreSubscriber,
    actions: ActionSubscriber,
    wakeup: Wakeup,
    actor: u32,
    shape: WireShape,
    /// None where nothing is recorded.
    receipts: Option<Receipts>,
    // Ports refer to the node: dropped last.
    _wire: Wire,
}

impl Link {
    /// Joins a run of this configuration and opens the services of actor `actor`. The orchestrator has created them.
    pub fn open(address: &WireAddress, actor: u32, config: &Config) -> Result<Self, EngineError> {
        let shape = WireShape::of(config);
        let actors = shape.shares.actors();
        if actor >= actors {
            return Err(EngineError::NoSuchActor { actor, last: actors - 1 });
        }
        let wire = Wire::join(address, shape, &format!("actor-{actor:02}"))?;
        Ok(Self {
            // The actor's own subscribers are open before it announces itself.
            restores: wire.restore_subscriber(actor)?,
            actions: wire.action_subscriber(actor)?,
            wakeup: wire.bells().wakeup(Sleeper::Actor(actor)),
            bell: wire.observations_bell(actor),
            observations: wire.observation_publisher(actor)?,
            readers: wire.observation_readers(actor)?,
            actor,
            shape,
            receipts: config.recording.enabled.then(|| Receipts::open(address, actors)).transpose()?,
            _wire: wire,
        })
    }

    pub(crate) fn actor(&self) -> u32 {
        self.actor
    }

    /// How many actions a batch has; 0 if one of them is cut off.
    pub(crate) fn count(&self, batch: &[u8]) -> usize {
        let whole = batch.chunks_exact(self.shape.action_bytes);
        if whole.remainder().is_empty() { whole.len() } else { 0 }
    }

    pub(crate) fn is_recorded(&self) -> bool {
        self.receipts.is_some()
    }

    /// The newest incarnation of this actor that the recorder has heard; 0 where there is none.
    pub(crate) fn met(&self) -> u32 {
        self.receipts.as_ref().map_or(0, |receipts| receipts.met(self.actor))
    }

    pub(crate) fn receive(&self) -> Result<Arrived, EngineError> {
        let mut arrived = Arrived::default();
        // The learner sends a restore before the actions that build on it, and these only once. Who looks for actions
        // first finds their restore. The other way round both could come between the two looks: the actions would be
        // ignored for want of a restore, and then the restored environments would wait for them for ever.
        while let Some(actions) = self.actions.receive().map_err(EngineError::port("receive actions"))? {
            arrived.actions.push((*actions.user_header(), actions.payload().to_vec()));
        }
        fault::reach("actor.mid_receive");
        while let Some(restore) = self.restores.receive().map_err(EngineError::port("receive restores"))? {
            arrived
                .restores
                .push((*restore.user_header(), EnvironmentState::decode(restore.payload(), self.shape.action_bytes)?));
        }
        Ok(arrived)
    }

    /// Sleeps until the learner rings or the time is over.
    pub(crate) fn wait(&self, longest: Duration) {
        self.wakeup.wait(longest);
    }

    /// Sends a HELLO: one zeroed record.
    pub(crate) fn send_hello(&self, header: ObservationHeader) -> Result<(), EngineError> {
        let mut sample = self.loan(1)?;
        Line::bytes_mut(sample.payload_mut()).fill(0);
        self.send_observations(sample, header)?;
        // Whoever waits for observations of many does not wait for this.
        self.bell.ring();
        Ok(())
    }

    /// Room for `count` records, in which they are written where they are sent from. One at a time.
    pub(crate) fn loan(&self, count: usize) -> Result<Written, EngineError> {
        fault::reach("actor.before_loan");
        let loan = self.observations.loan_slice_uninit(self.shape.lines(count));
        let sample = loan.map_err(EngineError::port("find a free slot for observations"))?;
        fault::reach("actor.after_loan");
        Ok(shm::as_it_lies(sample))
    }

    /// Sends records. Blocks while a subscriber is full. Returns whether all subscribers got them: a new subscriber that
    /// has not yet connected to this publisher can miss a sample.
    pub(crate) fn send_observations(
        &self,
        mut sample: Written,
        header: ObservationHeader,
    ) -> Result<bool, EngineError> {
        fault::reach("actor.after_write");
        // A subscriber that came after the last send is found here, and only here.
        self.observations.update_connections().map_err(EngineError::port("connect to the learner"))?;
        *sample.user_header_mut() = header;
        let receivers = sample.send().map_err(EngineError::port("send observations"))?;
        fault::reach("actor.before_bell");
        self.bell.ring_counted();
        Ok(receivers > 0 && receivers >= self.readers.count())
    }
}
