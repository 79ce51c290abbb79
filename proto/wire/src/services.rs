//! The shared-memory services: their names, their settings, and who opens what.
//!
//! | service | pattern | from → to | payload |
//! |---|---|---|---|
//! | `observations/RANK` | publish-subscribe | a learner's actors → it, recorder | `[Line]`, the records of one half |
//! | `restore/ACTOR` | publish-subscribe | learner → one actor | `[u8]`, the states of all its environments |
//! | `actions/ACTOR` | publish-subscribe | learner → one actor | `[u8]`, one action an environment of the half |
//! | `stage` | publish-subscribe, history 1 | orchestrator → learners | `StageAnnouncement` |
//!
//! Each learner has its own observation services: samples of another learner's actors neither wake it nor fill its
//! queue. What the recorder has taken stands in its [receipts](crate::receipts), and who has sent something rings
//! [bells](crate::bells): neither is a service.
//!
//! One long-lived process, the orchestrator, creates every service ([`WireHost`]) and all others only open them
//! ([`Wire`]): a process killed while it creates a service can leave it half-made for good. Each incarnation of the
//! orchestrator uses names of its own ([`WireAddress`]), so nothing of a dead one is used again, and cleaning up means
//! deleting one folder and one prefix in /dev/shm.

use crate::address::WireAddress;
use crate::bells::{Bell, Bells, Sleeper};
use crate::dimensions::WireShape;
use crate::error::WireError;
use crate::message::{ActionHeader, EnvironmentState, Line, ObservationHeader, RestoreHeader, StageAnnouncement};
use crate::receipts;
use crate::sweeper::Sweeper;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
pub use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::{
    AllocationStrategy, AttributeSpecifier, AttributeVerifier, BackpressureStrategy, Node, NodeBuilder, NodeName,
    PortFactory, ServiceName, SignalHandlingMode, ipc,
};
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::builder::publish_subscribe::{Builder as PublishSubscribeBuilder, PublishSubscribeOpenError};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as PublishSubscribe;
use proto::SCHEMA_VERSION;
use std::fmt::Debug;
use std::ops::Range;

/// The flavour of iceoryx2 in use: between processes, ports stay on the thread that made them.
pub type Ipc = ipc::Service;
pub type ObservationPublisher = Publisher<Ipc, [Line], ObservationHeader>;
/// Subscriber of observations; held by the learner and by recorders.
pub type ObservationSubscriber = Subscriber<Ipc, [Line], ObservationHeader>;
pub type ActionPublisher = Publisher<Ipc, [u8], ActionHeader>;
pub type ActionSubscriber = Subscriber<Ipc, [u8], ActionHeader>;
pub type RestorePublisher = Publisher<Ipc, [u8], RestoreHeader>;
pub type RestoreSubscriber = Subscriber<Ipc, [u8], RestoreHeader>;
pub type StageSubscriber = Subscriber<Ipc, StageAnnouncement, ()>;

/// Subscribers of observations: learner and recorder. The services have room for one more, a killed learner
/// that is not swept yet when its successor comes.
const OBSERVATION_SUBSCRIBERS: usize = 2;
/// Samples that wait for one subscriber: one for each half.
const OBSERVATION_BUFFER: usize = 2;
/// Samples that a subscriber may borrow at once: one for each half.
const OBSERVATION_BORROWED: usize = 2;
/// Restores that wait for an actor, of which only the newest matters, and that it may borrow.
const RESTORE_BUFFER: usize = 1;
const RESTORE_BORROWED: usize = 1;
/// Ports that a restarted process may need while its dead predecessor's are not swept yet.
const RESTART_MARGIN: usize = 2;

impl WireShape {
    /// Shared memory that the services of observations and restores can come to use, bytes: every slot of every actor, and
    /// a tenth for everything else.
    pub fn shared_memory_bytes(self) -> u64 {
        // The publisher's pool: what subscribers queue and borrow, and the loan in flight.
        let samples = (OBSERVATION_SUBSCRIBERS + 1) * (OBSERVATION_BUFFER + OBSERVATION_BORROWED) + 1;
        let observations = samples * self.lines(self.half()) * size_of::<Line>();
        let restores = (RESTART_MARGIN * (RESTORE_BUFFER + RESTORE_BORROWED) + 1) * self.restore_bytes();
        let per_actor = observations + restores;
        u64::from(self.shares.actors()) * per_actor as u64 * 11 / 10 + (1 << 20)
    }

    /// An actor's longest restore, bytes.
    fn restore_bytes(self) -> usize {
        let actions = self.max_steps as usize * self.action_bytes;
        self.environments_per_actor as usize * EnvironmentState::bytes(actions, self.snapshot_bytes)
    }

    fn nodes(self) -> usize {
        // Actors, learners, orchestrator, recorder; each possibly next to its dead predecessor.
        (self.shares.actors() as usize + self.shares.learners() as usize + 2) * RESTART_MARGIN
    }
}

