//! The kitchen in motion: a physics world, the robot in it, and how an action's motion is carried out.
//!
//! An action takes `substeps` sub-steps, or as many more as keep every part of the robot below
//! [`MAX_TRAVEL_PER_SUBSTEP_M`]. Fixed things and joint limits stop the robot, movable things are pushed. A motion
//! that is stopped is run backwards to where it began.
//!
//! Where everything movable sleeps and the robot touches nothing, physics would change nothing, and is left out, be it
//! for a whole action or for the sub-steps before the first touch. That is part of the definition of a step, not an
//! approximation chosen at run time: the same state and action leave it out on every machine.
//!
//! What is held goes where the hand goes. It collides with the room and with other movable things, not with the robot
//! that holds it.

mod elsewhere;
mod settling;

pub use elsewhere::Way;
pub use settling::{Settling, Start};

use crate::kitchen::Kitchen;
use crate::physics::geometry::length;
use crate::physics::sweep::Sweep;
use crate::physics::things::Things;
use crate::physics::world::World;
use crate::robot::configuration::{Configuration, Posture};
use crate::robot::dimensions::MAGNET_RADIUS_M;
use crate::robot::links::{HAND, Motion, PART_COUNT, PartPoses, part_poses};
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::ops::Range;
use std::sync::Arc;

/// No part of the robot travels further in one sub-step, metres: about a link's radius, so that nothing is skipped.
const MAX_TRAVEL_PER_SUBSTEP_M: f32 = 0.03;
/// The robot may touch fixed things this deeply, metres.
pub const CONTACT_TOLERANCE_M: f32 = 0.001;
/// Setting the target down moves nothing else further than this, metres: what it wakes comes to rest where it stood.
pub const OTHERS_DRIFT_M: f32 = 1e-4;
/// A held thing may touch fixed things this deeply, metres: it was picked up from among them.
const HELD_TOLERANCE_M: f32 = 0.006;
/// A thing that the robot has entered this deeply, or that has been pushed this deep into another or into the room, is
/// jammed and stops the motion, metres.
pub const JAM_DEPTH_M: f32 = 0.015;
/// A motion that is stopped by a jam has made it deeper by this much, metres: less than a part that pushes travels in a
/// sub-step, more than a contact wavers by itself.
pub const JAM_GROWTH_M: f32 = 0.001;
/// A movable thing this near to the robot, or to what it holds, calls for physics, metres.
const TOUCH_M: f32 = 0.005;

#[derive(Debug, Clone)]
pub struct Simulation {
    kitchen: Arc<Kitchen>,
    world: World,
    things: Things,
    substeps: u32,
    configuration: Configuration,
    poses: PartPoses,
    /// Whether the robot stands there in the physics world too. Where physics is left out it need not.
    placed: bool,
    /// Whether anything moves by itself.
    awake: bool,
    held: Option<HeldObject>,
    began_at_rest: bool,
    /// Since the last call of [`Simulation::take_motions`], if they are noted.
    motions: Option<Vec<ThingMotion>>,
    /// The robot's path since the last call of [`Simulation::take_substeps`], if it is recorded.
    log: Option<Vec<Substep>>,
    // Scratch, without meaning between calls: the way of the robot, pose by pose and body by body.
    path: Vec<PartPoses>,
    sweeps: Vec<Sweep>,
    candidates: Vec<u32>,
}

/// Where the robot went in one sub-step: what another physics engine needs to be driven the same way.
#[derive(Debug, Clone, Copy)]
pub struct Substep {
    pub parts: PartPoses,
    /// The movable thing on the magnet and where it went, if there is one.
    pub held: Option<(usize, Pose3)>,
}

/// A movable thing after a sub-step of physics that it spent awake.
#[derive(Debug, Clone, Copy)]
pub struct ThingMotion {
    pub movable: usize,
    pub pose: Pose3,
    pub velocity_m_per_s: Vec3,
    pub depth_in_fixed_m: f32,
}

#[derive(Debug, Clone, Copy)]
struct HeldObject {
    movable: usize,
    hand_from_body: Pose3,
}

