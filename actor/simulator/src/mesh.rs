//! Polyhedra with planar faces: the finest mesh of a [`Primitive`]. All are convex, but for dented meshes of users.
//!
//! Boxes, hulls and dented meshes are exact. Round things are lathed (a profile turned about the y axis) and inscribed
//! in the true solid, with at least [`SIDES_LEAST`] sides and as many more as keep them within [`FINEST_ERROR_M`] of
//! it. The camera draws boxes and hulls from these meshes, and round things by their formula; others (exporters,
//! comparisons) get them as triangles.

use crate::shape::{Concave, Primitive, Shape};
use rapier3d::math::Vec3;
use rapier3d::parry::transformation::try_convex_hull;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

const SIDES_LEAST: usize = 40;
const SIDES_MOST: usize = 120;
/// The sides of a round thing lie within this distance of it, metres, unless that takes more than the most sides.
const FINEST_ERROR_M: f64 = 0.000_15;
/// Triangles of a hull that lie this near to one plane are one face, metres.
const COPLANAR_M: f32 = 0.000_02;
/// No face.
const NONE: u16 = u16::MAX;

/// One planar face. Its corners run so that (b − a) × (c − a) points outwards.
#[derive(Debug, Clone, Copy)]
pub struct Face {
    /// Outward unit normal.
    pub normal: [f32; 3],
    /// Offset of its plane: normal · p = offset, metres.
    pub offset_m: f32,
    /// Its corners: `corners[first..first + count]`.
    pub first: u32,
    /// Number of corners, at least 3.
    pub count: u32,
}

#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// Vertices, metres.
    pub vertices: Vec<[f32; 3]>,
    /// Indices of vertices, face after face.
    pub corners: Vec<u16>,
    pub faces: Vec<Face>,
}

/// An edge: from one vertex to the next around one of its faces, and the other way around the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Vertices, in the order of the first face.
    pub ends: [u16; 2],
    pub faces: [u16; 2],
}

#[derive(Debug, Clone, Copy)]
pub struct Sphere {
    pub centre: [f32; 3],
    pub radius_m: f32,
}

/// The finest mesh of a shape: triangles in the body's frame, metres, whose corners a, b, c run so that
/// (b − a) × (c − a) points outwards. Each part is closed; parts that overlap are not cut at each other.
pub fn triangles_of(shape: &Shape) -> Vec<[[f32; 3]; 3]> {
    let mut triangles = Vec::new();
    for part in &shape.parts {
        let place = |&[a, b, c]: &[[f32; 3]; 3]| {
            [a, b, c].map(|corner| part.body_from_part.transform_point(Vec3::from(corner)).to_array())
        };
        triangles.extend(Mesh::of(&part.primitive).triangulated().iter().map(place));
    }
    triangles
}

/// Number of sides of a cylinder of this radius, a multiple of 4.
pub fn sides(radius_m: f32) -> usize {
    let mut sides = SIDES_LEAST;
    while sides < SIDES_MOST && f64::from(radius_m) * (1.0 - libm::cos(PI / sides as f64)) > FINEST_ERROR_M {
        sides += 4;
    }
    sides
}

/// Number of sides of a sphere or capsule of this radius: bent both ways, it deviates twice as far from its faces.
pub(crate) fn sides_of_sphere(radius_m: f32) -> usize {
    sides(2.0 * radius_m)
}

impl Mesh {
    pub fn of(primitive: &Primitive) -> Self {
        match primitive {
            Primitive::Cuboid { half_extents_m } => Self::cuboid(*half_extents_m),
            Primitive::Hull { points_m } => Self::hull(points_m),
            Primitive::Cylinder { radius_m, half_height_m } => {
                let (r, h) = (f64::from(*radius_m), f64::from(*half_height_m));
                Self::lathe(&[(r, -h), (r, h)], sides(*radius_m))
            }
            Primitive::Sphere { radius_m } => round_ended(*radius_m, 0.0),
            Primitive::Concave(concave) => Self::concave(concave),
            Primitive::Capsule { radius_m, half_height_m } => round_ended(*radius_m, *half_height_m),
        }
    }

    /// Triangles that its faces are cut into.
    pub(crate) fn triangle_count(&self) -> usize {
        self.faces.iter().map(|face| face.count as usize - 2).sum()
    }