/// A service that the orchestrator has created.
macro_rules! open {
    ($builder:expr, $name:expr) => {
        $builder?.open_with_attributes(&required_attributes()).map_err(|cause| service("open", $name, &cause))?
    };
}
pub(crate) use open;

pub struct Wire {
    node: Node<Ipc>,
    shape: WireShape,
    bells: Bells,
}

impl Debug for Wire {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Wire").field("shape", &self.shape).finish_non_exhaustive()
    }
}

impl Wire {
    /// Joins under the name of a process, e.g. `actor-03`. Creates no service.
    pub fn join(address: &WireAddress, shape: WireShape, process: &str) -> Result<Self, WireError> {
        let root = || address.root().display().to_string();
        let failed = |cause: &dyn Debug| WireError::Node { root: root(), cause: format!("{cause:?}") };
        let node = NodeBuilder::new()
            .name(&NodeName::new(process).map_err(|error| failed(&error))?)
            .config(&address.config()?)
            // Signals belong to the program, not to the transport.
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(|error| failed(&error))?;
        Ok(Self { node, shape, bells: Bells::open(address, shape)? })
    }

    pub fn bells(&self) -> &Bells {
        &self.bells
    }

    pub fn shape(&self) -> WireShape {
        self.shape
    }

    /// The actor's end of the observations.
    ///
    /// A full subscriber blocks `send`: the recorder must see every step. A dead one is swept by the orchestrator.
    /// A subscriber that has not met this publisher yet blocks nothing and may miss a sample: compare what `send`
    /// returns with [`Self::observation_readers`].
    pub fn observation_publisher(&self, actor: u32) -> Result<ObservationPublisher, WireError> {
        let rank = self.shape.shares.learner_of(actor);
        let name = observations_name(rank);
        let service = self.open_observations(rank)?;
        service
            .publisher_builder()
            .initial_max_slice_len(self.shape.lines(self.shape.half()))
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
            .create()
            .map_err(|cause| port(&name, &cause))
    }

    /// Counts the subscribers of an actor's observations, those that were killed and not swept yet included.
    pub fn observation_readers(&self, actor: u32) -> Result<ObservationReaders, WireError> {
        let rank = self.shape.shares.learner_of(actor);
        Ok(ObservationReaders { service: self.open_observations(rank)? })
    }

    /// A reader's end of the observations of one learner's actors.
    pub fn observation_subscriber(&self, rank: u32) -> Result<ObservationSubscriber, WireError> {
        let name = observations_name(rank);
        let service = self.open_observations(rank)?;
        service.subscriber_builder().buffer_size(OBSERVATION_BUFFER).create().map_err(|cause| port(&name, &cause))
    }

    /// The actor's bell for its observations: it wakes its learner and the recorder.
    pub fn observations_bell(&self, actor: u32) -> Bell {
        self.bells.bell([Sleeper::Learner(self.shape.shares.learner_of(actor)), Sleeper::Recorder])
    }