impl Simulation {
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

    pub fn configuration(&self) -> &Configuration {
        &self.configuration
    }

    pub fn part_poses(&self) -> &PartPoses {
        &self.poses
    }

    pub fn wrist(&self) -> Vec3 {
        self.poses[HAND].translation
    }

    pub fn holding(&self) -> bool {
        self.held.is_some()
    }

    pub fn movable_pose(&self, movable: usize) -> &Pose3 {
        &self.things.poses()[movable]
    }

    /// Poses, and hash of poses, velocities and sleep flags, of all movable things.
    pub fn things(&self) -> &Things {
        &self.things
    }

    /// Where the robot is, and what it holds.
    pub fn substep(&self) -> Substep {
        Substep {
            parts: self.poses,
            held: self.held.map(|held| (held.movable, self.poses[HAND] * held.hand_from_body)),
        }
    }

    /// Sub-steps in which the robot moved since the last call, none at the first: from then on they are noted. Those
    /// that were left out because nothing could have changed are among them; those in which only time passes are not.
    pub fn take_substeps(&mut self) -> Vec<Substep> {
        self.log.replace(Vec::new()).unwrap_or_default()
    }

    /// How things moved since the last call, none at the first: from then on it is noted.
    pub fn take_motions(&mut self) -> Vec<ThingMotion> {
        self.motions.replace(Vec::new()).unwrap_or_default()
    }

    pub fn movable_count(&self) -> usize {
        self.things.poses().len()
    }

    /// Lets an action's time pass without the robot's moving.
    pub fn idle(&mut self) {
        self.pass(self.substeps);
        self.look_at_things();
    }

    /// Turns the camera; nothing else moves.
    pub fn look(&mut self, next: Configuration) {
        self.configuration = next;
        self.idle();
    }

    /// Switches the magnet on. True if `movable` is held afterwards.
    pub(crate) fn pick_up(&mut self, movable: usize) -> bool {
        if self.holding() || !self.reaches(movable) {
            self.idle();
            return self.holding();
        }
        self.take(movable);
        // What leans on it wakes up in this sub-step.
        self.place_robot();
        self.advance_world();
        self.pass(self.substeps - 1);
        self.look_at_things();
        true
    }

    /// Whether the magnet touches a movable thing.
    fn reaches(&self, movable: usize) -> bool {
        self.kitchen.solids[movable].distance_to_point_m(self.movable_pose(movable), self.wrist()) <= MAGNET_RADIUS_M
    }

    fn take(&mut self, movable: usize) {
        let pose = *self.movable_pose(movable);
        self.world.take_hold(self.kitchen.movables[movable]);
        self.held = Some(HeldObject { movable, hand_from_body: self.poses[HAND].inverse() * pose });
        self.things.carry(movable, &pose, &self.kitchen.solids[movable]);
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
        self.look_at_things();
        moved
    }

