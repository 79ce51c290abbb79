//! The fixed scene: what never moves, for one question: does this solid stand in it?
//!
//! Kinematic bodies pass through fixed ones in rapier, so the robot asks here before it moves.

use super::gap::gap_m;
use super::geometry::Solid;
use rapier3d::geometry::{Aabb, SharedShape};
use rapier3d::math::Pose3;
use rapier3d::parry::bounding_volume::BoundingVolume;

/// All convex parts of all fixed bodies.
#[derive(Clone, Default)]
pub struct FixedScene {
    aabbs: Vec<Aabb>,
    parts: Vec<(SharedShape, Pose3)>,
}

impl std::fmt::Debug for FixedScene {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "FixedScene({} parts)", self.parts.len())
    }
}

impl FixedScene {
    pub fn add(&mut self, solid: &Solid, world_from_body: &Pose3) {
        for (shape, body_from_part) in &solid.parts {
            let pose = *world_from_body * *body_from_part;
            self.aabbs.push(shape.compute_aabb(&pose));
            self.parts.push((shape.clone(), pose));
        }
    }

    pub fn aabbs(&self) -> &[Aabb] {
        &self.aabbs
    }

    /// Whether any part's bounding box meets this one.
    pub fn meets_aabb(&self, aabb: &Aabb) -> bool {
        self.aabbs.iter().any(|other| other.intersects(aabb))
    }

    /// Indices of the parts whose bounding box meets this one, ascending.
    pub fn candidates(&self, aabb: &Aabb, out: &mut Vec<u32>) {
        out.clear();
        out.extend((0..self.aabbs.len() as u32).filter(|&index| self.aabbs[index as usize].intersects(aabb)));
    }

    pub fn part(&self, index: u32) -> (&Aabb, &SharedShape, &Pose3) {
        let (shape, pose) = &self.parts[index as usize];
        (&self.aabbs[index as usize], shape, pose)
    }

    /// Depth to which the solid penetrates the scene, metres; 0 if it touches nothing.
    pub fn deepest_penetration_m(&self, solid: &Solid, world_from_body: &Pose3) -> f32 {
        let mut deepest = 0.0_f32;
        for (shape, body_from_part) in &solid.parts {
            let pose = *world_from_body * *body_from_part;
            let aabb = shape.compute_aabb(&pose);
            for (other_aabb, (other, other_pose)) in self.aabbs.iter().zip(&self.parts) {
                if other_aabb.intersects(&aabb) {
                    deepest = deepest.max(-gap_m(&pose, shape, other_pose, other));
                }
            }
        }
        deepest
    }
}