    /// Its faces cut into triangles, from the first corner of each.
    fn triangulated(&self) -> Vec<[[f32; 3]; 3]> {
        let corner = |index: u32| self.vertices[usize::from(self.corners[index as usize])];
        self.faces
            .iter()
            .flat_map(|face| {
                (face.first + 1..face.first + face.count - 1)
                    .map(move |second| [corner(face.first), corner(second), corner(second + 1)])
            })
            .collect()
    }

    /// Adds a face through these vertices; degenerate ones are left out.
    fn face(&mut self, corners: &[u16]) {
        let p = |i: usize| Vec3::from(self.vertices[usize::from(corners[i])]);
        // Newell's method: the area vector, also good when three corners are nearly in a line.
        let area = (0..corners.len()).fold(Vec3::ZERO, |sum, i| sum + p(i).cross(p((i + 1) % corners.len())));
        let length = area.length();
        if length < 1e-12 {
            return;
        }
        let normal = area / length;
        let offset_m = (0..corners.len()).map(|i| normal.dot(p(i))).sum::<f32>() / corners.len() as f32;
        let first = self.corners.len() as u32;
        self.corners.extend_from_slice(corners);
        self.faces.push(Face { normal: normal.to_array(), offset_m, first, count: corners.len() as u32 });
    }

    fn cuboid(half: Vec3) -> Self {
        let sign = |bit: usize| if bit == 0 { -1.0 } else { 1.0 };
        let vertices = (0..8).map(|i| [sign(i & 1) * half.x, sign(i & 2) * half.y, sign(i & 4) * half.z]).collect();
        let mut mesh = Self { vertices, ..Self::default() };
        for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
            mesh.face(&face);
        }
        mesh
    }

    /// Turns a profile of (radius, y), from the lowest point up, about the y axis. A radius of 0 is a pole; an end
    /// with another radius is closed by a flat cap.
    fn lathe(profile: &[(f64, f64)], sides: usize) -> Self {
        let mut mesh = Self::default();
        let mut rings: Vec<Vec<u16>> = Vec::new();
        for &(radius, y) in profile {
            let count = if radius == 0.0 { 1 } else { sides };
            let mut ring = Vec::new();
            for side in 0..count {
                let (sin, cos) = libm::sincos(2.0 * PI * side as f64 / sides as f64);
                ring.push(mesh.vertices.len() as u16);
                mesh.vertices.push([(radius * cos) as f32, y as f32, (radius * sin) as f32]);
            }
            rings.push(ring);
        }
        for pair in rings.windows(2) {
            let (low, high) = (&pair[0], &pair[1]);
            for i in 0..sides {
                let j = (i + 1) % sides;
                match (low.len(), high.len()) {
                    (1, 1) => {}
                    (1, _) => mesh.face(&[low[0], high[i], high[j]]),
                    (_, 1) => mesh.face(&[low[i], high[0], low[j]]),
                    _ => mesh.face(&[low[i], high[i], high[j], low[j]]),
                }
            }
        }
        let (bottom, top) = (rings[0].clone(), rings[rings.len() - 1].clone());
        if bottom.len() > 1 {
            mesh.face(&bottom);
        }
        if top.len() > 1 {
            mesh.face(&top.into_iter().rev().collect::<Vec<_>>());
        }
        mesh
    }

    /// The hull of points. Triangles of it that lie in one plane are one face.
    fn hull(points: &[Vec3]) -> Self {
        let Ok((vertices, triangles)) = try_convex_hull(points) else {
            return Self::default();
        };
        let triangles: Vec<[u16; 3]> = triangles.iter().map(|triangle| triangle.map(|corner| corner as u16)).collect();
        let vertices: Vec<[f32; 3]> = vertices.iter().map(Vec3::to_array).collect();
        let mut merged = Self { vertices: vertices.clone(), ..Self::default() };
        for polygon in polygons(&vertices, &triangles) {
            merged.face(&polygon);
        }
        if merged.edges().is_some() {
            return merged;
        }
        let mut plain = Self { vertices, ..Self::default() };
        for triangle in &triangles {
            plain.face(triangle);
        }
        plain
    }

    /// A dented mesh, a face for each triangle.
    fn concave(concave: &Concave) -> Self {
        let vertices = concave.vertices.iter().map(Vec3::to_array).collect();
        let mut mesh = Self { vertices, ..Self::default() };
        for triangle in &concave.triangles {
            mesh.face(&triangle.map(|corner| corner as u16));
        }
        mesh
    }

    /// Its edges, if it is closed: each edge is run through once each way.
    pub(crate) fn edges(&self) -> Option<Vec<Edge>> {
        let mut edges: BTreeMap<[u16; 2], Edge> = BTreeMap::new();
        for (number, face) in self.faces.iter().enumerate() {
            let corners = &self.corners[face.first as usize..(face.first + face.count) as usize];
            for (i, &a) in corners.iter().enumerate() {
                let b = corners[(i + 1) % corners.len()];
                let number = number as u16;
                let edge = edges.entry([a.min(b), a.max(b)]).or_insert(Edge { ends: [NONE; 2], faces: [NONE; 2] });
                if edge.faces[0] == NONE {
                    *edge = Edge { ends: [a, b], faces: [number, NONE] };
                } else if edge.faces[1] == NONE && edge.ends == [b, a] {
                    edge.faces[1] = number;
                } else {
                    return None;
                }
            }
        }
        edges.values().all(|edge| edge.faces[1] != NONE).then(|| edges.into_values().collect())
    }

    pub fn bounds(&self) -> Sphere {
        let (mut low, mut high) = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
        for &v in &self.vertices {
            low = low.min(Vec3::from(v));
            high = high.max(Vec3::from(v));
        }
        if self.vertices.is_empty() {
            return Sphere { centre: [0.0; 3], radius_m: 0.0 };
        }
        let centre = (low + high) * 0.5;
        let radius = self.vertices.iter().map(|&v| Vec3::from(v).distance(centre)).fold(0.0, f32::max);
        // A hair more, for the rounding of everything that is compared with it.
        Sphere { centre: centre.to_array(), radius_m: radius * 1.0001 }
    }
}

