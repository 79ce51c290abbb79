//! The `stage` service and the bell that goes with it: what the orchestrator announces to all learners.

use super::{
    Bell, EventBuilder, Ipc, RESTART_MARGIN, SampleBuilder, StageSubscriber, Wakeup, Wire, WireError, name, open, port,
    required_attributes, service,
};
use crate::message::StageAnnouncement;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::update_connections::UpdateConnections;
use std::fmt::Debug;

/// Name of the service of announcements.
pub(super) const STAGE: &str = "stage";
/// Name of its bell.
pub(super) const STAGE_READY: &str = "stage-ready";

/// The orchestrator's end of both.
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
    /// Puts an announcement in force and wakes all learners.
    pub fn announce(&self, announcement: StageAnnouncement) -> Result<(), WireError> {
        self.publisher.update_connections().map_err(|cause| unannounced(&cause))?;
        self.publisher.send_copy(announcement).map_err(|cause| unannounced(&cause))?;
        self.ring();
        Ok(())
    }

    /// Gives the announcement in force to learners that have come after it was made, and wakes all. To be called on a
    /// timer.
    pub fn update(&self) -> Result<(), WireError> {
        self.publisher.update_connections().map_err(|cause| unannounced(&cause))?;
        self.ring();
        Ok(())
    }

    /// A bell that does not ring is no loss: learners look a few times a second.
    fn ring(&self) {
        if let Err(cause) = self.bell.notify() {
            tracing::debug!("the bell of the stage announcements does not ring: {cause:?}");
        }
    }
}

impl Wire {
    /// The orchestrator's end of the stage service.
    pub fn announcer(&self) -> Result<Announcer, WireError> {
        let publisher = open!(self.stage(), STAGE).publisher_builder().create().map_err(|cause| port(STAGE, &cause))?;
        let ready = open!(self.stage_ready(), STAGE_READY);
        let bell = ready.notifier_builder().create().map_err(|cause| port(STAGE_READY, &cause))?;
        Ok(Announcer { publisher, bell })
    }

    /// A reader's end of the stage service. An announcement made before it was opened arrives with the next
    /// [`Announcer::update`], which the orchestrator calls on a timer.
    pub fn stage_subscriber(&self) -> Result<StageSubscriber, WireError> {
        open!(self.stage(), STAGE).subscriber_builder().create().map_err(|cause| port(STAGE, &cause))
    }

    /// Rings when there may be an announcement to read.
    pub fn stage_wakeup(&self) -> Result<Wakeup, WireError> {
        open!(self.stage_ready(), STAGE_READY).listener_builder().create().map_err(|cause| port(STAGE_READY, &cause))
    }

    pub(super) fn stage(&self) -> Result<SampleBuilder<StageAnnouncement, ()>, WireError> {
        Ok(self
            .node
            .service_builder(&name(STAGE)?)
            .publish_subscribe::<StageAnnouncement>()
            // Only the newest announcement matters.
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(1)
            .subscriber_max_borrowed_samples(1)
            .history_size(1)
            .max_publishers(1)
            .max_subscribers(self.shape.shares.learners() as usize * RESTART_MARGIN)
            .max_nodes(self.shape.nodes()))
    }

    pub(super) fn stage_ready(&self) -> Result<EventBuilder<Ipc>, WireError> {
        Ok(self
            .node
            .service_builder(&name(STAGE_READY)?)
            .event()
            .max_notifiers(1)
            .max_listeners(self.shape.shares.learners() as usize * RESTART_MARGIN)
            .event_id_max_value(1)
            .max_nodes(self.shape.nodes()))
    }
}

fn unannounced(cause: &dyn Debug) -> WireError {
    WireError::Announcement(format!("{cause:?}"))
}