    /// Fills `path` with the present poses and those at each sub-step, up to the last one that no fixed thing forbids.
    /// Returns whether that is the end of the way; nothing if the arm cannot follow it.
    fn plan(&mut self, from: &Posture, to: &Posture) -> Option<bool> {
        let goal = part_poses(to).ok()?;
        let count = self.substep_count(from, to, &goal);
        let motion = Motion::between(from, to).ok()?;
        self.path.clear();
        self.path.push(self.poses);
        for k in 1..=count {
            let poses = if k == count { goal } else { motion.at(k as f32 / count as f32).ok()? };
            self.path.push(poses);
        }
        let kitchen = Arc::clone(&self.kitchen);
        let bodies = kitchen.robot_parts.iter().zip(std::iter::repeat(CONTACT_TOLERANCE_M));
        let held = self.held.map(|held| (&kitchen.solids[held.movable], HELD_TOLERANCE_M));
        self.sweeps.resize_with(PART_COUNT + 1, Sweep::default);
        let mut swept = Aabb::new_invalid();
        for (body, (solid, _)) in bodies.clone().chain(held).enumerate() {
            let hand_from_body = self.held.map(|held| held.hand_from_body);
            let poses = self.path.iter().map(|poses| pose_of(body, poses, hand_from_body));
            self.sweeps[body].record(solid, poses);
            swept.merge(self.sweeps[body].aabb());
        }
        kitchen.scene.candidates(&swept, &mut self.candidates);
        let mut end = self.path.len();
        for (sweep, (solid, tolerance_m)) in self.sweeps.iter().zip(bodies.chain(held)) {
            for &index in &self.candidates {
                let (aabb, fixed, pose) = kitchen.scene.part(index);
                if aabb.intersects(sweep.aabb()) {
                    end = sweep.first_nearer(solid, 1..end, fixed, pose, -tolerance_m).unwrap_or(end);
                }
            }
        }
        let arrived = end == self.path.len();
        self.path.truncate(end);
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
        let hand_from_body = self.held.map(|held| held.hand_from_body);
        for body in 0..PART_COUNT + usize::from(self.held.is_some()) {
            let start = pose_of(body, &self.poses, hand_from_body);
            let end = pose_of(body, goal, hand_from_body);
            let radius = length((start.translation - axis).with_y(0.0));
            travel = travel.max(length(end.translation - start.translation)).max(turn * radius);
        }
        self.substeps.max(libm::ceilf(travel / MAX_TRAVEL_PER_SUBSTEP_M) as u32)
    }

    /// Follows the path; back again if it ends early or something jams. True if it arrived.
    fn drive(&mut self, arrived: bool) -> bool {
        let path = std::mem::take(&mut self.path);
        let last = path.len() - 1;
        let mut at = 0;
        // Whatever does not deepen a jam is not stopped by it: out of one the robot must be able to leave.
        let (mut jammed, mut least_m) = (false, self.deepest_contact_m());
        while at < last && !jammed {
            if !self.awake {
                // As far as nothing is touched, nor left that was touched.
                let free = self.first_touch(at..last + 1).map_or(last, |touch| touch.saturating_sub(1));
                if free > at {
                    at = free;
                    self.stand(&path[at]);
                    continue;
                }
            }
            at += 1;
            self.advance_robot(&path[at]);
            let depth_m = self.deepest_contact_m();
            jammed = depth_m > JAM_DEPTH_M.max(least_m + JAM_GROWTH_M);
            least_m = least_m.min(depth_m);
        }
        let success = arrived && !jammed;
        let mut used = at;
        self.note(path[1..=at].iter());
        if !success {
            self.note(path[..at].iter().rev());
            if self.awake || self.first_touch(0..at + 1).is_some() {
                for poses in path[..at].iter().rev() {
                    self.advance_robot(poses);
                }
                used += at;
            } else {
                self.stand(&path[0]);
            }
        }
        self.path = path;
        self.pass(self.substeps.saturating_sub(used as u32));
        success
    }