/// A sphere (half height 0) or a capsule about the y axis.
fn round_ended(radius_m: f32, half_height_m: f32) -> Mesh {
    let (r, h) = (f64::from(radius_m), f64::from(half_height_m));
    let sides = sides_of_sphere(radius_m);
    let quarter: Vec<(f64, f64)> = (0..sides / 4)
        .map(|ring| {
            let (sin, cos) = libm::sincos(2.0 * PI * ring as f64 / sides as f64);
            (r * sin, h + r * cos)
        })
        .collect();
    let mut profile: Vec<(f64, f64)> = quarter.iter().map(|&(radius, y)| (radius, -y)).collect();
    profile.push((r, -h));
    if h > 0.0 {
        profile.push((r, h));
    }
    profile.extend(quarter.iter().rev());
    Mesh::lathe(&profile, sides)
}

/// The polygons that triangles of a hull make up: the largest triangle that is left, with all that are joined to it
/// and lie in its plane.
fn polygons(vertices: &[[f32; 3]], triangles: &[[u16; 3]]) -> Vec<Vec<u16>> {
    let vertex = |index: u16| Vec3::from(vertices[usize::from(index)]);
    let area = |&[a, b, c]: &[u16; 3]| (vertex(b) - vertex(a)).cross(vertex(c) - vertex(a));
    let mut by_edge = BTreeMap::new();
    for (index, triangle) in triangles.iter().enumerate() {
        for i in 0..3 {
            by_edge.insert([triangle[i], triangle[(i + 1) % 3]], index);
        }
    }
    let mut seeds: Vec<usize> = (0..triangles.len()).collect();
    seeds.sort_by(|&a, &b| area(&triangles[b]).length_squared().total_cmp(&area(&triangles[a]).length_squared()));
    let mut taken = vec![false; triangles.len()];
    let mut polygons = Vec::new();
    for seed in seeds {
        if taken[seed] {
            continue;
        }
        let normal = area(&triangles[seed]).normalize_or_zero();
        let offset = normal.dot(vertex(triangles[seed][0]));
        taken[seed] = true;
        let mut group = vec![seed];
        let mut next = 0;
        while let Some(&member) = group.get(next) {
            next += 1;
            for i in 0..3 {
                let [a, b] = [triangles[member][i], triangles[member][(i + 1) % 3]];
                let Some(&neighbour) = by_edge.get(&[b, a]) else { continue };
                let flat = |&corner: &u16| (normal.dot(vertex(corner)) - offset).abs() <= COPLANAR_M;
                if !taken[neighbour] && triangles[neighbour].iter().all(flat) {
                    taken[neighbour] = true;
                    group.push(neighbour);
                }
            }
        }
        polygons.extend(outline(triangles, &group));
    }
    polygons
}

