//! One environment: an episode of the task in a kitchen.

use crate::kitchen::Kitchen;
use proto::action::Action;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::message::{Current, Transition};
use rapier3d::math::Pose3;
use std::sync::Arc;

/// Why an environment could not be made.
#[derive(Debug, thiserror::Error)]
pub enum EnvironmentError {
    /// The kitchen is not the one the environment belongs to.
    #[error("environment of kitchen {wanted} was given kitchen {given}")]
    WrongKitchen {
        /// The environment's kitchen.
        wanted: proto::kitchen::KitchenId,
        /// The kitchen it was given.
        given: proto::kitchen::KitchenId,
    },
}

/// One environment: episode, physics world, robot and reward parts.
#[derive(Debug)]
pub struct Environment {
    kitchen: Arc<Kitchen>,
}

impl Environment {
    /// An environment at the start of its episode 0.
    pub fn new(kitchen: Arc<Kitchen>, id: EnvironmentId, config: &Config) -> Result<Self, EnvironmentError> {
        let _ = config;
        if kitchen.id() != id.kitchen {
            return Err(EnvironmentError::WrongKitchen { wanted: id.kitchen, given: kitchen.id() });
        }
        Ok(Self { kitchen })
    }

    /// Resets to the settled kitchen and samples the episode with this number.
    pub fn start_episode(&mut self, episode: u32) {
        let _ = episode;
    }

    /// Takes one action. Never resets by itself: the flags say when the episode has ended.
    pub fn step(&mut self, action: Action) -> Transition {
        let _ = action;
        unimplemented!("comes with the physics")
    }

    /// What is seen now.
    pub fn current(&self) -> Current {
        unimplemented!("comes with the physics")
    }

    /// Hash of the state.
    pub fn state_hash(&self) -> u64 {
        0
    }

    /// Pose of the head camera: x right, y up, looks along +z.
    pub fn world_from_camera(&self) -> Pose3 {
        Pose3::identity()
    }

    /// Pose of every body of [`Kitchen::bodies`], in order.
    pub fn world_from_bodies(&self, out: &mut Vec<Pose3>) {
        out.clear();
        out.extend_from_slice(self.kitchen.settled_poses());
    }
}
