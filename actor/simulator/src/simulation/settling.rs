//! How every episode starts: what it sets down comes to rest. That is nearly all that starting an episode
//! costs, and it can be done ahead, piece by piece, by whoever waits.

use super::Simulation;
use crate::kitchen::Kitchen;
use crate::robot::configuration::Configuration;
use crate::robot::links::part_poses;
use rapier3d::math::{Pose3, Vec3};
use std::sync::Arc;

/// After an episode's target is set down, it has this many sub-steps to come to rest.
const SETTLE_SUBSTEPS: u32 = 240;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    pub robot: Configuration,
    /// The movable thing that is set down elsewhere than the kitchen has it, and where, metres.
    pub set_down: Option<(usize, Vec3)>,
}

/// The settled kitchen at an episode's start: what was set down comes to rest.
#[derive(Debug, Clone)]
pub struct Settling {
    simulation: Simulation,
    set_down: Option<(usize, Vec3)>,
    /// Sub-steps in which it can still come to rest.
    left: u32,
}

impl Settling {
    /// Places the robot, and sets down what is to be. Panics if the robot's start configuration is out of its arm's
    /// reach: it is a constant that is not.
    pub fn new(kitchen: Arc<Kitchen>, substeps: u32, Start { robot, set_down }: Start) -> Self {
        let poses = part_poses(&robot.posture()).expect("the start configuration is within the arm's reach");
        let mut world = kitchen.world.clone();
        let mut things = kitchen.things.clone();
        if let Some((movable, place)) = set_down {
            world.put(kitchen.movables[movable], Pose3::from_translation(place));
            things.disturb(movable);
        }
        let mut simulation = Simulation {
            kitchen,
            world,
            things,
            substeps,
            configuration: robot,
            poses,
            placed: false,
            awake: true,
            held: None,
            began_at_rest: false,
            motions: None,
            log: None,
            path: Vec::new(),
            sweeps: Vec::new(),
            candidates: Vec::new(),
        };
        // At least one sub-step, which updates the broad phase.
        simulation.place_robot();
        simulation.advance_world();
        Self { simulation, set_down, left: SETTLE_SUBSTEPS }
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
                set_down = ?self.set_down,
                "what was set down did not come to rest: stopped there"
            );
        }
        simulation.world.put_to_sleep(&simulation.kitchen.movables);
        simulation.awake = false;
        simulation.look_at_things();
        simulation
    }
}
