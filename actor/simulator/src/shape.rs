//! Shapes: unions of parts. Physics makes colliders of them, the depth camera makes triangles.

use rapier3d::math::{Pose3, Vec3};
use std::sync::Arc;

/// A solid about its own origin; convex, except for the last kind.
#[derive(Debug, Clone, PartialEq)]
pub enum Primitive {
    /// An axis-aligned box.
    Cuboid {
        half_extents_m: Vec3,
    },
    /// A cylinder about the y axis.
    Cylinder {
        radius_m: f32,
        half_height_m: f32,
    },
    /// A capsule about the y axis: a segment swept by a sphere.
    Capsule {
        radius_m: f32,
        /// Half of the segment's length, metres (the caps come on top).
        half_height_m: f32,
    },
    Sphere {
        radius_m: f32,
    },
    /// The convex hull of points; at least four, not in one plane.
    Hull {
        points_m: Vec<Vec3>,
    },
    /// A dented mesh of a user's scene, with the convex pieces that physics takes for it.
    Concave(Arc<Concave>),
}

/// A closed mesh that is not convex: seen as it is, touched as convex pieces.
#[derive(Debug, Clone, PartialEq)]
pub struct Concave {
    pub vertices: Vec<Vec3>,
    /// Corners a, b, c of its triangles: (b − a) × (c − a) points outwards.
    pub triangles: Vec<[u32; 3]>,
    /// Convex pieces that together fill it, nearly; none of them concave.
    pub pieces: Vec<Part>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    pub primitive: Primitive,
    pub body_from_part: Pose3,
}

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Shape {
    pub parts: Vec<Part>,
}

impl Shape {
    pub fn of(primitive: Primitive) -> Self {
        Self { parts: vec![Part { primitive, body_from_part: Pose3::identity() }] }
    }

    /// Its parts with the pieces of each concave one in its place: what physics sees.
    pub fn convex_parts(&self) -> Vec<Part> {
        let mut parts = Vec::with_capacity(self.parts.len());
        for part in &self.parts {
            match &part.primitive {
                Primitive::Concave(concave) => parts.extend(concave.pieces.iter().map(|piece| Part {
                    primitive: piece.primitive.clone(),
                    body_from_part: part.body_from_part * piece.body_from_part,
                })),
                _ => parts.push(part.clone()),
            }
        }
        parts
    }

    /// Whether one of its parts is concave.
    pub fn is_dented(&self) -> bool {
        self.parts.iter().any(|part| matches!(part.primitive, Primitive::Concave(_)))
    }

    #[must_use]
    pub fn with(mut self, primitive: Primitive, x_m: f32, y_m: f32, z_m: f32) -> Self {
        self.parts.push(Part { primitive, body_from_part: Pose3::translation(x_m, y_m, z_m) });
        self
    }
}