/// The loop around triangles that are joined, or the triangles themselves if it is not one simple loop.
fn outline(triangles: &[[u16; 3]], group: &[usize]) -> Vec<Vec<u16>> {
    let directed =
        || group.iter().flat_map(|&index| (0..3).map(move |i| [triangles[index][i], triangles[index][(i + 1) % 3]]));
    let inside: BTreeSet<[u16; 2]> = directed().collect();
    let next: BTreeMap<u16, u16> =
        directed().filter(|&[a, b]| !inside.contains(&[b, a])).map(|[a, b]| (a, b)).collect();
    let rim = directed().filter(|&[a, b]| !inside.contains(&[b, a])).count();
    let mut polygon = Vec::new();
    if let Some((&start, _)) = next.first_key_value() {
        let mut at = start;
        while let Some(&to) = next.get(&at) {
            polygon.push(at);
            at = to;
            if at == start || polygon.len() > rim {
                break;
            }
        }
    }
    if polygon.len() == rim && polygon.len() >= 3 {
        vec![polygon]
    } else {
        group.iter().map(|&index| triangles[index].to_vec()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn volume(mesh: &Mesh) -> f32 {
        mesh.faces
            .iter()
            .map(|face| {
                let corner = |i: u32| Vec3::from(mesh.vertices[usize::from(mesh.corners[(face.first + i) as usize])]);
                (1..face.count - 1).map(|i| corner(0).dot(corner(i).cross(corner(i + 1))) / 6.0).sum::<f32>()
            })
            .sum()
    }

    fn check(mesh: &Mesh) {
        // Convex, outward, planar; and closed: each edge is run through once each way.
        let mut edges = std::collections::BTreeMap::new();
        for face in &mesh.faces {
            for v in &mesh.vertices {
                let height = Vec3::from(face.normal).dot(Vec3::from(*v)) - face.offset_m;
                assert!(height < 1e-5, "vertex {v:?} lies {height} m outside of a face");
            }
            for i in 0..face.count {
                let a = mesh.corners[(face.first + i) as usize];
                let b = mesh.corners[(face.first + (i + 1) % face.count) as usize];
                let height = Vec3::from(face.normal).dot(Vec3::from(mesh.vertices[usize::from(a)])) - face.offset_m;
                assert!(height.abs() < 1e-5, "corner is {height} m off its plane");
                *edges.entry((a.min(b), a.max(b))).or_insert(0) += if a < b { 1 } else { 100 };
            }
        }
        assert!(edges.values().all(|&count| count == 101), "the surface has a hole");
    }

    #[test]
    fn solids_are_closed_convex_and_have_their_volume() {
        let (r, h) = (0.2, 0.35);
        let ball = 4.0 / 3.0 * std::f32::consts::PI * r * r * r;
        let tube = std::f32::consts::PI * r * r * 2.0 * h;
        let cases = [
            (Primitive::Cuboid { half_extents_m: Vec3::new(0.1, 0.2, 0.3) }, 8.0 * 0.1 * 0.2 * 0.3, 1e-6),
            (Primitive::Cylinder { radius_m: r, half_height_m: h }, tube, 0.01),
            (Primitive::Sphere { radius_m: r }, ball, 0.02),
            (Primitive::Capsule { radius_m: r, half_height_m: h }, ball + tube, 0.02),
            (
                Primitive::Hull {
                    points_m: vec![
                        Vec3::new(0.0, 0.0, 0.0),
                        Vec3::new(1.0, 0.0, 0.0),
                        Vec3::new(0.0, 1.0, 0.0),
                        Vec3::new(0.0, 0.0, 1.0),
                        Vec3::new(0.1, 0.1, 0.1),
                    ],
                },
                1.0 / 6.0,
                1e-5,
            ),
        ];
        for (primitive, expected, tolerance) in cases {
            let mesh = Mesh::of(&primitive);
            check(&mesh);
            let edges = mesh.edges().unwrap();
            assert_eq!(mesh.vertices.len() + mesh.faces.len(), edges.len() + 2, "Euler's formula");
            let got = volume(&mesh);
            assert!((got / expected - 1.0).abs() < tolerance, "{primitive:?}: volume {got}, expected {expected}");
        }
    }

    #[test]
    fn triangles_of_a_shape_stand_where_its_parts_do() {
        use rapier3d::math::Pose3;
        let half = Vec3::new(0.1, 0.2, 0.3);
        let mut shape = Shape::of(Primitive::Cuboid { half_extents_m: half });
        shape.parts[0].body_from_part = Pose3::new(Vec3::new(1.0, 2.0, 3.0), Vec3::new(0.3, -0.4, 0.5));
        let shape = shape.with(Primitive::Sphere { radius_m: 0.2 }, -1.0, 0.0, 0.0);
        let triangles = triangles_of(&shape);
        // The divergence theorem: each closed surface adds its volume and the first moment of it.
        let (mut volume, mut moment) = (0.0f64, [0.0f64; 3]);
        for triangle in &triangles {
            let [a, b, c] = triangle.map(|corner| corner.map(f64::from));
            let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
            let six = a[0] * cross[0] + a[1] * cross[1] + a[2] * cross[2];
            volume += six / 6.0;
            for axis in 0..3 {
                moment[axis] += six / 24.0 * (a[axis] + b[axis] + c[axis]);
            }
        }
        let (cuboid, ball) = (8.0 * 0.1 * 0.2 * 0.3, 4.0 / 3.0 * std::f64::consts::PI * 0.2f64.powi(3));
        assert!((volume - cuboid - ball).abs() < 0.02 * ball, "{volume}");
        for (moment, expected) in moment.into_iter().zip([cuboid - ball, 2.0 * cuboid, 3.0 * cuboid]) {
            assert!((moment - expected).abs() < 0.02 * ball, "{moment}, expected {expected}");
        }
        assert_eq!(triangles.len(), 12 + Mesh::of(&Primitive::Sphere { radius_m: 0.2 }).triangulated().len());
    }

    #[test]
    fn round_things_lie_within_their_solid_by_no_more_than_promised() {
        for radius_m in [0.01f32, 0.05, 0.1, 0.2] {
            let within = |mesh: &Mesh, error_m: f32| {
                for face in &mesh.faces {
                    let height_m = face.offset_m - (radius_m - error_m);
                    assert!(height_m >= -1e-6, "{radius_m}: {height_m}");
                }
            };
            let error_m = FINEST_ERROR_M as f32;
            within(&Mesh::of(&Primitive::Sphere { radius_m }), error_m);
            within(&Mesh::of(&Primitive::Cylinder { radius_m, half_height_m: 0.5 }), error_m);
            assert!(sides(radius_m).is_multiple_of(4));
        }
    }

    #[test]
    fn coplanar_triangles_of_a_hull_are_one_face() {
        // A prism of 16 sides: 16 rectangles and two caps.
        let points_m = (0..32)
            .map(|i| {
                let (sin, cos) = libm::sincosf(std::f32::consts::TAU * (i / 2) as f32 / 16.0);
                Vec3::new(0.1 * cos, if i % 2 == 0 { 0.0 } else { 0.2 }, 0.1 * sin)
            })
            .collect();
        let mesh = Mesh::of(&Primitive::Hull { points_m });
        check(&mesh);
        assert_eq!((mesh.faces.len(), mesh.edges().unwrap().len(), mesh.triangulated().len()), (18, 48, 60));
    }

    proptest! {
        #[test]
        fn hulls_are_closed_and_convex(points in prop::collection::vec(prop::array::uniform3(-0.3f32..0.3), 8..40)) {
            let mesh = Mesh::of(&Primitive::Hull { points_m: points.into_iter().map(Vec3::from).collect() });
            let edges = mesh.edges().unwrap();
            let used: BTreeSet<u16> = mesh.corners.iter().copied().collect();
            prop_assert_eq!(used.len() + mesh.faces.len(), edges.len() + 2);
            for face in &mesh.faces {
                for v in &used {
                    let height = Vec3::from(face.normal).dot(Vec3::from(mesh.vertices[usize::from(*v)])) - face.offset_m;
                    prop_assert!(height < 2.0 * COPLANAR_M, "{height}");
                }
            }
        }
    }
}
