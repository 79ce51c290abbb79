//! What a kitchen is made of before physics sees it: the one form in which every source of kitchens (the generator, a
//! user's scene file) hands over its work.

use super::catalogue::Pattern;
use crate::physics::geometry::Solid;
use crate::shape::Shape;
use rapier3d::geometry::Aabb;
use rapier3d::math::{Pose3, Vec3};

#[derive(Debug, Clone)]
pub struct Fixture {
    /// Category: iTHOR's name, or `Wall`, `Ceiling`.
    pub category: String,
    pub shape: Shape,
    /// `world_from_body`.
    pub pose: Pose3,
}

#[derive(Debug, Clone)]
pub struct Thing {
    /// Category, iTHOR's name where iTHOR has it.
    pub category: String,
    /// Its geometry, origin at the centre of its bounding box.
    pub shape: Shape,
    pub solid: Solid,
    /// Mass, kilograms; at most [`MOVABLE_MASS_MAX_KG`].
    pub mass_kg: f32,
    pub friction: f32,
    /// `world_from_body` at set-down.
    pub pose: Pose3,
}

impl Thing {
    pub(super) fn of(pattern: &Pattern, pose: Pose3) -> Self {
        let Pattern { category, solid } = pattern;
        Self {
            category: category.name.to_owned(),
            shape: category.shape.clone(),
            solid: solid.clone(),
            mass_kg: category.mass_kg,
            friction: category.friction(),
            pose,
        }
    }
}

/// A level rectangle on which things can stand.
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Corner with the smaller x and z; y is the surface, metres.
    pub low: Vec3,
    /// Corner with the larger x and z; y is the lowest thing that may hang above it, metres.
    pub high: Vec3,
}

#[derive(Debug, Clone)]
pub struct Room {
    /// Fixed bodies, in the order they were put in.
    pub fixtures: Vec<Fixture>,
    pub things: Vec<Thing>,
    /// Where targets can stand.
    pub surfaces: Vec<Surface>,
    /// Corners of the floor inside of the walls, metres (y is 0).
    pub floor: (Vec3, Vec3),
}

/// Heavier things do not move, kilograms (`docs/method.md`, Task).
pub(crate) const MOVABLE_MASS_MAX_KG: f32 = 10.0;

impl Surface {
    pub(crate) fn area_m2(&self) -> f32 {
        (self.high.x - self.low.x) * (self.high.z - self.low.z)
    }

    /// Whether this is the same rectangle as another, to a millimetre; what hangs above does not matter.
    pub fn same_as(&self, other: &Self) -> bool {
        const SAME_M: f32 = 1e-3;
        let flat = |v: Vec3| Vec3::new(v.x, 0.0, v.z);
        (self.low - other.low).abs().max_element() < SAME_M
            && (flat(self.high) - flat(other.high)).abs().max_element() < SAME_M
    }

    /// Whether a thing with this bounding box stands wholly on it and below what hangs above.
    pub fn carries(&self, aabb: &Aabb) -> bool {
        const RIM_M: f32 = 0.01;
        aabb.mins.x >= self.low.x + RIM_M
            && aabb.maxs.x <= self.high.x - RIM_M
            && aabb.mins.z >= self.low.z + RIM_M
            && aabb.maxs.z <= self.high.z - RIM_M
            && aabb.maxs.y <= self.high.y - RIM_M
    }
}
