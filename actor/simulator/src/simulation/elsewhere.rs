//! A kitchen whose things another physics engine moves. The robot's ways, the magnet and the camera stay here; the engine
//! takes the robot along a [`Way`], and what it made of that is [placed](Simulation::place).

use super::Simulation;
use crate::robot::configuration::Configuration;
use crate::robot::links::{PartPoses, part_poses};
use rapier3d::math::Pose3;

/// Where an action takes the robot, unless things stop it.
#[derive(Debug, Clone)]
pub struct Way {
    /// The robot's collision bodies, sub-step after sub-step; the first is where they are.
    pub parts: Vec<PartPoses>,
    /// Whether the action succeeds if nothing stops the robot. If not, the way ends where something fixed does, and the
    /// robot goes back.
    pub arrives: bool,
}

impl Simulation {
    pub(crate) fn way(&mut self, next: &Configuration) -> Way {
        match self.plan(&self.configuration.posture(), &next.posture()) {
            Some(arrives) => Way { parts: self.path.clone(), arrives },
            None => self.stay(false),
        }
    }

    pub(crate) fn stay(&self, arrives: bool) -> Way {
        Way { parts: vec![self.poses], arrives }
    }

    /// Whether something would be held if the magnet were switched on to take `movable`.
    pub(crate) fn would_hold(&self, movable: usize) -> bool {
        self.holding() || self.reaches(movable)
    }

    /// The magnet takes `movable`, unless it holds something.
    pub(crate) fn attach(&mut self, movable: usize) {
        if !self.holding() {
            self.take(movable);
        }
    }

    /// The robot is in this configuration, to which there was a way, and the movable things are here. Panics if the arm
    /// cannot take the configuration, or there are more poses than things.
    pub(crate) fn place(&mut self, configuration: Configuration, world_from_movables: &[Pose3]) {
        self.configuration = configuration;
        self.stand(&part_poses(&configuration.posture()).expect("there was a way to it"));
        for (thing, pose) in world_from_movables.iter().enumerate() {
            if pose == self.movable_pose(thing) {
                continue;
            }
            if self.held.is_some_and(|held| held.movable == thing) {
                self.things.carry(thing, pose, &self.kitchen.solids[thing]);
            } else {
                self.world.put(self.kitchen.movables[thing], *pose);
                self.things.disturb(thing);
            }
        }
        self.world.put_to_sleep(&self.kitchen.movables);
        self.awake = false;
        self.things.look(&self.world, &self.kitchen.movables, &self.kitchen.solids);
    }
}
