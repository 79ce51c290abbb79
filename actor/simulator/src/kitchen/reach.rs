//! Which places the robot can reach. The test is whether the arm fits there without touching anything fixed, not the
//! distance from free floor: a bar above a counter, a wall behind it or a shelf above a shelf can block a near place.

use crate::physics::fixed_scene::FixedScene;
use crate::physics::geometry::Solid;
use crate::robot::configuration::{ARM_HEIGHT_MAX_M, ARM_HEIGHT_MIN_M, Posture, TURN_RAD};
use crate::robot::dimensions::{ARM_BASE_AHEAD_M, REACH_M};
use crate::robot::links::{PART_COUNT, part_poses};
use rapier3d::geometry::Aabb;
use rapier3d::math::Vec3;
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::f32::consts::FRAC_PI_2;

/// The arm keeps this much of its length, metres: things are not always held by their middle, the wrist moves in steps,
/// and a place stands for those about it.
const RESERVE_M: f32 = 0.1;
/// The wrist is held this high above the surface, metres: above a low thing, beside a high one.
const WRIST_ABOVE_M: f32 = 0.12;
/// The arm leaves this much room to what is fixed, metres.
const CLEARANCE_M: f32 = 0.01;
/// A place is reached only if it is from this many positions on the floor: a robot that drives in steps of 0.2 m comes
/// near to some of them.
const POSITIONS_LEAST: usize = 4;
/// Turns of the elbow about the line from shoulder to wrist, radians: up, and to either side where something hangs low.
const ELBOWS_RAD: [f32; 3] = [0.0, FRAC_PI_2, -FRAC_PI_2];
/// Directions that the robot can face.
const DIRECTIONS: usize = 8;

pub struct Reach<'a> {
    floor: &'a [(f32, f32)],
    scene: &'a FixedScene,
    parts: &'a [Solid; PART_COUNT],
    /// Yaw of each direction, its sine and its cosine.
    directions: [(f32, f32, f32); DIRECTIONS],
}

impl<'a> Reach<'a> {
    /// `floor` are the positions (x, z) at which the body can stand, metres, `parts` the robot's collision bodies.
    pub fn new(floor: &'a [(f32, f32)], scene: &'a FixedScene, parts: &'a [Solid; PART_COUNT]) -> Self {
        let directions = std::array::from_fn(|turns| {
            let yaw_rad = turns as f32 * TURN_RAD;
            let (sin, cos) = libm::sincosf(yaw_rad);
            (yaw_rad, sin, cos)
        });
        Self { floor, scene, parts, directions }
    }

    pub fn comes_to(&self, point: Vec3) -> bool {
        const FURTHEST_M: f32 = ARM_BASE_AHEAD_M + REACH_M;
        let wrist = point + Vec3::new(0.0, WRIST_ABOVE_M, 0.0);
        let about = Vec3::splat(FURTHEST_M);
        let volume = Aabb::new(wrist - about, wrist + about);
        let fixed: Vec<Aabb> = self.scene.aabbs().iter().filter(|aabb| aabb.intersects(&volume)).copied().collect();
        let mut positions = 0;
        for &(x_m, z_m) in self.floor {
            let (x, z) = (wrist.x - x_m, wrist.z - z_m);
            if x * x + z * z <= FURTHEST_M * FURTHEST_M && self.holds_from((x_m, z_m), wrist, &fixed) {
                positions += 1;
                if positions == POSITIONS_LEAST {
                    return true;
                }
            }
        }
        false
    }