    /// Records the robot's path, if recording is on.
    fn note<'a>(&mut self, way: impl Iterator<Item = &'a PartPoses>) {
        let held = self.held;
        if let Some(log) = &mut self.log {
            log.extend(way.map(|poses| Substep {
                parts: *poses,
                held: held.map(|held| (held.movable, poses[HAND] * held.hand_from_body)),
            }));
        }
    }

    /// First pose in a range of the path at which the robot, or what it holds, touches a movable thing.
    fn first_touch(&mut self, range: Range<usize>) -> Option<usize> {
        self.look_at_things();
        let kitchen = &self.kitchen;
        let held = self.held.map(|held| &kitchen.solids[held.movable]);
        let bodies = || self.sweeps.iter().zip(kitchen.robot_parts.iter().chain(held));
        let mut swept = Aabb::new_invalid();
        for (sweep, _) in bodies() {
            swept.merge(sweep.aabb());
        }
        let swept = swept.loosened(TOUCH_M);
        let mut end = range.end;
        for (thing, aabb) in self.things.aabbs().iter().enumerate() {
            if !aabb.intersects(&swept) || self.held.is_some_and(|held| held.movable == thing) {
                continue;
            }
            let (aabb, pose) = (aabb.loosened(TOUCH_M), self.things.poses()[thing]);
            for (sweep, body) in bodies().filter(|(sweep, _)| aabb.intersects(sweep.aabb())) {
                for (shape, body_from_part) in &kitchen.solids[thing].parts {
                    let pose = pose * *body_from_part;
                    end = sweep.first_nearer(body, range.start..end, shape, &pose, TOUCH_M).unwrap_or(end);
                }
            }
        }
        (end < range.end).then_some(end)
    }

    /// Sub-steps in which the robot stands still; ends early when everything sleeps.
    fn pass(&mut self, substeps: u32) {
        if self.awake {
            self.place_robot();
        }
        for _ in 0..substeps {
            if !self.awake {
                break;
            }
            self.advance_world();
        }
    }

    /// One sub-step in which the robot goes to these poses.
    fn advance_robot(&mut self, poses: &PartPoses) {
        self.place_robot();
        let held = self.held.map(|held| (self.kitchen.movables[held.movable], poses[HAND] * held.hand_from_body));
        self.world.drive(self.kitchen.robot.iter().copied().zip(poses.iter().copied()).chain(held));
        self.poses = *poses;
        self.advance_world();
    }

    /// Sets the robot's pose directly: nothing is near enough to be touched.
    fn stand(&mut self, poses: &PartPoses) {
        self.poses = *poses;
        self.placed = false;
    }

    /// Moves the robot's bodies in the physics world to the robot's pose, if they are not there.
    fn place_robot(&mut self) {
        if std::mem::replace(&mut self.placed, true) {
            return;
        }
        for (&handle, pose) in self.kitchen.robot.iter().zip(&self.poses) {
            self.world.put(handle, *pose);
        }
        if let Some(held) = self.held {
            self.world.put(self.kitchen.movables[held.movable], self.poses[HAND] * held.hand_from_body);
        }
    }

    fn advance_world(&mut self) {
        self.world.step();
        self.awake = false;
        for thing in self.world.awake_movables() {
            self.awake = true;
            self.things.disturb(thing);
            if let Some(motions) = &mut self.motions {
                let body = self.world.body(self.kitchen.movables[thing]);
                let (pose, velocity_m_per_s) = (*body.position(), body.linvel());
                let depth_in_fixed_m = self.kitchen.scene.deepest_penetration_m(&self.kitchen.solids[thing], &pose);
                motions.push(ThingMotion { movable: thing, pose, velocity_m_per_s, depth_in_fixed_m });
            }
        }
    }

    fn look_at_things(&mut self) {
        self.things.look(&self.world, &self.kitchen.movables, &self.kitchen.solids);
        if let Some(held) = self.held {
            let pose = self.poses[HAND] * held.hand_from_body;
            if pose != *self.movable_pose(held.movable) {
                self.things.carry(held.movable, &pose, &self.kitchen.solids[held.movable]);
            }
        }
    }

    /// How deeply, metres, the robot, or what it holds, has entered a movable thing, or one that is awake has entered
    /// whatever it touches.
    fn deepest_contact_m(&self) -> f32 {
        let held = self.held.map(|held| self.kitchen.movables[held.movable]);
        let awake = self.world.awake_movables().map(|thing| self.kitchen.movables[thing]);
        self.kitchen
            .robot
            .iter()
            .copied()
            .chain(held)
            .chain(awake)
            .map(|handle| self.world.deepest_contact_m(handle))
            .fold(0.0, f32::max)
    }
}

/// Pose of one of the robot's parts, or, past the last, of what it holds.
fn pose_of(body: usize, poses: &PartPoses, hand_from_body: Option<Pose3>) -> Pose3 {
    match (poses.get(body), hand_from_body) {
        (Some(pose), _) => *pose,
        (None, Some(hand_from_body)) => poses[HAND] * hand_from_body,
        (None, None) => unreachable!("no body but a held one comes after the robot's parts"),
    }
}
