//! Which convex solid a mesh is: what it says it is, a box, a cylinder, or its hull.
//!
//! Boxes and cylinders rest on their faces without rocking and cost physics less than hulls, so they are looked for.

use super::mirror;
use super::no_solid::{CORNERS_MOST, NoSolid};
use super::piece::Piece;
use crate::physics::geometry::{Solid, rotation_x, rotation_z};
use crate::shape::{Part, Primitive, Shape};
use rapier3d::math::{Pose3, Rot3, Vec3};
use rapier3d::parry::shape::SharedShape;
use rapier3d::parry::transformation::try_convex_hull;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::f32::consts::FRAC_PI_2;

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

pub fn part_of(piece: &Piece) -> Result<Part, NoSolid> {
    let points = distinct(&piece.vertices);
    let (low, high) = bounds(&points);
    if points.len() < 4 || (high - low).min_element() < FLAT_M {
        return Err(NoSolid::Flat);
    }
    let (hull, faces) = hull(&points)?;
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
    let dent_m = dent_m(piece, &hull, &faces);
    if dent_m > DENT_M.max(DENT_SHARE * size) {
        return Err(NoSolid::Dented { dent_mm: 1000.0 * dent_m });
    }
    hull_part(hull)
}

/// The convex hull of a mesh, whatever dents it has.
pub fn hull_of(piece: &Piece) -> Result<Part, NoSolid> {
    let (hull, _) = hull(&distinct(&piece.vertices))?;
    hull_part(hull)
}

/// Corners and faces. Physics makes the hull of the corners again, and may find none: they lie nearly in one plane.
fn hull(points: &[Vec3]) -> Result<(Vec<Vec3>, Vec<[u32; 3]>), NoSolid> {
    let (corners, faces) = try_convex_hull(points).map_err(|_| NoSolid::Flat)?;
    SharedShape::convex_hull(&corners).map(|_| (corners, faces)).ok_or(NoSolid::Flat)
}