    pub fn action_publisher(&self, actor: u32) -> Result<ActionPublisher, WireError> {
        let name = actions_name(actor);
        let service = open!(self.actions(actor), &name);
        service
            .publisher_builder()
            .initial_max_slice_len(self.shape.half() * self.shape.action_bytes)
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(1)
            // Two batches at most are on the way, one a half, and the buffer holds both: nothing is ever discarded
            // between living processes, and a dead actor cannot block the learner.
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|cause| port(&name, &cause))
    }

    pub fn action_subscriber(&self, actor: u32) -> Result<ActionSubscriber, WireError> {
        let name = actions_name(actor);
        let service = open!(self.actions(actor), &name);
        service.subscriber_builder().create().map_err(|cause| port(&name, &cause))
    }

    pub fn restore_publisher(&self, actor: u32) -> Result<RestorePublisher, WireError> {
        let name = restore_name(actor);
        let service = open!(self.restore(actor), &name);
        service
            .publisher_builder()
            .initial_max_slice_len(self.shape.restore_bytes())
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|cause| port(&name, &cause))
    }

    pub fn restore_subscriber(&self, actor: u32) -> Result<RestoreSubscriber, WireError> {
        let name = restore_name(actor);
        let service = open!(self.restore(actor), &name);
        service.subscriber_builder().create().map_err(|cause| port(&name, &cause))
    }

    fn open_observations(&self, rank: u32) -> Result<Observations, WireError> {
        let name = observations_name(rank);
        let required = required_attributes().require(&layout_key(), &layout_value(self.shape));
        let required = required.expect("two short attributes always fit");
        self.observations(rank)?.open_with_attributes(&required).map_err(|cause| match cause {
            PublishSubscribeOpenError::IncompatibleAttributes => WireError::Unlike { service: name },
            cause => service("open", &name, &cause),
        })
    }

    // The settings of each service. Creating and opening share them; defaults of iceoryx2 do not fit.

    fn observations(&self, rank: u32) -> Result<SampleBuilder<[Line], ObservationHeader>, WireError> {
        Ok(self
            .node
            .service_builder(&name(&observations_name(rank))?)
            .publish_subscribe::<[Line]>()
            .user_header::<ObservationHeader>()
            .enable_safe_overflow(false)
            .subscriber_max_buffer_size(OBSERVATION_BUFFER)
            .subscriber_max_borrowed_samples(OBSERVATION_BORROWED)
            .history_size(0)
            .max_publishers(self.shape.shares.actors_of(rank).len() * RESTART_MARGIN)
            .max_subscribers(OBSERVATION_SUBSCRIBERS + 1)
            .max_nodes(self.shape.nodes()))
    }

    fn actions(&self, actor: u32) -> Result<SampleBuilder<[u8], ActionHeader>, WireError> {
        Ok(self
            .node
            .service_builder(&name(&actions_name(actor))?)
            .publish_subscribe::<[u8]>()
            .user_header::<ActionHeader>()
            .enable_safe_overflow(false)
            .subscriber_max_buffer_size(4)
            .subscriber_max_borrowed_samples(1)
            .history_size(0)
            .max_publishers(RESTART_MARGIN)
            .max_subscribers(RESTART_MARGIN)
            .max_nodes(self.shape.nodes()))
    }

    fn restore(&self, actor: u32) -> Result<SampleBuilder<[u8], RestoreHeader>, WireError> {
        Ok(self
            .node
            .service_builder(&name(&restore_name(actor))?)
            .publish_subscribe::<[u8]>()
            .user_header::<RestoreHeader>()
            // Only the newest restore matters.
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(RESTORE_BUFFER)
            .subscriber_max_borrowed_samples(RESTORE_BORROWED)
            .history_size(0)
            .max_publishers(RESTART_MARGIN)
            .max_subscribers(RESTART_MARGIN)
            .max_nodes(self.shape.nodes()))
    }

    pub(crate) fn stage(&self) -> Result<SampleBuilder<StageAnnouncement, ()>, WireError> {
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
}

type Observations = PublishSubscribe<Ipc, [Line], ObservationHeader>;

/// Knows how many subscribers the observations have at any moment.
#[derive(Debug)]
pub struct ObservationReaders {
    service: Observations,
}

impl ObservationReaders {
    pub fn count(&self) -> usize {
        self.service.dynamic_config().number_of_subscribers()
    }
}

/// The process that creates every service and keeps it alive: the orchestrator.
pub struct WireHost {
    wire: Wire,
    address: WireAddress,
    sweeper: Sweeper,
    _services: Vec<Box<dyn std::any::Any>>,
}

impl Debug for WireHost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WireHost").field("address", &self.address).finish_non_exhaustive()
    }
}

impl WireHost {
    pub fn create(address: &WireAddress, shape: WireShape) -> Result<Self, WireError> {
        Self::create_part(address, shape, 0..shape.shares.learners())
    }

    /// Creates those of these learners and of their actors: the others are on other hosts.
    pub fn create_part(address: &WireAddress, shape: WireShape, ranks: Range<u32>) -> Result<Self, WireError> {
        address.create_root()?;
        Bells::create(address, shape)?;
        let wire = Wire::join(address, shape, "orchestrator")?;
        let attributes = defined_attributes();
        let with_layout = defined_attributes().define(&layout_key(), &layout_value(shape));
        let with_layout = with_layout.expect("two short attributes always fit");
        let mut held: Vec<Box<dyn std::any::Any>> = Vec::new();
        macro_rules! create {
            ($builder:expr, $attributes:expr, $name:expr) => {
                held.push(Box::new(
                    $builder?.create_with_attributes($attributes).map_err(|cause| service("create", $name, &cause))?,
                ));
            };
        }
        create!(wire.stage(), &attributes, STAGE);
        for rank in ranks.clone() {
            create!(wire.observations(rank), &with_layout, &observations_name(rank));
        }
        for actor in ranks.flat_map(|rank| shape.shares.actors_of(rank)) {
            create!(wire.actions(actor), &attributes, &actions_name(actor));
            create!(wire.restore(actor), &attributes, &restore_name(actor));
        }
        receipts::create(address, shape.shares.actors())?;
        let config = address.config()?;
        let sweeper =
            address.close_to_others().and_then(|()| Sweeper::of(config, shape.shares.actors())).map_err(|cause| {
                WireError::Node { root: address.root().display().to_string(), cause: cause.to_string() }
            })?;
        Ok(Self { wire, address: address.clone(), sweeper, _services: held })
    }

    /// The host's own membership, for its ports.
    pub fn wire(&self) -> &Wire {
        &self.wire
    }