    /// Whether the robot that stands there can hold its wrist at a position, facing some way.
    fn holds_from(&self, (x_m, z_m): (f32, f32), wrist: Vec3, fixed: &[Aabb]) -> bool {
        const LONGEST_M: f32 = REACH_M - RESERVE_M;
        let arm_height_m = wrist.y.clamp(ARM_HEIGHT_MIN_M, ARM_HEIGHT_MAX_M);
        let (x, z) = (wrist.x - x_m, wrist.z - z_m);
        self.directions.iter().any(|&(yaw_rad, sin, cos)| {
            let wrist_m = Vec3::new(x * cos - z * sin, wrist.y - arm_height_m, x * sin + z * cos - ARM_BASE_AHEAD_M);
            wrist_m.z >= 0.0
                && wrist_m.length_squared() <= LONGEST_M * LONGEST_M
                && ELBOWS_RAD.iter().any(|&elbow_rad| {
                    let posture = Posture {
                        x_m,
                        z_m,
                        yaw_rad,
                        arm_height_m,
                        wrist_m,
                        elbow_rad,
                        wrist_yaw_rad: 0.0,
                        wrist_pitch_rad: 0.0,
                    };
                    self.clear(&posture, fixed)
                })
        })
    }

    /// Whether the arm can take a posture and leaves room. The body stands on free floor.
    fn clear(&self, posture: &Posture, fixed: &[Aabb]) -> bool {
        part_poses(posture).is_ok_and(|poses| {
            self.parts.iter().zip(&poses).skip(1).all(|(part, pose)| {
                let aabb = part.aabb(pose).loosened(CLEARANCE_M);
                !fixed.iter().any(|other| other.intersects(&aabb))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::links::part_shapes;
    use crate::shape::{Primitive, Shape};
    use rapier3d::math::Pose3;

    /// A counter of 0.6 m depth along x, its front at z = 0, its top at 0.9 m, and free floor before it.
    fn kitchen(more: &[(Vec3, Vec3)]) -> (FixedScene, Vec<(f32, f32)>) {
        let mut scene = FixedScene::default();
        let counter = (Vec3::new(-2.0, 0.0, 0.0), Vec3::new(2.0, 0.9, 0.6));
        for (low, high) in std::iter::once(&counter).chain(more) {
            let solid = Solid::of(&Shape::of(Primitive::Cuboid { half_extents_m: 0.5 * (*high - *low) }));
            scene.add(&solid, &Pose3::from_translation(0.5 * (*low + *high)));
        }
        let floor = (0..16)
            .flat_map(|row| (0..16).map(move |column| (-1.0 + 0.125 * column as f32, -0.25 - 0.125 * row as f32)));
        (scene, floor.collect())
    }

    fn comes_to(more: &[(Vec3, Vec3)], point: Vec3) -> bool {
        let (scene, floor) = kitchen(more);
        let parts = part_shapes().map(|shape| Solid::of(&shape));
        Reach::new(&floor, &scene, &parts).comes_to(point)
    }

    #[test]
    fn the_arm_comes_over_a_counter_as_far_as_it_reaches() {
        assert!(comes_to(&[], Vec3::new(0.0, 0.9, 0.05)));
        assert!(comes_to(&[], Vec3::new(0.0, 0.9, 0.4)));
        assert!(!comes_to(&[], Vec3::new(0.0, 0.9, 0.75)), "further than the arm is long");
        assert!(!comes_to(&[], Vec3::new(-1.9, 0.9, 0.3)), "no floor before it");
    }

    #[test]
    fn what_is_fixed_keeps_it_out() {
        let point = Vec3::new(0.0, 0.9, 0.3);
        let wall = (Vec3::new(-2.0, 0.9, 0.0), Vec3::new(2.0, 2.0, 0.02));
        assert!(!comes_to(&[wall], point), "a wall on the counter's edge");
        let bar = (Vec3::new(-2.0, 1.0, 0.0), Vec3::new(2.0, 1.05, 0.6));
        assert!(!comes_to(&[bar], point), "a bar 0.1 m above it");
        let cabinet = (Vec3::new(-2.0, 1.4, 0.25), Vec3::new(2.0, 2.1, 0.6));
        assert!(comes_to(&[cabinet], point), "a wall cabinet leaves room");
        let shelf = (Vec3::new(-2.0, 1.18, 0.0), Vec3::new(2.0, 1.2, 0.6));
        assert!(comes_to(&[shelf], point), "a shelf lets the arm in with its elbow aside");
    }
}
