//! A wall's coordinates, and fixtures put together in them.
//!
//! `along` runs beside the wall, `up` is up, `out` leads into the room. All frames are parallel to the world's axes;
//! some are mirrored, which is why parts are symmetric: boxes, cylinders and capsules along an axis.

use crate::kitchen::room::Fixture;
use crate::physics::geometry::{rotation_x, rotation_z};
use crate::shape::{Part, Primitive, Shape};
use rapier3d::math::{Pose3, Rot3, Vec3};
use std::f32::consts::FRAC_PI_2;

/// From and to, metres.
pub(super) type Span = [f32; 2];

#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    /// Where along, up and out are 0.
    pub origin: Vec3,
    /// Unit vector beside the wall.
    pub along: Vec3,
    /// Unit vector into the room.
    pub out: Vec3,
}

/// A fixed body that grows part by part.
#[derive(Debug, Clone)]
pub(super) struct Assembly {
    frame: Frame,
    parts: Vec<(Primitive, Pose3)>,
    low: Vec3,
    high: Vec3,
}

impl Frame {
    /// The world position of a point in the wall's coordinates.
    pub fn at(self, along: f32, up: f32, out: f32) -> Vec3 {
        self.origin + along * self.along + out * self.out + Vec3::new(0.0, up, 0.0)
    }

    /// World corners of a box in the wall's coordinates.
    pub fn block(self, along: Span, up: Span, out: Span) -> (Vec3, Vec3) {
        let (a, b) = (self.at(along[0], up[0], out[0]), self.at(along[1], up[1], out[1]));
        (a.min(b), a.max(b))
    }

    /// The same directions from another origin.
    pub fn shifted(self, along: f32, out: f32) -> Self {
        Self { origin: self.at(along, 0.0, out), ..self }
    }
}

impl Assembly {
    pub fn new(frame: Frame) -> Self {
        Self { frame, parts: Vec::new(), low: Vec3::splat(f32::INFINITY), high: Vec3::splat(f32::NEG_INFINITY) }
    }

    #[must_use]
    pub fn slab(self, along: Span, up: Span, out: Span) -> Self {
        let (low, high) = self.frame.block(along, up, out);
        self.block(low, high)
    }

    /// Adds a box given by its world corners.
    #[must_use]
    pub fn block(mut self, low: Vec3, high: Vec3) -> Self {
        let primitive = Primitive::Cuboid { half_extents_m: 0.5 * (high - low) };
        self.add(primitive, 0.5 * (low + high), Rot3::IDENTITY, 0.5 * (high - low));
        self
    }

    /// Adds a rod with round ends between two points (along, up, out) that differ in one of them.
    #[must_use]
    pub fn rod(mut self, from: [f32; 3], to: [f32; 3], radius_m: f32) -> Self {
        let (middle, half, rotation) = self.axis(from, to);
        let primitive = Primitive::Capsule { radius_m, half_height_m: half.length() };
        self.add(primitive, middle, rotation, half.abs() + Vec3::splat(radius_m));
        self
    }

    /// Adds a cylinder between two points (along, up, out) that differ in one of them.
    #[must_use]
    pub fn drum(mut self, from: [f32; 3], to: [f32; 3], radius_m: f32) -> Self {
        let (middle, half, rotation) = self.axis(from, to);
        let length = half.length();
        let across = Vec3::splat(radius_m) * (Vec3::ONE - half.abs() / length);
        let primitive = Primitive::Cylinder { radius_m, half_height_m: length };
        self.add(primitive, middle, rotation, half.abs() + across);
        self
    }

    #[must_use]
    pub fn join(mut self, other: Self) -> Self {
        self.parts.extend(other.parts);
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
        self
    }

    /// The body, its origin at the centre of its bounding box.
    pub fn fixture(self, category: &str) -> Fixture {
        let centre = 0.5 * (self.low + self.high);
        let parts = self
            .parts
            .into_iter()
            .map(|(primitive, mut pose)| {
                pose.translation -= centre;
                Part { primitive, body_from_part: pose }
            })
            .collect();
        Fixture { category: category.to_owned(), shape: Shape { parts }, pose: Pose3::from_translation(centre) }
    }

    /// Middle and half of the way between two points, and the rotation that lays the y axis along it.
    fn axis(&self, from: [f32; 3], to: [f32; 3]) -> (Vec3, Vec3, Rot3) {
        let (a, b) = (self.frame.at(from[0], from[1], from[2]), self.frame.at(to[0], to[1], to[2]));
        let half = 0.5 * (b - a);
        let rotation = if half.x.abs() > 0.0 {
            rotation_z(FRAC_PI_2)
        } else if half.z.abs() > 0.0 {
            rotation_x(FRAC_PI_2)
        } else {
            Rot3::IDENTITY
        };
        (0.5 * (a + b), half, rotation)
    }

    fn add(&mut self, primitive: Primitive, middle: Vec3, rotation: Rot3, half: Vec3) {
        self.low = self.low.min(middle - half);
        self.high = self.high.max(middle + half);
        self.parts.push((primitive, Pose3::from_parts(middle, rotation)));
    }
}
