//! The forms that things are made of.

use crate::physics::geometry::{rotation_x, rotation_y, rotation_z};
use crate::shape::{Part, Primitive, Shape};
use rapier3d::math::{Pose3, Rot3, Vec3};
use serde::Deserialize;
use std::f32::consts::PI;

/// Corners of a turned body's rings.
const SIDES: u32 = 16;

/// A part of a thing, as a table has it.
#[derive(Debug, Deserialize)]
pub struct Piece {
    #[serde(flatten)]
    form: Form,
    /// Where its origin is, metres; the thing stands on y = 0.
    #[serde(default)]
    at: [f32; 3],
    turn: Option<Turn>,
}

/// Lengths in metres, about the form's origin.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Form {
    /// Its size along x, y, z.
    Box([f32; 3]),
    /// Radius and height, about y.
    Cylinder([f32; 2]),
    /// Radius and whole length, about y.
    Capsule([f32; 2]),
    /// Its radius.
    Ball(f32),
    /// The convex hull of rings (radius, height) about the y axis, stretched along x.
    Spun {
        rings: Vec<[f32; 2]>,
        #[serde(default = "unstretched")]
        stretch: f32,
    },
    /// The convex hull of a polygon in the x-y plane, drawn out along z about z = 0.
    Prism { profile: Vec<[f32; 2]>, depth_m: f32 },
    /// The wall of an open round vessel, of convex segments: from the middle of its floor upwards.
    Wall { low_m: f32, high_m: f32, floor_m: f32, height_m: f32, wall_m: f32, segments: u32 },
    /// The convex hull of points.
    Hull(Vec<[f32; 3]>),
}

fn unstretched() -> f32 {
    1.0
}

/// Angles about an axis, radians.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Turn {
    X(f32),
    Y(f32),
    Z(f32),
    /// Something along y lies flat, turned away from x by this angle about y.
    Lying(f32),
}

impl Turn {
    fn rotation(self) -> Rot3 {
        match self {
            Self::X(angle_rad) => rotation_x(angle_rad),
            Self::Y(angle_rad) => rotation_y(angle_rad),
            Self::Z(angle_rad) => rotation_z(angle_rad),
            Self::Lying(angle_rad) => rotation_y(-angle_rad) * rotation_z(0.5 * PI),
        }
    }
}

impl Form {
    fn primitives(&self) -> Vec<Primitive> {
        let one = match *self {
            Self::Box(size_m) => Primitive::Cuboid { half_extents_m: 0.5 * Vec3::from(size_m) },
            Self::Cylinder([radius_m, height_m]) => Primitive::Cylinder { radius_m, half_height_m: 0.5 * height_m },
            Self::Capsule([radius_m, length_m]) => {
                Primitive::Capsule { radius_m, half_height_m: 0.5 * length_m - radius_m }
            }
            Self::Ball(radius_m) => Primitive::Sphere { radius_m },
            Self::Spun { ref rings, stretch } => {
                let ring = |&[radius_m, y_m]: &[f32; 2]| {
                    (0..SIDES).map(move |side| corner(radius_m, y_m, [side, SIDES], stretch))
                };
                Primitive::Hull { points_m: rings.iter().flat_map(ring).collect() }
            }
            Self::Prism { ref profile, depth_m } => {
                let edge = |&[x, y]: &[f32; 2]| [-0.5, 0.5].map(|side| Vec3::new(x, y, side * depth_m));
                Primitive::Hull { points_m: profile.iter().flat_map(edge).collect() }
            }
            Self::Wall { low_m, high_m, floor_m, height_m, wall_m, segments } => {
                let edge = |side: u32| {
                    [(low_m, 0.5 * floor_m), (high_m, height_m)].into_iter().flat_map(move |(radius_m, y_m)| {
                        [radius_m, radius_m - wall_m].map(|radius_m| corner(radius_m, y_m, [side, segments], 1.0))
                    })
                };
                let segment = |side| Primitive::Hull { points_m: edge(side).chain(edge(side + 1)).collect() };
                return (0..segments).map(segment).collect();
            }
            Self::Hull(ref points_m) => {
                Primitive::Hull { points_m: points_m.iter().copied().map(Vec3::from).collect() }
            }
        };
        vec![one]
    }
}

fn corner(radius_m: f32, y_m: f32, [side, sides]: [u32; 2], stretch_x: f32) -> Vec3 {
    let (sin, cos) = libm::sincosf(2.0 * PI * side as f32 / sides as f32);
    Vec3::new(stretch_x * radius_m * cos, y_m, radius_m * sin)
}

pub fn shape_of(pieces: &[Piece]) -> Shape {
    let parts = pieces.iter().flat_map(|Piece { form, at, turn }| {
        let body_from_part = Pose3::from_parts(Vec3::from(*at), turn.map_or(Rot3::IDENTITY, Turn::rotation));
        form.primitives().into_iter().map(move |primitive| Part { primitive, body_from_part })
    });
    Shape { parts: parts.collect() }
}
