//! Which solid a mesh is: what it says it is, a box, a cylinder, its hull, or convex pieces of it.
//!
//! Boxes and cylinders rest on their faces without rocking and cost physics less than hulls, so they are looked for.

use super::decompose::{TRIANGLES_MOST, closed, concave};
use super::document::Piece;
use super::mirror;
use crate::kitchen::scene_file::Convex;
use crate::physics::geometry::{Solid, rotation_x, rotation_z};
use crate::shape::{Part, Primitive, Shape};
use rapier3d::math::{Pose3, Rot3, Vec3};
use rapier3d::parry::transformation::try_convex_hull;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::f32::consts::FRAC_PI_2;
use std::sync::Arc;

/// A vertex lies on a solid if it is this near to its surface, as a share of the mesh's size.
const ON_SURFACE: f32 = 1e-3;
/// A mesh is a round solid if it fills this share of it: nine sides do, eight do not.
const FILLED: f32 = 0.9;
/// A mesh counts as convex if it is dented by no more than this, metres, ...
const DENT_M: f32 = 0.002;
/// ... or this share of its size.
const DENT_SHARE: f32 = 0.02;
/// Thinner than this is flat, metres.
const FLAT_M: f32 = 2e-4;
/// Corners of a hull at most: each costs time at every contact.
const CORNERS_MOST: usize = 512;

/// Why a mesh is no solid.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoSolid {
    /// It has no thickness.
    #[error("is flat: give it thickness")]
    Flat,
    /// It is far from convex.
    #[error(
        "is not convex (dented by {dent_mm:.0} mm): split it into convex meshes, or say `convex = \"decompose\"` to have it \
         cut into convex pieces, or `convex = \"hull\"` to take its hull instead"
    )]
    Dented {
        /// How deep, millimetres.
        dent_mm: f32,
    },
    /// Its hull has too many corners.
    #[error("has {corners} corners on its hull, more than {CORNERS_MOST}: simplify it")]
    TooDetailed {
        /// How many.
        corners: usize,
    },
    /// It has no inside that could be cut into pieces.
    #[error(
        "has {edges} edges without a face on either side, or between faces that do not both look outwards, so that it \
         has no inside to decompose: fill its holes and recalculate its normals, or say `convex = \"hull\"`"
    )]
    Open {
        /// How many edges.
        edges: usize,
    },
    /// It has too many triangles to be decomposed.
    #[error("has {triangles} triangles, more than the {TRIANGLES_MOST} that can be decomposed: simplify it")]
    TooManyTriangles {
        /// How many.
        triangles: usize,
    },
}

/// The solid that a mesh is; `dented` says what to do with one that is not convex.
pub fn part_of(piece: &Piece, dented: Option<Convex>) -> Result<Part, NoSolid> {
    let points = distinct(&piece.vertices);
    let (low, high) = bounds(&points);
    if points.len() < 4 || (high - low).min_element() < FLAT_M {
        return Err(NoSolid::Flat);
    }
    let (hull, _) = try_convex_hull(&points).map_err(|_| NoSolid::Flat)?;
    let volume = |primitive: &Primitive| Solid::of(&Shape::of(primitive.clone())).volumes_m3()[0];
    let filled = volume(&Primitive::Hull { points_m: hull.clone() });
    let size = (high - low).length();
    let is = |part: &Part| {
        let on_surface = |point: &Vec3| off_surface_m(part, *point).abs() <= ON_SURFACE * size;
        points.iter().all(on_surface) && filled >= FILLED * volume(&part.primitive)
    };
    let stated = piece.extras.as_deref().and_then(stated);
    if let Some(part) = stated.into_iter().chain([cuboid(low, high)]).chain(cylinders(&points, low, high)).find(is) {
        return Ok(part);
    }
    let dent_m = dent_m(piece);
    if dent_m > DENT_M.max(DENT_SHARE * size) {
        match dented {
            None => return Err(NoSolid::Dented { dent_mm: 1000.0 * dent_m }),
            Some(Convex::Hull) => {}
            Some(Convex::Decompose) => {
                let primitive = Primitive::Concave(Arc::new(concave(closed(piece)?)?));
                return Ok(Part { primitive, body_from_part: Pose3::identity() });
            }
        }
    }
    if hull.len() > CORNERS_MOST {
        return Err(NoSolid::TooDetailed { corners: hull.len() });
    }
    Ok(Part { primitive: Primitive::Hull { points_m: hull }, body_from_part: Pose3::identity() })
}

/// Each place once, in order: programs write the seam of a round thing twice, a rounding apart.
fn distinct(vertices: &[Vec3]) -> Vec<Vec3> {
    const GRID_PER_M: f32 = 1e5;
    let mut seen = BTreeSet::new();
    let cell = |vertex: &Vec3| vertex.to_array().map(|v| libm::roundf(v * GRID_PER_M) as i32);
    vertices.iter().copied().filter(|vertex| seen.insert(cell(vertex))).collect()
}

