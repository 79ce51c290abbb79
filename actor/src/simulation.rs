//! The kitchen in motion: a physics world, the robot in it, and how an action's motion is carried out.
//!
//! An action takes `substeps` sub-steps, or as many more as keep every part of the robot below
//! [`MAX_TRAVEL_PER_SUBSTEP_M`]. Fixed things and joint limits stop the robot, movable things are pushed. A motion
//! that is stopped is run backwards to where it began.
//!
//! Where everything movable sleeps and lies clear of the robot's path, physics would change nothing, and is left out.
//! That is part of the definition of a step, not an approximation chosen at run time: the same state and action leave
//! it out on every machine.
//!
//! What is held goes where the hand goes. It collides with the room and with other movable things, not with the robot
//! that holds it.

use crate::kitchen::Kitchen;
use crate::physics::geometry::Solid;
use crate::physics::world::World;
use crate::robot::configuration::{Configuration, Posture};
use crate::robot::links::{HAND, MAGNET_RADIUS_M, Motion, PART_COUNT, PartPoses, part_poses};
use rapier3d::dynamics::RigidBodyType;
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::sync::Arc;

/// No part of the robot travels further in one sub-step, metres: about a link's radius, so that nothing is skipped.
const MAX_TRAVEL_PER_SUBSTEP_M: f32 = 0.03;
/// The robot may touch fixed things this deeply, metres.
pub const CONTACT_TOLERANCE_M: f32 = 0.001;
/// A held thing may touch fixed things this deeply, metres: it was picked up from among them.
const HELD_TOLERANCE_M: f32 = 0.006;
/// A thing that the robot has entered this deeply, metres, ...
const JAM_DEPTH_M: f32 = 0.02;
/// ... for this many sub-steps on end is jammed between robot and room, and stops the motion.
const JAM_SUBSTEPS: u32 = 3;
/// Movable things this near to the robot's path call for physics, metres.
const PATH_MARGIN_M: f32 = 0.05;
/// After an episode's target is set down, it has this many sub-steps to come to rest.
const SETTLE_SUBSTEPS: u32 = 240;

/// A kitchen in motion.
#[derive(Debug, Clone)]
pub struct Simulation {
    kitchen: Arc<Kitchen>,
    world: World,
    substeps: u32,
    configuration: Configuration,
    poses: PartPoses,
    held: Option<Held>,
    began_at_rest: bool,
    // Scratch, without meaning between calls.
    path: Vec<PartPoses>,
    candidates: Vec<u32>,
}

/// The thing on the magnet.
#[derive(Debug, Clone, Copy)]
struct Held {
    movable: usize,
    hand_from_body: Pose3,
}

impl Simulation {
    /// The settled kitchen with the robot at a start pose and one thing set down elsewhere.
    ///
    /// # Panics
    /// If the robot's start configuration is out of its arm's reach: it is a constant that is not.
    pub fn start(
        kitchen: Arc<Kitchen>,
        substeps: u32,
        configuration: Configuration,
        target: usize,
        target_position: Vec3,
    ) -> Self {
        let poses = part_poses(&configuration.posture()).expect("the start configuration is within the arm's reach");
        let mut world = kitchen.world.clone();
        let body = world.body_mut(kitchen.movables[target]);
        body.set_position(Pose3::from_translation(target_position), true);
        for (&handle, pose) in kitchen.robot.iter().zip(&poses) {
            world.body_mut(handle).set_position(*pose, false);
        }
        // One step at least: it tells the broad phase where everything is now.
        world.step();
        let began_at_rest = world.settle(&kitchen.movables, SETTLE_SUBSTEPS);
        if !began_at_rest {
            tracing::warn!(
                kitchen = kitchen.id().number(),
                target,
                position_m = ?target_position.to_array(),
                "the target did not come to rest where it was set down: stopped there"
            );
        }
        Self {
            kitchen,
            world,
            substeps,
            configuration,
            poses,
            held: None,
            began_at_rest,
            path: Vec::new(),
            candidates: Vec::new(),
        }
    }

    /// Whether everything came to rest by itself after the target was set down. If not, it was stopped in its motion:
    /// just as repeatable, but not what physics would have done.
    pub fn began_at_rest(&self) -> bool {
        self.began_at_rest
    }

    /// How deeply the robot (without what it holds) stands in fixed things, metres; 0 if it touches none. Never above
    /// [`CONTACT_TOLERANCE_M`].
    pub fn depth_in_fixed_m(&self) -> f32 {
        self.kitchen
            .robot_parts
            .iter()
            .zip(&self.poses)
            .map(|(part, pose)| self.kitchen.scene.deepest_penetration_m(part, pose))
            .fold(0.0, f32::max)
    }

    /// The robot's configuration.
    pub fn configuration(&self) -> &Configuration {
        &self.configuration
    }

    /// Poses of the robot's collision bodies.
    pub fn part_poses(&self) -> &PartPoses {
        &self.poses
    }

