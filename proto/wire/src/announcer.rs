//! Both ends of the `stage` service: what the orchestrator announces to all learners.

use crate::bells::{Bell, Sleeper};
use crate::error::WireError;
use crate::message::StageAnnouncement;
use crate::services::{Ipc, STAGE, StageSubscriber, Wire, open, port, required_attributes, service};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::update_connections::UpdateConnections;
use std::fmt::Debug;

pub struct Announcer {
    publisher: Publisher<Ipc, StageAnnouncement, ()>,
    bell: Bell,
}

impl Debug for Announcer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Announcer").finish_non_exhaustive()
    }
}

impl Announcer {
    pub fn announce(&self, announcement: StageAnnouncement) -> Result<(), WireError> {
        self.publisher.update_connections().map_err(|cause| unannounced(&cause))?;
        self.publisher.send_copy(announcement).map_err(|cause| unannounced(&cause))?;
        self.bell.ring();
        Ok(())
    }

    /// Gives the announcement in force to learners that have come after it was made, and wakes all. To be called on a
    /// timer.
    pub fn update(&self) -> Result<(), WireError> {
        self.publisher.update_connections().map_err(|cause| unannounced(&cause))?;
        self.bell.ring();
        Ok(())
    }
}

impl Wire {
    pub fn announcer(&self) -> Result<Announcer, WireError> {
        let publisher = open!(self.stage(), STAGE).publisher_builder().create().map_err(|cause| port(STAGE, &cause))?;
        let bell = self.bells().bell((0..self.shape().shares.learners()).map(Sleeper::Learner));
        Ok(Announcer { publisher, bell })
    }

    /// A reader's end of the stage service. An announcement made before it was opened arrives with the next
    /// [`Announcer::update`], which the orchestrator calls on a timer.
    pub fn stage_subscriber(&self) -> Result<StageSubscriber, WireError> {
        open!(self.stage(), STAGE).subscriber_builder().create().map_err(|cause| port(STAGE, &cause))
    }
}

fn unannounced(cause: &dyn Debug) -> WireError {
    WireError::Announcement(format!("{cause:?}"))
}