fn bounds(points: &[Vec3]) -> (Vec3, Vec3) {
    let begin = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
    points.iter().fold(begin, |(low, high), &point| (low.min(point), high.max(point)))
}

/// What `extras` can say of a primitive, in the file's axes.
#[derive(Debug, Deserialize)]
struct Statement {
    solid: String,
    radius_m: Option<f32>,
    half_height_m: Option<f32>,
    half_extents_m: Option<[f32; 3]>,
    translation: [f32; 3],
    rotation: [f32; 4],
}

/// The solid that extras speak of; none if they speak of something else.
fn stated(extras: &str) -> Option<Part> {
    let said: Statement = serde_json::from_str(extras).ok()?;
    let positive = |value: Option<f32>| value.filter(|value| value.is_finite() && *value > 0.0);
    let radius_m = positive(said.radius_m);
    let half_height_m = positive(said.half_height_m);
    let primitive = match said.solid.as_str() {
        "cylinder" => Primitive::Cylinder { radius_m: radius_m?, half_height_m: half_height_m? },
        "capsule" => Primitive::Capsule { radius_m: radius_m?, half_height_m: half_height_m? },
        "sphere" => Primitive::Sphere { radius_m: radius_m? },
        "box" => {
            let half_extents_m = Vec3::from(said.half_extents_m?);
            (half_extents_m.is_finite() && half_extents_m.min_element() > 0.0).then_some(())?;
            Primitive::Cuboid { half_extents_m }
        }
        _ => return None,
    };
    let rotation = Rot3::from_array(said.rotation);
    let pose = Pose3::from_parts(Vec3::from(said.translation), rotation);
    (pose.is_finite() && (rotation.length() - 1.0).abs() < 1e-3)
        .then(|| Part { primitive, body_from_part: mirror::pose(pose) })
}

/// The box between two corners.
fn cuboid(low: Vec3, high: Vec3) -> Part {
    let primitive = Primitive::Cuboid { half_extents_m: 0.5 * (high - low) };
    Part { primitive, body_from_part: Pose3::from_translation(0.5 * (low + high)) }
}

/// Cylinders about each axis that reach as far as the points do.
fn cylinders(points: &[Vec3], low: Vec3, high: Vec3) -> impl Iterator<Item = Part> {
    let middle = points.iter().fold(Vec3::ZERO, |sum, &point| sum + point) / points.len() as f32;
    let from_y = [rotation_z(-FRAC_PI_2), Rot3::IDENTITY, rotation_x(FRAC_PI_2)];
    (0..3).map(move |axis| {
        let along = Vec3::AXES[axis];
        let half_height_m = 0.5 * (high - low).dot(along);
        let centre = middle + along * (0.5 * (low + high) - middle).dot(along);
        let radius_m = points.iter().map(|&p| (p - centre).reject_from(along).length()).fold(0.0, f32::max);
        let primitive = Primitive::Cylinder { radius_m, half_height_m };
        Part { primitive, body_from_part: Pose3::from_parts(centre, from_y[axis]) }
    })
}

/// How far a point lies outside of a solid's surface, metres; for corners, along the nearest face.
fn off_surface_m(part: &Part, point: Vec3) -> f32 {
    let p = part.body_from_part.inverse_transform_point(point);
    let flat = Vec3::new(p.x, 0.0, p.z).length();
    match part.primitive {
        // A vertex of a box is one of its corners.
        Primitive::Cuboid { half_extents_m } => (p.abs() - half_extents_m).abs().max_element(),
        // Vertices lie on a rim or are an end's middle.
        Primitive::Cylinder { radius_m, half_height_m } => {
            let radial = (flat - radius_m).abs().min(flat);
            radial.max((p.y.abs() - half_height_m).abs())
        }
        Primitive::Capsule { radius_m, half_height_m } => {
            (p - Vec3::new(0.0, p.y.clamp(-half_height_m, half_height_m), 0.0)).length() - radius_m
        }
        Primitive::Sphere { radius_m } => p.length() - radius_m,
        Primitive::Hull { .. } | Primitive::Concave(_) => f32::INFINITY,
    }
}

