//! The learner's ports in shared memory. All on the thread that made them.

use super::ringers::Ringers;
use crate::collector::{ActionBatch, HalfSample};
use anyhow::{Context, Result};
use iceoryx2::port::ReceiveError;
use iceoryx2::sample::Sample as IoxSample;
use proto::camera::FRAME_PIXELS;
use proto::step::{Current, Transition};
use wire::message::{EnvironmentState, Observation, ObservationHeader, RestoreHeader, StageAnnouncement};
use wire::{
    ActionPublisher, Bells, Ipc, ObservationSubscriber, RestorePublisher, StageSubscriber, ThreadBell, Waiting, Wakeup,
    Wire, WireAddress, WireError, WireShape,
};

/// A received sample: borrowed from shared memory until it is dropped. A subscriber may hold two of each actor.
#[derive(Debug)]
pub struct Sample(IoxSample<Ipc, [Observation], ObservationHeader>);

impl HalfSample for Sample {
    fn len(&self) -> usize {
        self.0.payload().len()
    }
    fn environment(&self, i: usize) -> u32 {
        self.0.payload()[i].environment
    }
    fn transition(&self, i: usize) -> &Transition {
        &self.0.payload()[i].transition
    }
    fn current(&self, i: usize) -> &Current {
        &self.0.payload()[i].current
    }
    fn frame(&self, i: usize) -> &[u16; FRAME_PIXELS] {
        &self.0.payload()[i].depth_mm
    }
}

struct ActorPorts {
    actions: ActionPublisher,
    restores: RestorePublisher,
}

/// The learner's ports in shared memory.
pub struct Ports {
    ringers: Ringers,
    // Ports before the node: they are dropped in this order.
    observations: ObservationSubscriber,
    observations_wakeup: Wakeup,
    stage: StageSubscriber,
    stage_wakeup: Wakeup,
    bells: Bells,
    /// The run's number of the first of [`Self::actors`].
    first_actor: u32,
    actors: Vec<ActorPorts>,
    _wire: Wire,
}

impl Ports {
    /// Joins the services of an orchestrator incarnation.
    pub fn open(address: &WireAddress, shape: WireShape, rank: u32) -> Result<Self> {
        let wire = Wire::join(address, shape, &format!("learner-{rank}"))?;
        // The bells' listeners first: whoever finds the subscriber finds someone to wake.
        let observations_wakeup = wire.observations_wakeup(rank)?;
        let observations = wire.observation_subscriber(rank)?;
        let stage_wakeup = wire.stage_wakeup()?;
        let stage = wire.stage_subscriber()?;
        let actors = shape
            .shares
            .actors_of(rank)
            .map(|actor| {
                Ok(ActorPorts { actions: wire.action_publisher(actor)?, restores: wire.restore_publisher(actor)? })
            })
            .collect::<Result<_>>()?;
        let first_actor = shape.shares.actors_of(rank).start;
        let bells = Bells::new()?;
        let ringers = Ringers::start(address, shape, rank)?;
        Ok(Self {
            ringers,
            observations,
            observations_wakeup,
            stage,
            stage_wakeup,
            bells,
            first_actor,
            actors,
            _wire: wire,
        })
    }

    /// The next observation sample, if one is waiting.
    pub fn receive(&self) -> Result<Option<(ObservationHeader, Sample)>> {
        match self.observations.receive() {
            Ok(sample) => Ok(sample.map(|sample| (*sample.user_header(), Sample(sample)))),
            // All that is left comes from actors of which two samples are held: it can only be something that was
            // sent twice, and waits until one of those is let go.
            Err(ReceiveError::ExceedsMaxBorrows) => Ok(None),
            Err(cause) => Err(anyhow::anyhow!("cannot receive observations: {cause:?}")),
        }
    }

    /// Waiting for all that can happen: observations, announcements, and what rings `gone`.
    pub fn attach<'a>(&'a self, gone: &'a ThreadBell) -> Result<Waiting<'a>, WireError> {
        self.bells.attach([&self.observations_wakeup, &self.stage_wakeup], gone)
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
            let publisher = &self.ports_of(batch.actor).actions;
            let mut sample = publisher.loan_slice_uninit(batch.actions.len()).with_context(failed)?;
            *sample.user_header_mut() = batch.header;
            sample.write_from_slice(&batch.actions).send().with_context(failed)?;
        }
        if let (Some(first), Some(last)) = (batches.first(), batches.last()) {
            self.ringers.ring(first.actor..last.actor + 1);
        }
        Ok(())
    }

    /// Sends an actor the state of its environments.
    pub fn send_restore(&self, actor: u32, header: RestoreHeader, states: &[EnvironmentState]) -> Result<()> {
        let ports = self.ports_of(actor);
        let failed = || format!("cannot send a restore to actor {actor}");
        let mut sample = ports.restores.loan_slice_uninit(states.len()).with_context(failed)?;
        *sample.user_header_mut() = header;
        sample.write_from_slice(states).send().with_context(failed)?;
        self.ringers.ring(actor..actor + 1);
        Ok(())
    }
}
