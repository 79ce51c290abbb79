//! An environment and who plays in it; and what it saw on the way.

use super::policy::{Policy, PolicyKind, policy};
use crate::environment::{Environment, EnvironmentError};
use crate::kitchen::Kitchen;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::message::transition_flag;
use rapier3d::math::Pose3;
use std::sync::Arc;

/// One environment under a policy, from one episode into the next.
pub struct Player {
    /// What is played.
    pub environment: Environment,
    policy: Box<dyn Policy>,
    episode: u32,
    step: u32,
}

/// What a depth image is drawn from.
#[derive(Debug, Clone)]
pub struct View {
    /// Pose of every body of the kitchen.
    pub world_from_bodies: Vec<Pose3>,
    /// Pose of the camera.
    pub world_from_camera: Pose3,
}

impl Player {
    /// An environment at the start of its episode 0.
    pub fn new(
        kitchen: &Arc<Kitchen>,
        id: EnvironmentId,
        config: &Config,
        kind: PolicyKind,
    ) -> Result<Self, EnvironmentError> {
        let environment = Environment::new(Arc::clone(kitchen), id, config)?;
        Ok(Self { environment, policy: policy(kind, id), episode: 0, step: 0 })
    }

    /// Takes one action; after the last one of an episode the next begins.
    pub fn step(&mut self) {
        let action = self.policy.next(&self.environment, self.episode, self.step);
        self.step += 1;
        if self.environment.step(action).flags & transition_flag::ENDED != 0 {
            self.episode += 1;
            self.step = 0;
            self.environment.start_episode(self.episode);
        }
    }

    /// What the camera sees now.
    pub fn view(&self) -> View {
        let mut world_from_bodies = Vec::new();
        self.environment.world_from_bodies(&mut world_from_bodies);
        View { world_from_bodies, world_from_camera: self.environment.world_from_camera() }
    }

    /// Takes `steps` actions; keeps what was seen whenever the camera had moved, at most `limit` times.
    pub fn travel(&mut self, steps: u32, limit: usize) -> Vec<View> {
        let mut views = vec![self.view()];
        for _ in 0..steps {
            let before = self.environment.world_from_camera();
            self.step();
            if views.len() < limit && self.environment.world_from_camera() != before {
                views.push(self.view());
            }
        }
        views.truncate(limit);
        views
    }
}
