//! Convex solids that stand still, indexed by where on the floor plane they stand.

use crate::physics::geometry::Solid;
use rapier3d::geometry::{Aabb, SharedShape};
use rapier3d::math::Pose3;
use rapier3d::parry::bounding_volume::BoundingVolume;
use rapier3d::parry::query;

const CELL_M: f32 = 0.25;
/// Cells along each axis. They repeat beyond that, which costs time in a room of more than 16 m and nothing else.
const CELLS: usize = 64;

pub struct Obstacles {
    aabbs: Vec<Aabb>,
    parts: Vec<(SharedShape, Pose3)>,
    // For each cell those whose bounding boxes reach into it, ascending.
    cells: Vec<Vec<u32>>,
}

impl Default for Obstacles {
    fn default() -> Self {
        Self { aabbs: Vec::new(), parts: Vec::new(), cells: vec![Vec::new(); CELLS * CELLS] }
    }
}

/// The first and the last cell that an interval reaches into; not more than there are.
fn cells(low_m: f32, high_m: f32) -> impl Iterator<Item = usize> + Clone {
    let cell = |at_m: f32| libm::floorf(at_m / CELL_M) as i32;
    let (first, last) = (cell(low_m), cell(high_m));
    (first..=last.min(first + CELLS as i32 - 1)).map(|cell| cell.rem_euclid(CELLS as i32) as usize)
}

impl Obstacles {
    pub fn add(&mut self, solid: &Solid, world_from_body: &Pose3) {
        for (shape, body_from_part) in &solid.parts {
            let pose = *world_from_body * *body_from_part;
            let aabb = shape.compute_aabb(&pose);
            for row in cells(aabb.mins.z, aabb.maxs.z) {
                for column in cells(aabb.mins.x, aabb.maxs.x) {
                    self.cells[row * CELLS + column].push(self.aabbs.len() as u32);
                }
            }
            self.aabbs.push(aabb);
            self.parts.push((shape.clone(), pose));
        }
    }

    /// Whether a convex solid keeps `margin_m` to all of them that rise above `above_m`; a negative margin is a depth
    /// that it may enter.
    pub fn clear_of(&self, shape: &SharedShape, pose: &Pose3, margin_m: f32, above_m: f32) -> bool {
        if self.aabbs.is_empty() {
            return true;
        }
        let reach = shape.compute_aabb(pose).loosened(margin_m.max(0.0));
        let columns = cells(reach.mins.x, reach.maxs.x);
        cells(reach.mins.z, reach.maxs.z).all(|row| {
            columns.clone().all(|column| {
                self.cells[row * CELLS + column].iter().all(|&index| {
                    let aabb = &self.aabbs[index as usize];
                    if !aabb.intersects(&reach) || aabb.maxs.y <= above_m {
                        return true;
                    }
                    let (other, other_pose) = &self.parts[index as usize];
                    match query::contact(pose, &**shape, other_pose, &**other, margin_m.max(0.0)) {
                        Ok(Some(contact)) => contact.dist >= margin_m,
                        Ok(None) => true,
                        // Parry has an algorithm for every pair of convex solids; were there none, it would count as
                        // a hit.
                        Err(_) => false,
                    }
                })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{Primitive, Shape};
    use proptest::prelude::*;
    use rapier3d::math::Vec3;

    proptest! {
        #[test]
        fn spheres_are_clear_of_spheres_exactly_when_their_centres_say_so(
            spheres in proptest::collection::vec((-12.0f32..12.0, 0.0f32..2.0, -12.0f32..12.0, 0.05f32..1.5), 0..40),
            x in -12.0f32..12.0, y in 0.0f32..2.0, z in -12.0f32..12.0, margin_m in -0.02f32..0.3,
        ) {
            const RADIUS_M: f32 = 0.4;
            let sphere = |radius_m| Solid::of(&Shape::of(Primitive::Sphere { radius_m }));
            let mut obstacles = Obstacles::default();
            for &(x, y, z, radius_m) in &spheres {
                obstacles.add(&sphere(radius_m), &Pose3::translation(x, y, z));
            }
            let at = Vec3::new(x, y, z);
            let gaps_m = spheres.iter().map(|&(x, y, z, radius_m)| (Vec3::new(x, y, z) - at).length() - radius_m - RADIUS_M);
            let least_m = gaps_m.fold(f32::INFINITY, f32::min);
            prop_assume!((least_m - margin_m).abs() > 1e-4);
            let (shape, _) = &sphere(RADIUS_M).parts[0];
            prop_assert_eq!(obstacles.clear_of(shape, &Pose3::from_translation(at), margin_m, -10.0), least_m > margin_m);
        }
    }
}
