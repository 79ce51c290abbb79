//! Where the robot can be: its parts, and what it holds, against everything that stands in the kitchen.

use super::moment::Moment;
use super::obstacles::Obstacles;
use crate::kitchen::Kitchen;
use crate::physics::geometry::Solid;
use crate::robot::action::Action;
use crate::robot::configuration::{Configuration, Posture};
use crate::robot::links::{HAND, PartPoses, part_poses};
use rapier3d::math::Pose3;
use std::rc::Rc;

/// Room that a plan leaves between robot and fixed things, metres: more than the simulator's own tolerance, because
/// a plan is checked at fewer points of the way.
const FIXED_MARGIN_M: f32 = 0.004;
/// The same for what is held: it may touch what it stood on, but less deeply than the simulator allows.
const HELD_MARGIN_M: f32 = -0.003;
/// Room between robot and target before it is picked up, metres: it is to be touched by the magnet, not pushed.
const TARGET_MARGIN_M: f32 = 0.003;
/// What ends below this height does not stop the body, metres: the floor, on which it stands.
const FLOOR_M: f32 = 0.02;

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

#[derive(Clone)]
struct HeldObject<'a> {
    solid: &'a Solid,
    hand_from_body: Pose3,
}

#[derive(Clone)]
pub struct Space<'a> {
    kitchen: &'a Kitchen,
    fixed: Rc<Obstacles>,
    movable: Rc<Obstacles>,
    target: Rc<Obstacles>,
    held: Option<HeldObject<'a>>,
    care: Care,
    driving: bool,
}

impl<'a> Space<'a> {
    pub fn of(moment: &'a Moment, care: Care) -> Self {
        let kitchen = moment.kitchen;
        let mut fixed = Obstacles::default();
        for body in kitchen.static_bodies() {
            fixed.add(&Solid::of(&kitchen.bodies()[body].shape), &kitchen.settled_poses()[body]);
        }
        let (mut movable, mut target) = (Obstacles::default(), Obstacles::default());
        for (index, (solid, pose)) in kitchen.solids().iter().zip(&moment.movables).enumerate() {
            if index != moment.target {
                movable.add(solid, pose);
            } else if moment.held.is_none() {
                target.add(solid, pose);
            }
        }
        let solid = &kitchen.solids()[moment.target];
        let held = moment.held.map(|hand_from_body| HeldObject { solid, hand_from_body });
        let [fixed, movable, target] = [fixed, movable, target].map(Rc::new);
        Self { kitchen, fixed, movable, target, held, care, driving: false }
    }

    /// As the driving robot meets it.
    #[must_use]
    pub fn for_driving(&self) -> Self {
        Self { driving: true, ..self.clone() }
    }

    /// As the arm of a standing robot meets it.
    #[must_use]
    pub fn for_reaching(&self) -> Self {
        Self { driving: false, ..self.clone() }
    }

    /// Pose of what is held when the robot's parts are there.
    pub fn held_pose(&self, poses: &PartPoses) -> Option<Pose3> {
        self.held.as_ref().map(|held| poses[HAND] * held.hand_from_body)
    }

    pub fn free(&self, posture: &Posture) -> bool {
        let Ok(poses) = part_poses(posture) else { return false };
        // The body goes nowhere while the arm moves, and the floor does not stop it.
        let (first_part, above_m, movable_m) =
            if self.driving { (0, FLOOR_M, self.care.driving_m) } else { (1, f32::NEG_INFINITY, self.care.reaching_m) };
        // Whoever drives without care pushes the target as well.
        let target_m = (!self.driving || movable_m.is_some()).then_some(TARGET_MARGIN_M);
        let robot_is_free = self.kitchen.robot_parts().iter().zip(&poses).skip(first_part).all(|(part, pose)| {
            part.parts.iter().all(|(shape, body_from_part)| {
                let pose = *pose * *body_from_part;
                self.fixed.clear_of(shape, &pose, FIXED_MARGIN_M, above_m)
                    && target_m.is_none_or(|margin_m| self.target.clear_of(shape, &pose, margin_m, above_m))
                    && movable_m.is_none_or(|margin_m| self.movable.clear_of(shape, &pose, margin_m, above_m))
            })
        });
        robot_is_free
            && self.held.as_ref().is_none_or(|held| {
                held.solid.parts.iter().all(|(shape, body_from_part)| {
                    let pose = poses[HAND] * held.hand_from_body * *body_from_part;
                    self.fixed.clear_of(shape, &pose, HELD_MARGIN_M, above_m)
                        && movable_m.is_none_or(|margin_m| self.movable.clear_of(shape, &pose, margin_m, above_m))
                })
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
