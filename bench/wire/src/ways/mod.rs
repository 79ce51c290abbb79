//! Ways to carry observations and actions between processes.

mod grpc;
mod shm;
mod socket;
pub mod wire;
mod zeromq;

use crate::end::{ActorEnd, LearnerEnd, Place, Way};
use anyhow::{Result, bail};

/// The learner's end of a way. Actors are started afterwards.
pub fn learner(way: Way, place: &Place) -> Result<Box<dyn LearnerEnd>> {
    Ok(match way {
        Way::Wire => Box::new(wire::Learner::open(place)?),
        Way::Shm => Box::new(shm::Learner::open(place)?),
        Way::Unix => Box::new(socket::Learner::open(place)?),
        Way::Zeromq => Box::new(zeromq::Learner::open(place)?),
        Way::Grpc => Box::new(grpc::Learner::open(place)?),
    })
}

pub fn actor(way: Way, place: &Place, actor: u32) -> Result<Box<dyn ActorEnd>> {
    if actor >= place.actors {
        bail!("there are {} actors, and no actor {actor}", place.actors);
    }
    Ok(match way {
        Way::Wire => Box::new(wire::Actor::open(place, actor)?),
        Way::Shm => Box::new(shm::Actor::open(place, actor)?),
        Way::Unix => Box::new(socket::Actor::open(place, actor)?),
        Way::Zeromq => Box::new(zeromq::Actor::open(place, actor)?),
        Way::Grpc => Box::new(grpc::Actor::open(place, actor)?),
    })
}

pub fn sweep(place: &Place) {
    let _ = std::fs::remove_dir_all(place.folder());
    let _ = std::fs::remove_file(shm::path(place));
    let _ = wire::address(place).sweep();
}
