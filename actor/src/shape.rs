//! Shapes: unions of convex parts. Physics makes colliders of them, the depth camera makes triangles.

use rapier3d::math::{Pose3, Vec3};

/// A convex solid about its own origin.
#[derive(Debug, Clone, PartialEq)]
pub enum Primitive {
    /// An axis-aligned box.
    Cuboid {
        /// Half of its size along each axis, metres.
        half_extents_m: Vec3,
    },
    /// A cylinder about the y axis.
    Cylinder {
        /// Radius, metres.
        radius_m: f32,
        /// Half of its height, metres.
        half_height_m: f32,
    },
    /// A capsule about the y axis: a segment swept by a sphere.
    Capsule {
        /// Radius, metres.
        radius_m: f32,
        /// Half of the segment's length, metres (the caps come on top).
        half_height_m: f32,
    },
    /// A sphere.
    Sphere {
        /// Radius, metres.
        radius_m: f32,
    },
    /// The convex hull of points; at least four, not in one plane.
    Hull {
        /// Corners, metres.
        points_m: Vec<Vec3>,
    },
}

/// One convex part of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// The solid.
    pub primitive: Primitive,
    /// Where it sits in the body.
    pub body_from_part: Pose3,
}

/// A union of convex parts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Shape {
    /// The parts.
    pub parts: Vec<Part>,
}

impl Shape {
    /// A shape of one part at the body's origin.
    pub fn of(primitive: Primitive) -> Self {
        Self { parts: vec![Part { primitive, body_from_part: Pose3::identity() }] }
    }

    /// Adds a part at a translation.
    #[must_use]
    pub fn with(mut self, primitive: Primitive, x_m: f32, y_m: f32, z_m: f32) -> Self {
        self.parts.push(Part { primitive, body_from_part: Pose3::translation(x_m, y_m, z_m) });
        self
    }

    /// Adds a part at a pose.
    #[must_use]
    pub fn turned(mut self, primitive: Primitive, body_from_part: Pose3) -> Self {
        self.parts.push(Part { primitive, body_from_part });
        self
    }

    /// Adds another shape's parts, moved by this much.
    #[must_use]
    pub fn joined(mut self, other: Self, x_m: f32, y_m: f32, z_m: f32) -> Self {
        self.parts.extend(other.parts.into_iter().map(|mut part| {
            part.body_from_part.translation += Vec3::new(x_m, y_m, z_m);
            part
        }));
        self
    }
}
