//! An environment that plays episodes whose actions were chosen beforehand; and what it saw on the way.

use super::action_source::{PolicyKind, script};
use proto::camera::FRAME_SIDE;
use proto::config::Config;
use proto::episode::EnvironmentId;
use rapier3d::math::Pose3;
use simulator::depth::DepthCamera;
use simulator::kitchen::Kitchen;
use simulator::robot::action::Action;
use simulator::tasks::OpenError;
use simulator::tasks::arm_point_nav::Environment;
use std::hint::black_box;
use std::sync::Arc;

/// One environment, from one episode into the next, and after the last into the first again.
pub(crate) struct Player {
    pub environment: Environment,
    script: Vec<Vec<Action>>,
    episode: usize,
    step: usize,
}

#[derive(Debug, Clone)]
pub struct View {
    pub world_from_bodies: Vec<Pose3>,
    pub world_from_camera: Pose3,
}

impl Player {
    /// An environment at the start of its episode 0, with actions for so many episodes.
    pub fn new(
        kitchen: &Arc<Kitchen>,
        id: EnvironmentId,
        config: &Config,
        kind: PolicyKind,
        episodes: u32,
    ) -> Result<Self, OpenError> {
        assert!(episodes > 0, "a player plays at least one episode");
        let mut environment = Environment::new(Arc::clone(kitchen), id, config)?;
        let mut written = Vec::new();
        for episode in 0..episodes {
            environment.start_episode(episode);
            written.push(script(kind, &environment, id, episode));
        }
        environment.start_episode(0);
        Ok(Self { environment, script: written, episode: 0, step: 0 })
    }

    /// Takes one action; after the last one of an episode the next begins.
    pub fn step(&mut self) {
        let actions = &self.script[self.episode];
        self.environment.step(actions[self.step]);
        self.step += 1;
        let ended = self.environment.ended();
        assert_eq!(ended, self.step == actions.len(), "an episode ends with its last action, and only then");
        if ended {
            self.episode = (self.episode + 1) % self.script.len();
            self.step = 0;
            self.environment.start_episode(self.episode as u32);
        }
    }

    pub fn episode_length(&self) -> usize {
        self.script[self.episode].len()
    }

    /// Observes as a rollout does with whole frames, and draws the frame over what stood still since the last one.
    pub fn look(&mut self, camera: &mut DepthCamera, depth_mm: &mut [u16]) {
        black_box(self.environment.current());
        self.environment.look(camera, FRAME_SIDE, depth_mm);
        black_box(depth_mm);
    }

    pub fn view(&self) -> View {
        let mut world_from_bodies = Vec::new();
        self.environment.world_from_bodies(&mut world_from_bodies);
        View { world_from_bodies, world_from_camera: self.environment.world_from_camera() }
    }

    /// Takes `steps` actions; keeps what was seen whenever the camera had moved, at most `limit` times.
    pub fn travel(&mut self, steps: usize, limit: usize) -> Vec<View> {
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
