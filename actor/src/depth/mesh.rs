//! Convex polyhedra with planar faces: what the camera sees of a [`Primitive`].
//!
//! Boxes and hulls are exact. Round things are lathed (a profile turned about the y axis), at several levels of
//! detail, inscribed in the true solid: each level says how far it lies inside, and the camera takes the coarsest
//! whose error is a fraction of a pixel.

use super::view::Sphere;
use crate::shape::{Primitive, Shape};
use rapier3d::math::Vec3;
use rapier3d::parry::transformation::try_convex_hull;

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

/// A convex polyhedron.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// Vertices, metres.
    pub vertices: Vec<[f32; 3]>,
    /// Indices of vertices, face after face.
    pub corners: Vec<u16>,
    /// Faces.
    pub faces: Vec<Face>,
}

/// A solid at several levels of detail.
#[derive(Debug, Clone)]
pub struct Solid {
    /// Coarse to fine: the largest distance between mesh and solid in metres, and the mesh. Errors decrease.
    pub levels: Vec<(f32, Mesh)>,
    /// Around the finest level.
    pub bounds: Sphere,
}

/// The finest mesh of a shape: triangles in the body's frame, metres, whose corners a, b, c run so that
/// (b − a) × (c − a) points outwards. Each part is closed; parts that overlap are not cut at each other.
pub fn triangles_of(shape: &Shape) -> Vec<[[f32; 3]; 3]> {
    let mut triangles = Vec::new();
    for part in &shape.parts {
        let levels = Solid::of(&part.primitive).levels;
        let Some((_, mesh)) = levels.last() else { continue };
        let place = |&[a, b, c]: &[[f32; 3]; 3]| {
            [a, b, c].map(|corner| part.body_from_part.transform_point(Vec3::from(corner)).to_array())
        };
        triangles.extend(mesh.triangulated().iter().map(place));
    }
    triangles
}

/// Numbers of sides that round things are drawn with, coarse to fine, with (cos, sin) of a side's angle.
const SIDES: [(usize, f64, f64); 5] = [
    (6, 0.5, 0.866_025_403_784_438_6),
    (10, 0.809_016_994_374_947_5, 0.587_785_252_292_473_1),
    (16, 0.923_879_532_511_286_7, 0.382_683_432_365_089_8),
    (24, 0.965_925_826_289_068_3, 0.258_819_045_102_520_74),
    (40, 0.987_688_340_595_137_8, 0.156_434_465_040_230_87),
];

impl Mesh {
    /// Triangles that its faces amount to.
    pub fn triangles(&self) -> usize {
        self.corners.len() - 2 * self.faces.len()
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
    fn lathe(profile: &[(f64, f64)], (sides, cos, sin): (usize, f64, f64)) -> Self {
        let mut mesh = Self::default();
        let mut rings: Vec<Vec<u16>> = Vec::new();
        for &(radius, y) in profile {
            let count = if radius == 0.0 { 1 } else { sides };
            let (mut c, mut s) = (1.0f64, 0.0f64);
            let mut ring = Vec::new();
            for _ in 0..count {
                ring.push(mesh.vertices.len() as u16);
                mesh.vertices.push([(radius * c) as f32, y as f32, (radius * s) as f32]);
                (c, s) = (c * cos - s * sin, s * cos + c * sin);
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

    /// The hull of points, as triangles. (The faces of parry's `ConvexPolyhedron` are merged from triangles that are
    /// only nearly coplanar: drawn as planes they were 2 mm off.)
    fn hull(points: &[Vec3]) -> Self {
        let Ok((vertices, triangles)) = try_convex_hull(points) else {
            return Self::default();
        };
        let mut mesh = Self { vertices: vertices.iter().map(Vec3::to_array).collect(), ..Self::default() };
        for triangle in triangles {
            mesh.face(&triangle.map(|corner| corner as u16));
        }
        mesh
    }

    fn bounds(&self) -> Sphere {
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

impl Solid {
    /// What the camera sees of a primitive.
    pub fn of(primitive: &Primitive) -> Self {
        let levels: Vec<(f32, Mesh)> = match primitive {
            Primitive::Cuboid { half_extents_m } => vec![(0.0, Mesh::cuboid(*half_extents_m))],
            Primitive::Hull { points_m } => vec![(0.0, Mesh::hull(points_m))],
            Primitive::Cylinder { radius_m, half_height_m } => {
                let (r, h) = (f64::from(*radius_m), f64::from(*half_height_m));
                SIDES.map(|sides| (error_m(r, sides), Mesh::lathe(&[(r, -h), (r, h)], sides))).into()
            }
            Primitive::Sphere { radius_m } => round_ended(f64::from(*radius_m), 0.0),
            Primitive::Capsule { radius_m, half_height_m } => {
                round_ended(f64::from(*radius_m), f64::from(*half_height_m))
            }
        };
        let bounds = levels[levels.len() - 1].1.bounds();
        Self { levels, bounds }
    }
}

/// Distance between a circle and the sides of the inscribed polygon: r (1 − cos(π/n)), with the half-angle formula.
fn error_m(radius_m: f64, (_, cos, _): (usize, f64, f64)) -> f32 {
    (radius_m * (1.0 - f64::midpoint(1.0, cos).sqrt())) as f32
}

/// A sphere (half height 0) or a capsule about the y axis.
fn round_ended(radius_m: f64, half_height_m: f64) -> Vec<(f32, Mesh)> {
    SIDES
        .into_iter()
        .map(|sides| {
            let (n, cos, sin) = sides;
            // From pole to equator in quarter turns of the same angle as the sides; n / 4 may leave a rest, which
            // goes to the last ring: the profile stays inscribed.
            let mut quarter = vec![(0.0, 1.0)];
            let (mut c, mut s) = (cos, sin);
            for _ in 1..n.div_ceil(4) {
                quarter.push((s, c));
                (c, s) = (c * cos - s * sin, s * cos + c * sin);
            }
            let mut profile: Vec<(f64, f64)> =
                quarter.iter().map(|&(s, c)| (radius_m * s, -half_height_m - radius_m * c)).collect();
            profile.push((radius_m, -half_height_m));
            if half_height_m > 0.0 {
                profile.push((radius_m, half_height_m));
            }
            profile.extend(quarter.iter().rev().map(|&(s, c)| (radius_m * s, half_height_m + radius_m * c)));
            // Bent both ways, so twice as far off as a circle.
            (2.0 * error_m(radius_m, sides), Mesh::lathe(&profile, sides))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let solid = Solid::of(&primitive);
            for (_, mesh) in &solid.levels {
                check(mesh);
            }
            let got = volume(&solid.levels.last().unwrap().1);
            assert!((got / expected - 1.0).abs() < tolerance, "{primitive:?}: volume {got}, expected {expected}");
            assert!(solid.levels.windows(2).all(|pair| pair[0].0 > pair[1].0), "errors decrease");
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
        assert_eq!(triangles.len(), 12 + Solid::of(&Primitive::Sphere { radius_m: 0.2 }).levels[4].1.triangles());
    }

    #[test]
    fn levels_lie_inside_by_no_more_than_they_say() {
        let radius = 0.3f32;
        for (error, mesh) in Solid::of(&Primitive::Sphere { radius_m: radius }).levels {
            for face in &mesh.faces {
                assert!(face.offset_m >= radius - error * 1.01, "{} against {radius} - {error}", face.offset_m);
            }
        }
    }
}
