//! State of one moment for the planner: positions of all things, and what the robot holds.

use crate::kitchen::Kitchen;
use crate::robot::action::Action;
use crate::robot::configuration::Configuration;
use crate::robot::links::{HAND, part_poses};
use crate::tasks::arm_point_nav::Environment;
use crate::tasks::arm_point_nav::episode::Episode;
use rapier3d::math::{Pose3, Vec3};

#[derive(Debug, Clone)]
pub struct Moment<'a> {
    pub kitchen: &'a Kitchen,
    /// Index among the movables of the target.
    pub target: usize,
    /// Where the target is to be brought, metres.
    pub goal: Vec3,
    pub robot: Configuration,
    /// `world_from_body` of every movable thing.
    pub movables: Vec<Pose3>,
    /// `hand_from_body` of the target if it is on the magnet.
    pub held: Option<Pose3>,
}

impl<'a> Moment<'a> {
    pub fn of(environment: &'a Environment) -> Self {
        let kitchen = environment.kitchen().as_ref();
        let (simulation, episode) = (environment.simulation(), environment.episode());
        let target = kitchen.target_movable(episode.category);
        let movables: Vec<Pose3> =
            (0..simulation.movable_count()).map(|movable| *simulation.movable_pose(movable)).collect();
        let held = simulation.holding().then(|| simulation.part_poses()[HAND].inverse() * movables[target]);
        Self { kitchen, target, goal: episode.goal, robot: *environment.robot(), movables, held }
    }

    pub fn beginning(kitchen: &'a Kitchen, episode: &Episode) -> Self {
        let target = kitchen.target_movable(episode.category);
        let first = kitchen.static_bodies().end;
        let mut movables = kitchen.settled_poses()[first..first + kitchen.solids().len()].to_vec();
        movables[target] = Pose3::from_translation(episode.start);
        let stand = episode.stand;
        let robot = Configuration::start(stand.x_m, stand.z_m, stand.yaw_ticks);
        Self { kitchen, target, goal: episode.goal, robot, movables, held: None }
    }

    /// The moment after these actions, if nothing is in their way and the target is then picked up where it is. None if
    /// they lead out of a range or the arm's reach.
    pub fn picked_up_after(mut self, actions: &[Action]) -> Option<Self> {
        for &action in actions {
            self.robot = self.robot.after(action)?;
        }
        let hand = part_poses(&self.robot.posture()).ok()?[HAND];
        self.held = Some(hand.inverse() * self.movables[self.target]);
        Some(self)
    }

    pub fn target_pose(&self) -> Pose3 {
        self.movables[self.target]
    }
}