    /// Position of the wrist, metres.
    pub fn wrist(&self) -> Vec3 {
        self.poses[HAND].translation
    }

    /// Whether something is held.
    pub fn holding(&self) -> bool {
        self.held.is_some()
    }

    /// Pose of a movable thing.
    pub fn movable_pose(&self, movable: usize) -> &Pose3 {
        self.world.body(self.kitchen.movables[movable]).position()
    }

    /// Linear and angular velocity (m/s, rad/s) of a movable thing, and whether it sleeps.
    pub fn movable_motion(&self, movable: usize) -> (Vec3, Vec3, bool) {
        let body = self.world.body(self.kitchen.movables[movable]);
        (body.linvel(), body.angvel(), body.is_sleeping())
    }

    /// Number of movable things.
    pub fn movable_count(&self) -> usize {
        self.kitchen.movables.len()
    }

    /// Lets an action's time pass without the robot's moving.
    pub fn idle(&mut self) {
        self.pass(self.substeps);
    }

    /// Turns the camera; nothing else moves.
    pub fn look(&mut self, next: Configuration) {
        self.configuration = next;
        self.idle();
    }

    /// Switches the magnet on. True if `movable` is held afterwards.
    pub fn pick_up(&mut self, movable: usize) -> bool {
        if self.held.is_none() {
            let pose = *self.movable_pose(movable);
            let gap_m = self.kitchen.solids[movable].distance_to_point_m(&pose, self.wrist());
            if gap_m <= MAGNET_RADIUS_M {
                // It goes with the hand from now on. What leans on it wakes up.
                let body = self.world.body_mut(self.kitchen.movables[movable]);
                body.set_linvel(Vec3::ZERO, false);
                body.set_angvel(Vec3::ZERO, false);
                body.set_body_type(RigidBodyType::KinematicPositionBased, true);
                self.held = Some(Held { movable, hand_from_body: self.poses[HAND].inverse() * pose });
            }
        }
        self.idle();
        self.held.is_some()
    }

    /// Moves the robot. True if it got there; otherwise it is back where it was.
    pub fn perform(&mut self, next: Configuration) -> bool {
        let (from, to) = (self.configuration.posture(), next.posture());
        let Some(arrived) = self.plan(&from, &to) else {
            self.idle();
            return false;
        };
        let moved = self.drive(arrived);
        if moved {
            self.configuration = next;
        }
        moved
    }

    /// Fills `path` with the poses at each sub-step, up to the last one that no fixed thing forbids. Returns whether
    /// that is the end of the way; nothing if the arm cannot follow it.
    fn plan(&mut self, from: &Posture, to: &Posture) -> Option<bool> {
        let goal = part_poses(to).ok()?;
        let count = self.substep_count(from, to, &goal);
        let motion = Motion::between(from, to).ok()?;
        self.path.clear();
        for k in 1..=count {
            let poses = if k == count { goal } else { motion.at(k as f32 / count as f32).ok()? };
            self.path.push(poses);
        }
        let mut clear = self.path.len();
        for part in 0..=PART_COUNT {
            let (solid, tolerance_m) = match (self.kitchen.robot_parts.get(part), self.held) {
                (Some(solid), _) => (solid, CONTACT_TOLERANCE_M),
                (None, Some(held)) => (&self.kitchen.solids[held.movable], HELD_TOLERANCE_M),
                (None, None) => break,
            };
            let poses = self.path[..clear].iter().map(|poses| self.pose_of(part, poses));
            let swept = swept_aabb(solid, poses);
            self.kitchen.scene.candidates(&swept, &mut self.candidates);
            if let Some(stop) = (0..clear).find(|&k| {
                let pose = self.pose_of(part, &self.path[k]);
                self.kitchen.scene.blocks(&self.candidates, solid, &pose, tolerance_m)
            }) {
                clear = stop;
            }
        }
        let arrived = clear == self.path.len();
        self.path.truncate(clear);
        Some(arrived)
    }

    /// Sub-steps of a motion: the action's own, or as many as keep the origin of every part below
    /// [`MAX_TRAVEL_PER_SUBSTEP_M`]. Measured are the straight way from start to goal and the arc of a turn about the
    /// robot's axis; the far end of a part that swings about its own origin can go further.
    fn substep_count(&self, from: &Posture, to: &Posture, goal: &PartPoses) -> u32 {
        let mut turn = (to.yaw_rad - from.yaw_rad).abs();
        if turn > std::f32::consts::PI {
            turn = 2.0 * std::f32::consts::PI - turn;
        }
        let axis = Vec3::new(from.x_m, 0.0, from.z_m);
        let mut travel = 0.0_f32;
        for part in 0..=PART_COUNT {
            if part == PART_COUNT && self.held.is_none() {
                break;
            }
            let (start, end) = (self.pose_of(part, &self.poses), self.pose_of(part, goal));
            let radius = (start.translation - axis).with_y(0.0).length();
            travel = travel.max((end.translation - start.translation).length()).max(turn * radius);
        }
        self.substeps.max(libm::ceilf(travel / MAX_TRAVEL_PER_SUBSTEP_M) as u32)
    }

