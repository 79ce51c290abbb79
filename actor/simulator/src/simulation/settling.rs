//! How every episode starts: its target is set down and comes to rest. That is nearly all that starting an episode
//! costs, and it can be done ahead, piece by piece, by whoever waits.

use super::Simulation;
use crate::kitchen::Kitchen;
use crate::robot::configuration::Configuration;
use crate::robot::links::part_poses;
use rapier3d::math::{Pose3, Vec3};
use std::sync::Arc;

/// After an episode's target is set down, it has this many sub-steps to come to rest.
const SETTLE_SUBSTEPS: u32 = 240;

/// The settled kitchen with the robot at a start pose and one thing set down elsewhere, which comes to rest.
#[derive(Debug, Clone)]
pub struct Settling {
    simulation: Simulation,
    target: usize,
    target_position: Vec3,
    /// Sub-steps in which it can still come to rest.
    left: u32,
}

impl Settling {
    /// Sets the target down.
    ///
    /// # Panics
    /// If the robot's start configuration is out of its arm's reach: it is a constant that is not.
    pub fn new(
        kitchen: Arc<Kitchen>,
        substeps: u32,
        configuration: Configuration,
        target: usize,
        target_position: Vec3,
    ) -> Self {
        let poses = part_poses(&configuration.posture()).expect("the start configuration is within the arm's reach");
        let mut world = kitchen.world.clone();
        let mut things = kitchen.things.clone();
        world.put(kitchen.movables[target], Pose3::from_translation(target_position));
        things.disturb(target);
        let mut simulation = Simulation {
            kitchen,
            world,
            things,
            substeps,
            configuration,
            poses,
            placed: false,
            awake: true,
            held: None,
            began_at_rest: false,
            watch: None,
            log: None,
            path: Vec::new(),
            sweeps: Vec::new(),
            candidates: Vec::new(),
        };
        // At least one sub-step, which updates the broad phase.
        simulation.place_robot();
        simulation.advance_world();
        Self { simulation, target, target_position, left: SETTLE_SUBSTEPS }
    }

    /// Lets so many sub-steps pass. Returns whether there is nothing more to wait for.
    pub(crate) fn advance(&mut self, substeps: u32) -> bool {
        let substeps = substeps.min(self.left);
        self.simulation.pass(substeps);
        self.left -= substeps;
        !self.simulation.awake || self.left == 0
    }

    /// The episode's start. How the sub-steps before were divided does not matter.
    pub fn finish(mut self) -> Simulation {
        self.advance(self.left);
        let mut simulation = self.simulation;
        simulation.began_at_rest = !simulation.awake;
        if simulation.awake {
            tracing::warn!(
                kitchen = simulation.kitchen.id().number(),
                target = self.target,
                position_m = ?self.target_position.to_array(),
                "the target did not come to rest where it was set down: stopped there"
            );
        }
        simulation.world.put_to_sleep(&simulation.kitchen.movables);
        simulation.awake = false;
        simulation.look_at_things();
        simulation
    }
}
