//! What joins Stillroom's processes: payloads and services in shared memory, and what every process does in the same
//! way (log, hold its lifeline, check its processor, raise its limit of open files).
//!
//! The crate `proto` defines what the processes exchange; this one carries it from process to process.
//!
//! ```
//! use proto::config::Config;
//! use proto::record::RecordHeader;
//! use proto::shares::Shares;
//! use wire::message::Line;
//! use wire::{Wire, WireAddress, WireHost, WireShape};
//!
//! // The orchestrator creates all services; one actor with two environments and one learner join.
//! let address = WireAddress::new(&format!("example{}", std::process::id()), 1);
//! let shape = WireShape::new(Shares::of_one(1), 2, Config::default().spec());
//! let host = WireHost::create(&address, shape)?;
//! let learner = Wire::join(&address, shape, "learner-0")?;
//! let actor = Wire::join(&address, shape, "actor-00")?;
//!
//! // The actor sends the record of one half of its environments. The learner reads it in place.
//! let (observations, seen) = (actor.observation_publisher(0)?, learner.observation_subscriber(0)?);
//! let mut sample = observations.loan_slice_uninit(shape.lines(1))?;
//! sample.user_header_mut().step = 7;
//! let mut sample = sample.write_from_fn(|_| Line([0; 64]));
//! RecordHeader::of_mut(Line::bytes_mut(sample.payload_mut())).environment = 1;
//! sample.send()?;
//! let sample = seen.receive()?.expect("it was sent");
//! let header = RecordHeader::of(Line::bytes(sample.payload()));
//! assert_eq!((sample.user_header().step, header.environment), (7, 1));
//!
//! // The learner answers with one byte an environment.
//! let (actions, answers) = (learner.action_publisher(0)?, actor.action_subscriber(0)?);
//! actions.loan_slice_uninit(1)?.write_from_slice(&[16]).send()?;
//! assert_eq!(answers.receive()?.expect("it was sent").payload(), [16]);
//!
//! # drop((sample, observations, seen, actions, answers, learner, actor));
//! drop(host);
//! address.sweep()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(not(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64"))))]
compile_error!(
    "Stillroom's programs are for 64-bit x86 and ARM Linux only: libtorch is pinned for it, and frames cross shared memory \
     as Linux has it. Build on such a machine, or in a container on one; the Python package alone needs none of this."
);

mod address;
mod announcer;
mod bells;
pub mod descriptors;
mod dimensions;
mod error;
mod ffi;
pub mod lifeline;
pub mod logging;
pub mod message;
pub mod processor;
mod receipts;
mod services;
mod shm;
mod sweeper;
pub mod version;
pub mod warning_limiter;

pub use address::{PREFIX_MARK, SHARED_MEMORY, WireAddress, is_run_id, temporary_folder};
pub use announcer::Announcer;
pub use bells::{Bell, Bells, Sleeper, Wakeup};
pub use dimensions::WireShape;
pub use error::WireError;
pub use ffi::{HeldRequests, give_memory_back};
pub use proto::fault;
pub use receipts::{Receipt, ReceiptBook, Receipts, Standstill, Written};
pub use services::{
    ActionPublisher, ActionSubscriber, Ipc, ObservationPublisher, ObservationReaders, ObservationSubscriber,
    RestorePublisher, RestoreSubscriber, StageSubscriber, UpdateConnections, Wire, WireHost,
};
pub use shm::SharedWords;
