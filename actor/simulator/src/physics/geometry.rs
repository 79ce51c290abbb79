use crate::shape::{Primitive, Shape};
use rapier3d::dynamics::MassProperties;
use rapier3d::geometry::{Aabb, SharedShape};
use rapier3d::math::{Pose3, Rot3, Vec3};
use rapier3d::parry::bounding_volume::BoundingVolume;
use rapier3d::parry::query;

/// Length of a vector, to the same bit as `Vec3::length`. That takes the square root of `libm`, an instruction without
/// AVX: between AVX code it waits for registers that it does not use, and was a fifth of a step.
pub fn length(vector: Vec3) -> f32 {
    f32::sqrt(vector.length_squared())
}

/// A shape as collision geometry: convex parts with their poses in the body.
#[derive(Clone)]
pub struct Solid {
    /// Convex parts and `body_from_part`.
    pub parts: Vec<(SharedShape, Pose3)>,
    /// Of each part at density 1, where that is not the part's own: the first piece of a concave mesh weighs as much as
    /// the whole mesh, and about the same point; its other pieces weigh nothing.
    given_masses: Vec<Option<MassProperties>>,
    radius_m: f32,
    aabb: Aabb,
}

impl std::fmt::Debug for Solid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Solid({} parts)", self.parts.len())
    }
}

impl Solid {
    pub fn of(shape: &Shape) -> Self {
        let mut parts: Vec<(SharedShape, Pose3)> = Vec::with_capacity(shape.parts.len());
        let mut given_masses = Vec::with_capacity(shape.parts.len());
        for part in &shape.parts {
            let Primitive::Concave(concave) = &part.primitive else {
                parts.push((convex(&part.primitive), part.body_from_part));
                given_masses.push(None);
                continue;
            };
            let mut mass = MassProperties::from_trimesh(1.0, &concave.vertices, &concave.triangles);
            for piece in &concave.pieces {
                parts.push((convex(&piece.primitive), part.body_from_part * piece.body_from_part));
                given_masses.push(Some(mass.transform_by(&piece.body_from_part.inverse())));
                mass = MassProperties::default();
            }
        }
        let radius_m = parts
            .iter()
            .map(|(shape, body_from_part)| {
                let sphere = shape.compute_bounding_sphere(body_from_part);
                sphere.center.length() + sphere.radius
            })
            .fold(0.0, f32::max);
        let mut solid = Self { parts, given_masses, radius_m, aabb: Aabb::new_invalid() };
        solid.aabb = solid.aabb(&Pose3::identity());
        solid
    }

    /// No point of it is further from the origin, metres.
    pub fn radius_m(&self) -> f32 {
        self.radius_m
    }

    /// Bounding box in the world. An empty solid gives an inverted box, which intersects nothing.
    pub fn aabb(&self, world_from_body: &Pose3) -> Aabb {
        let mut aabb = Aabb::new_invalid();
        for (shape, body_from_part) in &self.parts {
            aabb.merge(&shape.compute_aabb(&(*world_from_body * *body_from_part)));
        }
        aabb
    }

    /// A box in the world that contains that of [`aabb`](Self::aabb), but for rounding: larger, and cheaper.
    pub(crate) fn loose_aabb(&self, world_from_body: &Pose3) -> Aabb {
        self.aabb.transform_by(world_from_body)
    }

    /// Volume of the parts, cubic metres, in their order.
    pub(crate) fn volumes_m3(&self) -> Vec<f32> {
        let own = |shape: &SharedShape| shape.mass_properties(1.0).mass();
        let parts = self.parts.iter().zip(&self.given_masses);
        parts.map(|((shape, _), given)| given.as_ref().map_or_else(|| own(shape), MassProperties::mass)).collect()
    }

    /// What a part weighs at density 1 and how that is spread, in the part's frame; none if it is solid itself.
    pub(crate) fn given_mass(&self, part: usize) -> Option<MassProperties> {
        self.given_masses[part]
    }

    /// Whether another solid comes nearer than this.
    pub(crate) fn nearer_than(&self, pose: &Pose3, other: &Self, other_pose: &Pose3, distance_m: f32) -> bool {
        self.parts.iter().any(|(shape, body_from_part)| {
            let pose = *pose * *body_from_part;
            other.parts.iter().any(|(other_shape, other_from_part)| {
                let other_pose = *other_pose * *other_from_part;
                // A pair without an algorithm does not occur among convex solids; it would count as too near.
                query::distance(&pose, &**shape, &other_pose, &**other_shape)
                    .map_or(true, |gap| gap.distance < distance_m)
            })
        })
    }

    /// Distance from a point to the nearest part, metres; 0 inside.
    pub fn distance_to_point_m(&self, world_from_body: &Pose3, point: Vec3) -> f32 {
        self.parts
            .iter()
            .map(|(shape, body_from_part)| shape.distance_to_point(&(*world_from_body * *body_from_part), point, true))
            .fold(f32::INFINITY, f32::min)
    }
}

fn convex(primitive: &Primitive) -> SharedShape {
    match primitive {
        Primitive::Cuboid { half_extents_m } => {
            SharedShape::cuboid(half_extents_m.x, half_extents_m.y, half_extents_m.z)
        }
        Primitive::Cylinder { radius_m, half_height_m } => SharedShape::cylinder(*half_height_m, *radius_m),
        Primitive::Capsule { radius_m, half_height_m } => SharedShape::capsule_y(*half_height_m, *radius_m),
        Primitive::Sphere { radius_m } => SharedShape::ball(*radius_m),
        Primitive::Hull { points_m } => SharedShape::convex_hull(points_m)
            .expect("a hull holds at least four points that do not lie in one plane, as its documentation asks"),
        Primitive::Concave(_) => unreachable!("physics takes its pieces, none of which is concave"),
    }
}

/// Moves a shape's parts so that the centre of its bounding box is its origin.
#[must_use]
pub(crate) fn centred(mut shape: Shape) -> Shape {
    let centre = Solid::of(&shape).aabb(&Pose3::identity()).center();
    for part in &mut shape.parts {
        part.body_from_part.translation -= centre;
    }
    shape
}

/// Rotation about the x axis (pitch: positive looks down), the same bits on every machine.
pub fn rotation_x(angle_rad: f32) -> Rot3 {
    let (sin, cos) = libm::sincosf(0.5 * angle_rad);
    Rot3::from_xyzw(sin, 0.0, 0.0, cos)
}

/// Rotation about the y axis (yaw: positive turns right), the same bits on every machine.
pub fn rotation_y(angle_rad: f32) -> Rot3 {
    let (sin, cos) = libm::sincosf(0.5 * angle_rad);
    Rot3::from_xyzw(0.0, sin, 0.0, cos)
}

/// Rotation about the z axis, the same bits on every machine.
pub(crate) fn rotation_z(angle_rad: f32) -> Rot3 {
    let (sin, cos) = libm::sincosf(0.5 * angle_rad);
    Rot3::from_xyzw(0.0, 0.0, sin, cos)
}
