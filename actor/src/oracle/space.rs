//! Where the robot can be: its parts, and what it holds, against everything that stands in the kitchen.

use super::moment::Moment;
use crate::kitchen::Kitchen;
use crate::physics::geometry::Solid;
use crate::robot::configuration::{Configuration, Posture};
use crate::robot::links::{HAND, PartPoses, part_poses};
use proto::action::Action;
use rapier3d::geometry::{Aabb, SharedShape};
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;
use rapier3d::parry::query;

/// Room that a plan leaves between robot and fixed things, metres: more than the simulator's own tolerance, because
/// a plan is checked at fewer points of the way.
const FIXED_MARGIN_M: f32 = 0.004;
/// The same for what is held: it may touch what it stood on, but less deeply than the simulator allows.
const HELD_MARGIN_M: f32 = -0.003;
/// Room between robot and target before it is picked up, metres: it is to be touched by the magnet, not pushed.
const TARGET_MARGIN_M: f32 = 0.003;
/// What ends below this height does not stop the body, metres: the floor, on which it stands.
const FLOOR_M: f32 = 0.02;
/// How far from the body's axis the arm and what it holds can get, metres.
const ARM_REGION_M: f32 = 1.3;

/// Room to leave between the robot, with what it holds, and movable things, metres; none ignores them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Care {
    /// While the body drives and turns.
    pub driving_m: Option<f32>,
    /// While the arm moves.
    pub reaching_m: Option<f32>,
}

impl Care {
    /// Movable things do not count.
    pub const NONE: Self = Self { driving_m: None, reaching_m: None };
}

/// Convex solids that stand still, with their bounding boxes.
#[derive(Clone, Default)]
struct Obstacles {
    aabbs: Vec<Aabb>,
    parts: Vec<(SharedShape, Pose3)>,
}

impl Obstacles {
    fn add(&mut self, solid: &Solid, world_from_body: &Pose3) {
        for (shape, body_from_part) in &solid.parts {
            let pose = *world_from_body * *body_from_part;
            self.aabbs.push(shape.compute_aabb(&pose));
            self.parts.push((shape.clone(), pose));
        }
    }

    fn filtered(&self, keep: impl Fn(&Aabb) -> bool) -> Self {
        let mut result = Self::default();
        for (aabb, part) in self.aabbs.iter().zip(&self.parts) {
            if keep(aabb) {
                result.aabbs.push(*aabb);
                result.parts.push(part.clone());
            }
        }
        result
    }

    /// Whether a convex solid keeps `margin_m` to all of them; a negative margin is a depth it may enter.
    fn clear_of(&self, shape: &SharedShape, pose: &Pose3, margin_m: f32) -> bool {
        let reach = shape.compute_aabb(pose).loosened(margin_m.max(0.0));
        self.aabbs.iter().zip(&self.parts).all(|(aabb, (other, other_pose))| {
            !aabb.intersects(&reach)
                || match query::contact(pose, &**shape, other_pose, &**other, margin_m.max(0.0)) {
                    Ok(Some(contact)) => contact.dist >= margin_m,
                    Ok(None) => true,
                    // Parry has an algorithm for every pair of convex solids; were there none, it would count as hit.
                    Err(_) => false,
                }
        })
    }
}

/// What is on the magnet.
#[derive(Clone)]
struct Held<'a> {
    solid: &'a Solid,
    hand_from_body: Pose3,
}

/// The kitchen as a planner sees it at one moment.
#[derive(Clone)]
pub struct Space<'a> {
    kitchen: &'a Kitchen,
    fixed: Obstacles,
    movable: Obstacles,
    target: Obstacles,
    held: Option<Held<'a>>,
    movable_margin_m: Option<f32>,
    first_part: usize,
    care: Care,
}

impl<'a> Space<'a> {
    /// Everything as it stands at a moment.
    pub fn of(moment: &'a Moment, care: Care) -> Self {
        let kitchen = moment.kitchen;
        let mut fixed = Obstacles::default();
        for body in kitchen.static_bodies() {
            fixed.add(&Solid::of(&kitchen.bodies()[body].shape), &kitchen.settled_poses()[body]);
        }
        let (mut movable, mut target) = (Obstacles::default(), Obstacles::default());
        for (index, (solid, pose)) in kitchen.solids.iter().zip(&moment.movables).enumerate() {
            if index != moment.target {
                movable.add(solid, pose);
            } else if moment.held.is_none() {
                target.add(solid, pose);
            }
        }
        let solid = &kitchen.solids[moment.target];
        let held = moment.held.map(|hand_from_body| Held { solid, hand_from_body });
        Self { kitchen, fixed, movable, target, held, movable_margin_m: None, first_part: 0, care }
    }

    /// As the driving robot meets it.
    pub fn for_driving(&self) -> Self {
        let mut space = self.clone();
        space.fixed = self.fixed.filtered(|aabb| aabb.maxs.y > FLOOR_M);
        space.movable_margin_m = self.care.driving_m;
        if space.movable_margin_m.is_none() {
            space.target = Obstacles::default();
        }
        space
    }

    /// As the arm of a robot standing there meets it.
    pub fn for_reaching(&self, at: &Configuration) -> Self {
        let middle = Vec3::new(at.x_m, 1.0, at.z_m);
        let half = Vec3::new(ARM_REGION_M, 10.0, ARM_REGION_M);
        let region = Aabb::new(middle - half, middle + half);
        Self {
            kitchen: self.kitchen,
            fixed: self.fixed.filtered(|aabb| aabb.intersects(&region)),
            movable: self.movable.filtered(|aabb| aabb.intersects(&region)),
            target: self.target.clone(),
            held: self.held.clone(),
            movable_margin_m: self.care.reaching_m,
            first_part: 1,
            care: self.care,
        }
    }

    /// Pose of what is held when the robot's parts are there.
    pub fn held_pose(&self, poses: &PartPoses) -> Option<Pose3> {
        self.held.as_ref().map(|held| poses[HAND] * held.hand_from_body)
    }

    /// Whether the robot can be in this posture.
    pub fn free(&self, posture: &Posture) -> bool {
        let Ok(poses) = part_poses(posture) else { return false };
        let robot = self.kitchen.robot_parts.iter().zip(&poses).skip(self.first_part);
        for (part, pose) in robot {
            for (shape, body_from_part) in &part.parts {
                let pose = *pose * *body_from_part;
                if !self.fixed.clear_of(shape, &pose, FIXED_MARGIN_M)
                    || !self.target.clear_of(shape, &pose, TARGET_MARGIN_M)
                    || self.movable_margin_m.is_some_and(|margin_m| !self.movable.clear_of(shape, &pose, margin_m))
                {
                    return false;
                }
            }
        }
        let (Some(held), Some(pose)) = (&self.held, self.held_pose(&poses)) else { return true };
        held.solid.parts.iter().all(|(shape, body_from_part)| {
            let pose = pose * *body_from_part;
            self.fixed.clear_of(shape, &pose, HELD_MARGIN_M)
                && self.movable_margin_m.is_none_or(|margin_m| self.movable.clear_of(shape, &pose, margin_m))
        })
    }

    /// Whether the robot can take an action, looked at in a few points of the way.
    pub fn passable(&self, from: &Configuration, action: Action, to: &Configuration) -> bool {
        let samples = match action {
            Action::MoveAheadContinuous => 4,
            Action::RotateRightContinuous | Action::RotateLeftContinuous => 6,
            _ => 2,
        };
        let (from, to) = (from.posture(), to.posture());
        (1..=samples).rev().all(|k| self.free(&from.towards(&to, k as f32 / samples as f32)))
    }
}
