//! The way of one rigid body, pose by pose, and the question where on it the body first comes near something.
//!
//! Most poses need no test: nothing can be nearer than it was, less what the body has travelled since (conservative
//! advancement, here over the poses there are, not in between).

use super::gap::gap_m;
use super::geometry::{Solid, length};
use rapier3d::geometry::{Aabb, SharedShape};
use rapier3d::math::Pose3;
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::ops::Range;

/// Added to each pose's travel, metres: more than rounding can take away, so that a test is never left out by it.
const ROUNDING_M: f32 = 1e-5;
/// Share of a measured distance that is surely there: the search for it on curved surfaces ends early.
const SURE_SHARE: f32 = 0.9;

#[derive(Debug, Clone)]
pub struct Sweep {
    poses: Vec<Pose3>,
    /// How far any point of the body can have come since the first pose, metres.
    travel_m: Vec<f32>,
    aabb: Aabb,
}

impl Default for Sweep {
    fn default() -> Self {
        Self { poses: Vec::new(), travel_m: Vec::new(), aabb: Aabb::new_invalid() }
    }
}

impl Sweep {
    pub fn record(&mut self, solid: &Solid, poses: impl Iterator<Item = Pose3>) {
        self.poses.clear();
        self.travel_m.clear();
        self.aabb = Aabb::new_invalid();
        let mut travel_m = 0.0;
        for pose in poses {
            if let Some(last) = self.poses.last() {
                travel_m += ROUNDING_M + furthest_travel_m(last, &pose, solid.radius_m());
            }
            self.aabb.merge(&solid.loose_aabb(&pose).loosened(ROUNDING_M));
            self.travel_m.push(travel_m);
            self.poses.push(pose);
        }
    }

    /// Box about the body in all poses.
    pub fn aabb(&self) -> &Aabb {
        &self.aabb
    }

    /// First index in `range` at which the body comes nearer than `distance_m` (negative: overlaps by more than that)
    /// to a convex solid; none if it does nowhere. `body` is what was recorded.
    pub fn first_nearer(
        &self,
        body: &Solid,
        range: Range<usize>,
        other: &SharedShape,
        other_pose: &Pose3,
        distance_m: f32,
    ) -> Option<usize> {
        let mut end = range.end;
        for (shape, body_from_part) in &body.parts {
            let mut index = range.start;
            while index < end {
                let room_m = gap_m(&(self.poses[index] * *body_from_part), shape, other_pose, other) - distance_m;
                if room_m < 0.0 {
                    end = index;
                    break;
                }
                let reach_m = self.travel_m[index] + SURE_SHARE * room_m;
                index += 1;
                while index < end && self.travel_m[index] < reach_m {
                    index += 1;
                }
            }
        }
        (end < range.end).then_some(end)
    }
}

/// No point within `radius_m` of a body's origin is further from where it was than this, metres.
fn furthest_travel_m(from: &Pose3, to: &Pose3, radius_m: f32) -> f32 {
    let turn = to.rotation * from.rotation.inverse();
    // A turn by an angle moves a point by twice its distance from the axis times the sine of half of the angle.
    let half_sine = f32::sqrt(turn.x * turn.x + turn.y * turn.y + turn.z * turn.z);
    length(to.translation - from.translation) + 2.0 * half_sine * radius_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::geometry::{rotation_x, rotation_y};
    use crate::shape::{Primitive, Shape};
    use proptest::prelude::*;
    use rapier3d::math::Vec3;

    proptest! {
        /// Against testing each pose.
        #[test]
        fn leaves_out_no_pose_that_matters(
            start in (-0.5f32..0.5, -0.5f32..0.5, -0.5f32..0.5), step in (-0.03f32..0.03, -0.03f32..0.03, -0.03f32..0.03),
            turn in -0.1f32..0.1, tip in -0.1f32..0.1, half in (0.02f32..0.3, 0.02f32..0.3, 0.02f32..0.3),
            distance_m in -0.005f32..0.02, link in any::<bool>(), from in 0usize..12,
        ) {
            let primitive = if link {
                Primitive::Capsule { radius_m: 0.03, half_height_m: 0.15 }
            } else {
                Primitive::Cylinder { radius_m: 0.04, half_height_m: 0.05 }
            };
            let solid = Solid::of(&Shape::of(primitive).with(Primitive::Sphere { radius_m: 0.02 }, 0.1, 0.0, 0.0));
            let poses: Vec<Pose3> = (0..24u8)
                .map(f32::from)
                .map(|k| {
                    let place = Vec3::from(start) + Vec3::from(step) * k;
                    Pose3::from_parts(place, rotation_y(turn * k) * rotation_x(tip * k))
                })
                .collect();
            let mut sweep = Sweep::default();
            sweep.record(&solid, poses.iter().copied());
            let other = SharedShape::cuboid(half.0, half.1, half.2);
            let other_pose = Pose3::identity();
            let expected = (from..24).find(|&k| {
                solid.parts.iter().any(|(shape, part)| gap_m(&(poses[k] * *part), shape, &other_pose, &other) < distance_m)
            });
            prop_assert_eq!(sweep.first_nearer(&solid, from..24, &other, &other_pose, distance_m), expected);
            for pose in &poses {
                prop_assert!(sweep.aabb().contains(&solid.aabb(pose)));
            }
        }
    }
}