    pub fn address(&self) -> &WireAddress {
        &self.address
    }

    /// Frees the resources of dead, reaped processes, so that no process stays blocked on them. Waits for it a few
    /// seconds at most.
    pub fn sweep_dead(&self) {
        self.sweeper.sweep();
    }
}

pub(crate) const STAGE: &str = "stage";

fn observations_name(rank: u32) -> String {
    format!("observations/{rank}")
}

fn actions_name(actor: u32) -> String {
    format!("actions/{actor}")
}

fn restore_name(actor: u32) -> String {
    format!("restore/{actor}")
}

type SampleBuilder<Payload, Header> = PublishSubscribeBuilder<Payload, Header, Ipc>;

const SCHEMA_ATTRIBUTE: &str = "schema-version";
const LAYOUT_ATTRIBUTE: &str = "record-layout";

fn name(text: &str) -> Result<ServiceName, WireError> {
    ServiceName::new(text).map_err(|cause| WireError::Service {
        verb: "name",
        service: text.to_owned(),
        cause: format!("{cause:?}"),
    })
}

pub(crate) fn service(verb: &'static str, service: &str, cause: &dyn Debug) -> WireError {
    WireError::Service { verb, service: service.to_owned(), cause: format!("{cause:?}") }
}

fn defined_attributes() -> AttributeSpecifier {
    let (key, value) = schema_attribute();
    AttributeSpecifier::new().define(&key, &value).expect("one short attribute always fits")
}

pub(crate) fn required_attributes() -> AttributeVerifier {
    let (key, value) = schema_attribute();
    AttributeVerifier::new().require(&key, &value).expect("one short attribute always fits")
}

fn schema_attribute() -> (AttributeKey, AttributeValue) {
    (
        SCHEMA_ATTRIBUTE.try_into().expect("a short constant is a valid key"),
        SCHEMA_VERSION.to_string().as_str().try_into().expect("a short number is a valid value"),
    )
}

fn layout_key() -> AttributeKey {
    LAYOUT_ATTRIBUTE.try_into().expect("a short constant is a valid key")
}

fn layout_value(shape: WireShape) -> AttributeValue {
    format!("{:016x}", shape.layout_hash).as_str().try_into().expect("a short number is a valid value")
}

pub(crate) fn port(service: &str, cause: &dyn Debug) -> WireError {
    WireError::Port { service: service.to_owned(), cause: format!("{cause:?}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SHARED_MEMORY;
    use proto::config::Config;
    use proto::shares::Shares;

    fn shape(shares: Shares, environments_per_actor: u32) -> WireShape {
        WireShape::new(shares, environments_per_actor, Config::default().spec())
    }

    fn address(test: &str) -> WireAddress {
        WireAddress::new(&format!("test{test}{}", std::process::id()), 1)
    }

    #[test]
    fn nobody_else_can_open_what_a_host_makes_whatever_the_umask() {
        use std::os::unix::fs::MetadataExt;
        let address = address("modes");
        let before = rustix::process::umask(rustix::fs::Mode::empty());
        let host = WireHost::create(&address, shape(Shares::of_one(2), 1));
        let actor = Wire::join(&address, host.as_ref().unwrap().wire().shape, "actor-00").unwrap();
        let publisher = actor.observation_publisher(0).unwrap();
        rustix::process::umask(before);
        let open: Vec<_> = std::fs::read_dir(SHARED_MEMORY)
            .unwrap()
            .map(|entry| entry.unwrap())
            .filter(|entry| entry.file_name().to_string_lossy().starts_with(address.prefix()))
            .map(|entry| (entry.metadata().unwrap().mode() & 0o777, entry.path()))
            .collect();
        assert!(open.len() > 2, "{open:?}");
        assert!(open.iter().all(|(mode, _)| mode & !0o700 == 0), "{open:?}");
        assert_eq!(std::fs::metadata(address.root()).unwrap().mode() & 0o777, 0o700);
        drop((publisher, actor, host));
        address.sweep().unwrap();
    }

    #[test]
    fn processes_whose_records_are_laid_out_otherwise_do_not_talk() {
        let shape = shape(Shares::of_one(1), 2);
        let address = address("unlike");
        let host = WireHost::create(&address, shape).unwrap();
        let other = WireShape { layout_hash: shape.layout_hash ^ 1, ..shape };
        let actor = Wire::join(&address, other, "actor-00").unwrap();
        for refused in [
            actor.observation_publisher(0).map(drop),
            actor.observation_subscriber(0).map(drop),
            actor.observation_readers(0).map(drop),
        ] {
            let refused = refused.unwrap_err().to_string();
            assert!(refused.contains("`observations/0`") && refused.contains("one version"), "{refused}");
        }
        drop((actor, host));
        address.sweep().unwrap();
    }
}