/// How deep the mesh is dented, metres: of a convex one, all vertices lie on one side of each triangle.
fn dent_m(piece: &Piece) -> f32 {
    const SLIVER_M2: f32 = 1e-8;
    let mut deepest = 0.0_f32;
    for corners in &piece.triangles {
        let [a, b, c] = corners.map(|corner| piece.vertices[corner as usize]);
        let area = (b - a).cross(c - a);
        if area.length() < SLIVER_M2 {
            continue;
        }
        let normal = area.normalize();
        let heights = piece.vertices.iter().map(|&vertex| normal.dot(vertex - a));
        let (below, above) =
            heights.fold((0.0_f32, 0.0_f32), |(low, high), height| (low.min(height), high.max(height)));
        deepest = deepest.max(above.min(-below));
    }
    deepest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::triangles_of;

    fn piece(shape: &Shape) -> Piece {
        let triangles = triangles_of(shape);
        let vertices: Vec<Vec3> = triangles.iter().flatten().map(|&corner| Vec3::from(corner)).collect();
        let triangles = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Piece { vertices, triangles, extras: None }
    }

    #[test]
    fn boxes_and_cylinders_are_recognised_along_each_axis() {
        let half = Vec3::new(0.2, 0.3, 0.1);
        let found = part_of(&piece(&Shape::of(Primitive::Cuboid { half_extents_m: half })), None).unwrap();
        assert_eq!(found.primitive, Primitive::Cuboid { half_extents_m: half });
        for rotation in [Rot3::IDENTITY, rotation_x(FRAC_PI_2), rotation_z(FRAC_PI_2)] {
            let primitive = Primitive::Cylinder { radius_m: 0.1, half_height_m: 0.04 };
            let body_from_part = Pose3::from_parts(Vec3::new(1.0, 2.0, 3.0), rotation);
            let shape = Shape { parts: vec![Part { primitive, body_from_part }] };
            let found = part_of(&piece(&shape), None).unwrap();
            let Primitive::Cylinder { radius_m, half_height_m } = found.primitive else { panic!("{found:?}") };
            assert!((radius_m - 0.1).abs() < 1e-5 && (half_height_m - 0.04).abs() < 1e-5, "{found:?}");
            let (own, given) = (Solid::of(&Shape { parts: vec![found] }), Solid::of(&shape));
            let (own, given) = (own.aabb(&Pose3::identity()), given.aabb(&Pose3::identity()));
            assert!((own.mins - given.mins).length() < 1e-5 && (own.maxs - given.maxs).length() < 1e-5);
        }
    }

    #[test]
    fn a_seam_that_is_written_twice_does_not_hide_a_cylinder() {
        let mut foot = piece(&Shape::of(Primitive::Cylinder { radius_m: 0.02, half_height_m: 0.002 }));
        let seam: Vec<Vec3> = foot.vertices.iter().filter(|v| v.x > 0.0199).map(|v| *v + Vec3::Z * 1e-9).collect();
        assert!(!seam.is_empty());
        foot.vertices.extend(seam);
        assert!(matches!(part_of(&foot, None).unwrap().primitive, Primitive::Cylinder { .. }));
    }

    #[test]
    fn a_round_solid_is_what_it_says_only_if_the_mesh_agrees() {
        let mut ball = piece(&Shape::of(Primitive::Sphere { radius_m: 0.05 }));
        let say = |radius_m: f32| {
            Some(format!(
                r#"{{"solid": "sphere", "radius_m": {radius_m}, "translation": [0, 0, 0], "rotation": [0, 0, 0, 1]}}"#
            ))
        };
        ball.extras = say(0.05);
        assert_eq!(part_of(&ball, None).unwrap().primitive, Primitive::Sphere { radius_m: 0.05 });
        for other in [say(0.06), Some("[1, 2]".into()), None] {
            ball.extras = other;
            // A mesh like any other then, of far more corners than a hull may have.
            assert!(
                matches!(part_of(&ball, Some(Convex::Hull)), Err(NoSolid::TooDetailed { .. })),
                "{:?}",
                ball.extras
            );
        }
    }

    #[test]
    fn a_dented_mesh_is_refused_unless_its_hull_is_asked_for() {
        // A U of three boxes in one mesh.
        let block = |x, y, z| Primitive::Cuboid { half_extents_m: Vec3::new(x, y, z) };
        let shape =
            Shape::default().with(block(0.3, 0.05, 0.1), 0.0, 0.0, 0.0).with(block(0.05, 0.2, 0.1), 0.25, 0.2, 0.0);
        let dented = piece(&shape.with(block(0.05, 0.2, 0.1), -0.25, 0.2, 0.0));
        let Err(NoSolid::Dented { dent_mm }) = part_of(&dented, None) else { panic!("a U is not convex") };
        assert!(dent_mm > 100.0, "{dent_mm}");
        assert!(matches!(part_of(&dented, Some(Convex::Hull)).unwrap().primitive, Primitive::Hull { .. }));
        let flat = Piece { vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Z], triangles: vec![[0, 1, 2]], extras: None };
        assert_eq!(part_of(&flat, Some(Convex::Hull)), Err(NoSolid::Flat));
    }
}