    /// Pose of one of the robot's parts, or, past the last, of what it holds.
    fn pose_of(&self, part: usize, poses: &PartPoses) -> Pose3 {
        match (poses.get(part), self.held) {
            (Some(pose), _) => *pose,
            (None, Some(held)) => poses[HAND] * held.hand_from_body,
            (None, None) => Pose3::identity(),
        }
    }

    /// Follows the path; back again if it ends early or something jams. True if it arrived.
    fn drive(&mut self, arrived: bool) -> bool {
        if !self.needs_physics() {
            if arrived && let Some(&last) = self.path.last() {
                self.place_robot(&last);
            }
            return arrived;
        }
        let origin = self.poses;
        let path = std::mem::take(&mut self.path);
        let mut jammed_for = 0;
        let mut done = 0;
        for poses in &path {
            self.advance_robot(poses);
            done += 1;
            jammed_for = if self.deepest_contact_m() > JAM_DEPTH_M { jammed_for + 1 } else { 0 };
            if jammed_for == JAM_SUBSTEPS {
                break;
            }
        }
        let success = arrived && jammed_for < JAM_SUBSTEPS;
        let mut used = done;
        if !success {
            for poses in path[..done].iter().rev().skip(1) {
                self.advance_robot(poses);
                used += 1;
            }
            self.advance_robot(&origin);
            used += 1;
        }
        self.path = path;
        self.pass(self.substeps.saturating_sub(used as u32));
        success
    }

    /// Whether anything movable is awake or near the path.
    fn needs_physics(&self) -> bool {
        if !self.asleep() {
            return true;
        }
        let swept: Vec<Aabb> = (0..=PART_COUNT)
            .filter_map(|part| {
                let solid = match (self.kitchen.robot_parts.get(part), self.held) {
                    (Some(solid), _) => solid,
                    (None, Some(held)) => &self.kitchen.solids[held.movable],
                    (None, None) => return None,
                };
                let poses = std::iter::once(&self.poses).chain(&self.path).map(|poses| self.pose_of(part, poses));
                Some(swept_aabb(solid, poses).loosened(PATH_MARGIN_M))
            })
            .collect();
        (0..self.movable_count()).any(|movable| {
            !self.is_held(movable) && {
                let aabb = self.kitchen.solids[movable].aabb(self.movable_pose(movable));
                swept.iter().any(|path| path.intersects(&aabb))
            }
        })
    }

    fn is_held(&self, movable: usize) -> bool {
        self.held.is_some_and(|held| held.movable == movable)
    }

    /// Whether everything that moves by itself sleeps.
    fn asleep(&self) -> bool {
        (0..self.movable_count())
            .all(|movable| self.is_held(movable) || self.world.body(self.kitchen.movables[movable]).is_sleeping())
    }

    /// Sub-steps in which the robot stands still; ends early when everything sleeps.
    fn pass(&mut self, substeps: u32) {
        for _ in 0..substeps {
            if self.asleep() {
                break;
            }
            self.world.step();
        }
    }

    /// One sub-step in which the robot goes to these poses.
    fn advance_robot(&mut self, poses: &PartPoses) {
        for (&handle, pose) in self.kitchen.robot.iter().zip(poses) {
            self.world.body_mut(handle).set_next_kinematic_position(*pose);
        }
        if let Some(held) = self.held {
            let body = self.world.body_mut(self.kitchen.movables[held.movable]);
            body.set_next_kinematic_position(poses[HAND] * held.hand_from_body);
        }
        self.world.step();
        self.poses = *poses;
    }

    /// Puts the robot there outright: nothing is near enough to notice.
    fn place_robot(&mut self, poses: &PartPoses) {
        for (&handle, pose) in self.kitchen.robot.iter().zip(poses) {
            self.world.body_mut(handle).set_position(*pose, false);
        }
        if let Some(held) = self.held {
            let body = self.world.body_mut(self.kitchen.movables[held.movable]);
            body.set_position(poses[HAND] * held.hand_from_body, false);
        }
        self.poses = *poses;
    }

    /// How deeply the robot, or what it holds, has entered a movable thing, metres.
    fn deepest_contact_m(&self) -> f32 {
        let held = self.held.map(|held| self.kitchen.movables[held.movable]);
        self.kitchen
            .robot
            .iter()
            .copied()
            .chain(held)
            .map(|handle| self.world.deepest_contact_m(handle))
            .fold(0.0, f32::max)
    }
}

fn swept_aabb(solid: &Solid, poses: impl Iterator<Item = Pose3>) -> Aabb {
    let mut swept = Aabb::new_invalid();
    for pose in poses {
        swept.merge(&solid.aabb(&pose));
    }
    swept
}
