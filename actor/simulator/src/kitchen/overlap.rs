//! Things that stand in others, or in fixtures.

use super::body::Body;
use crate::physics::gap::gap_m;
use crate::physics::geometry::Solid;
use rapier3d::geometry::{Aabb, SharedShape};
use rapier3d::math::Pose3;
use rapier3d::parry::bounding_volume::BoundingVolume;
use std::ops::Range;

/// Things may touch this deeply, metres: what the contact solver leaves.
const PENETRATION_MAX_M: f32 = 0.001;

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{one} stands {depth_mm:.1} mm deep in {other}")]
pub struct Overlap {
    pub one: String,
    pub other: String,
    pub depth_mm: f32,
}

/// All overlaps of the `movable` bodies with those before them in the list, fixed ones included.
pub fn overlaps(bodies: &[Body], world_from_bodies: &[Pose3], movable: Range<usize>) -> Vec<Overlap> {
    type Part = (SharedShape, Pose3, Aabb);
    let mut found = Vec::new();
    let placed: Vec<(Aabb, Vec<Part>)> = bodies[..movable.end]
        .iter()
        .zip(world_from_bodies)
        .map(|(body, pose)| {
            let solid = Solid::of(&body.shape);
            let aabb = solid.aabb(pose);
            let parts = solid.parts.into_iter().map(|(shape, body_from_part)| {
                let pose = *pose * body_from_part;
                let aabb = shape.compute_aabb(&pose);
                (shape, pose, aabb)
            });
            (aabb, parts.collect())
        })
        .collect();
    for one in movable {
        let (aabb, parts) = &placed[one];
        for (other, (other_aabb, other_parts)) in placed[..one].iter().enumerate() {
            if !aabb.intersects(other_aabb) {
                continue;
            }
            let mut deepest = 0.0_f32;
            for (shape, pose, aabb) in parts {
                for (other_shape, other_pose, _) in other_parts.iter().filter(|(.., other)| other.intersects(aabb)) {
                    deepest = deepest.max(-gap_m(pose, shape, other_pose, other_shape));
                }
            }
            if deepest > PENETRATION_MAX_M {
                found.push(Overlap {
                    one: bodies[one].name.clone(),
                    other: bodies[other].name.clone(),
                    depth_mm: deepest * 1000.0,
                });
            }
        }
    }
    found
}