fn hull_part(points_m: Vec<Vec3>) -> Result<Part, NoSolid> {
    if points_m.len() > CORNERS_MOST {
        return Err(NoSolid::TooDetailed { corners: points_m.len() });
    }
    Ok(Part { primitive: Primitive::Hull { points_m }, body_from_part: Pose3::identity() })
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
fn dent_m(piece: &Piece, hull: &[Vec3], faces: &[[u32; 3]]) -> f32 {
    const SLIVER_M2: f32 = 1e-8;
    let slopes = Slopes::of(hull, faces);
    let mut deepest = 0.0_f32;
    // Neighbours look nearly the same way: the last triangle's extremes are near the next one's.
    let (mut top, mut bottom) = (0, 0);
    for corners in &piece.triangles {
        let [a, b, c] = corners.map(|corner| piece.vertices[corner as usize]);
        let area = (b - a).cross(c - a);
        if area.length() < SLIVER_M2 {
            continue;
        }
        let normal = area.normalize();
        (top, bottom) = (slopes.climb(hull, normal, top), slopes.climb(hull, -normal, bottom));
        let above = normal.dot(hull[top] - a);
        let below = normal.dot(hull[bottom] - a);
        deepest = deepest.max(above.min(-below));
    }
    deepest
}

/// Which corners of a hull are joined by an edge.
struct Slopes {
    /// Where each corner's neighbours begin in the list, and the list's end.
    first: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Slopes {
    fn of(hull: &[Vec3], faces: &[[u32; 3]]) -> Self {
        let mut edges: Vec<[u32; 2]> =
            faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, a], [b, c], [c, b], [c, a], [a, c]]).collect();
        edges.sort_unstable();
        edges.dedup();
        let first = (0..=hull.len()).map(|corner| edges.partition_point(|edge| (edge[0] as usize) < corner) as u32);
        Self { first: first.collect(), neighbours: edges.iter().map(|edge| edge[1]).collect() }
    }

    /// The corner that lies farthest along a direction. On a convex solid the way there only rises, so that not every
    /// corner has to be looked at.
    fn climb(&self, hull: &[Vec3], along: Vec3, from: usize) -> usize {
        let mut here = from;
        loop {
            let neighbours = &self.neighbours[self.first[here] as usize..self.first[here + 1] as usize];
            let mut best = here;
            for &next in neighbours {
                if along.dot(hull[next as usize]) > along.dot(hull[best]) {
                    best = next as usize;
                }
            }
            if best == here {
                return here;
            }
            here = best;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every vertex against every triangle: what [`dent_m`] must find, in far more steps.
    fn dent_by_all_m(piece: &Piece) -> f32 {
        let mut deepest = 0.0_f32;
        for corners in &piece.triangles {
            let [a, b, c] = corners.map(|corner| piece.vertices[corner as usize]);
            let normal = (b - a).cross(c - a).normalize();
            let heights = piece.vertices.iter().map(|&vertex| normal.dot(vertex - a));
            let (below, above) = heights.fold((0.0_f32, 0.0_f32), |(low, high), h| (low.min(h), high.max(h)));
            deepest = deepest.max(above.min(-below));
        }
        deepest
    }

    /// A ball of `rings` rings of `2 * rings` vertices; its surface is pressed in where `press` says so.
    fn ball(rings: usize, press: impl Fn(Vec3) -> f32) -> Piece {
        let sides = 2 * rings;
        let mut piece = Piece::default();
        for ring in 0..=rings {
            for side in 0..sides {
                let (sin, cos) = libm::sincosf(std::f32::consts::PI * ring as f32 / rings as f32);
                let (sin_side, cos_side) = libm::sincosf(std::f32::consts::TAU * side as f32 / sides as f32);
                let out = Vec3::new(sin * cos_side, cos, sin * sin_side);
                piece.vertices.push(0.2 * press(out) * out);
                let at = |ring: usize, side: usize| (ring * sides + side % sides) as u32;
                if ring > 1 {
                    piece.triangles.push([at(ring - 1, side), at(ring, side), at(ring - 1, side + 1)]);
                }
                if ring > 0 && ring < rings {
                    piece.triangles.push([at(ring - 1, side + 1), at(ring, side), at(ring, side + 1)]);
                }
            }
        }
        piece
    }

    #[test]
    fn a_dent_is_as_deep_as_a_look_at_every_vertex_finds() {
        let dented = |out: Vec3| if out.x > 0.9 { 0.8_f32 } else { 1.0 };
        for (press, least_m, most_m) in [
            (&dented as &dyn Fn(Vec3) -> f32, 0.01, 0.4),
            (&|_| 1.0, 0.0, 1e-4),
            (&|out: Vec3| 1.0 - 0.3 * out.y * out.y, 0.0, 0.4),
        ] {
            let piece = ball(16, press);
            let (hull, faces) = try_convex_hull(&distinct(&piece.vertices)).unwrap();
            let (found_m, all_m) = (dent_m(&piece, &hull, &faces), dent_by_all_m(&piece));
            assert!((found_m - all_m).abs() < 1e-4, "{found_m} m, {all_m} m by a look at all");
            assert!((least_m..=most_m).contains(&found_m), "{found_m}");
        }
    }

    /// What this thread has had of a processor, seconds: other programs do not count.
    fn processor_s() -> f64 {
        let times = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
        times.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e9
    }

    #[test]
    fn a_mesh_of_two_hundred_thousand_triangles_is_judged_in_seconds() {
        let before_s = processor_s();
        let piece = ball(225, |out| if out.x > 0.9 { 0.8 } else { 1.0 });
        assert!(piece.triangles.len() > 200_000);
        assert!(matches!(part_of(&piece), Err(NoSolid::Dented { .. })));
        let took_s = processor_s() - before_s;
        assert!(took_s > 0.0 && took_s < 8.0, "{took_s:.1} s");
    }
}
