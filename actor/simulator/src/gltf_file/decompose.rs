//! A dented mesh as convex pieces, by parry's VHACD: the mesh is filled with voxels, which are cut along planes until
//! every piece is nearly convex. A piece is then the hull of the mesh's own surface within it.
//!
//! All of it is single-precision arithmetic in a fixed order: the same mesh gives the same pieces on every machine.

use super::convex;
use super::no_solid::{NoSolid, TRIANGLES_MOST};
use super::piece::Piece;
use crate::shape::{Concave, Part};
use rapier3d::math::Vec3;
use rapier3d::parry::transformation::vhacd::{VHACD, VHACDParameters};
use rapier3d::parry::transformation::voxelization::FillMode;
use std::collections::BTreeMap;

/// Voxels along the longest side of the mesh.
const RESOLUTION: u32 = 64;
/// A piece is cut again while its hull holds more than this that is not mesh, as a share of the whole hull's volume.
const CONCAVITY: f32 = 0.003;
/// Pieces at most, nearly: cutting stops at a depth of five, so that there may be twice as many.
const PIECES: u32 = 16;
/// Vertices that are this near to each other are one, metres.
const WELD_M: f32 = 1e-5;
/// A piece of less is left out, as a share of the mesh's volume: slivers along the cuts.
const SLIVER: f32 = 1e-4;

/// A mesh that has an inside: each edge is run through as often one way as the other, and its faces look outwards.
#[derive(Debug, Clone, PartialEq)]
pub struct Closed {
    vertices: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    volume_m3: f32,
}

/// The mesh with vertices that lie at one place made one, and its faces turned outwards.
pub fn closed(piece: &Piece) -> Result<Closed, NoSolid> {
    if piece.triangles.len() > TRIANGLES_MOST {
        return Err(NoSolid::TooManyTriangles { triangles: piece.triangles.len() });
    }
    let (vertices, number) = welded(&piece.vertices);
    let corners = piece.triangles.iter().map(|triangle| triangle.map(|corner| number[corner as usize]));
    let mut triangles: Vec<[u32; 3]> = corners.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    let mut runs: BTreeMap<[u32; 2], i32> = BTreeMap::new();
    for [a, b, c] in &triangles {
        for [from, to] in [[*a, *b], [*b, *c], [*c, *a]] {
            *runs.entry([from.min(to), from.max(to)]).or_default() += if from < to { 1 } else { -1 };
        }
    }
    let edges = runs.values().filter(|&&runs| runs != 0).count();
    if edges > 0 {
        return Err(NoSolid::Open { edges });
    }
    let corner = |index: u32| vertices[index as usize] - vertices[0];
    let volume_m3 = triangles.iter().map(|t| corner(t[0]).dot(corner(t[1]).cross(corner(t[2])))).sum::<f32>() / 6.0;
    if volume_m3 == 0.0 {
        return Err(NoSolid::Flat);
    }
    // Which way round they are says nothing: a mirroring scale turns all of them over.
    if volume_m3 < 0.0 {
        for triangle in &mut triangles {
            triangle.swap(1, 2);
        }
    }
    Ok(Closed { vertices, triangles, volume_m3: volume_m3.abs() })
}

pub fn concave(mesh: Closed) -> Result<Concave, NoSolid> {
    let Closed { vertices, triangles, volume_m3 } = mesh;
    let parameters = VHACDParameters {
        resolution: RESOLUTION,
        concavity: CONCAVITY,
        max_convex_hulls: PIECES,
        fill_mode: FillMode::FloodFill { detect_cavities: false },
        // The approximation takes hulls of points that may all lie in one plane, and panics there.
        convex_hull_approximation: false,
        ..VHACDParameters::default()
    };
    let cut = VHACD::decompose(&parameters, &vertices, &triangles, true);
    let mut pieces: Vec<Part> = Vec::new();
    for (points, corners) in cut.compute_exact_convex_hulls(&vertices, &triangles) {
        let hull = Piece { vertices: points, triangles: corners, extras: None };
        match convex::part_of(&hull) {
            _ if hull.volume_m3() < SLIVER * volume_m3 => {}
            Ok(part) => pieces.push(part),
            Err(NoSolid::Flat) => {}
            Err(other) => return Err(other),
        }
    }
    if pieces.is_empty() {
        return Err(NoSolid::Flat);
    }
    Ok(Concave { vertices, triangles, pieces })
}

impl Piece {
    /// Volume, if it is closed and its faces look outwards, cubic metres.
    fn volume_m3(&self) -> f32 {
        let corner = |index: u32| self.vertices[index as usize] - self.vertices[0];
        let six = self.triangles.iter().map(|t| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))));
        six.sum::<f32>() / 6.0
    }
}

/// Each place once, and which of them each vertex is at.
fn welded(vertices: &[Vec3]) -> (Vec<Vec3>, Vec<u32>) {
    let cell = |vertex: &Vec3| vertex.to_array().map(|v| libm::floorf(v / WELD_M) as i32);
    let mut places: Vec<Vec3> = Vec::new();
    let mut by_cell: BTreeMap<[i32; 3], u32> = BTreeMap::new();
    let number = vertices.iter().map(|vertex| {
        let [x, y, z] = cell(vertex);
        let near = (0..27).find_map(|i| {
            let beside = [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1];
            let known = *by_cell.get(&beside)?;
            (places[known as usize].distance(*vertex) <= WELD_M).then_some(known)
        });
        near.unwrap_or_else(|| {
            places.push(*vertex);
            let new = places.len() as u32 - 1;
            by_cell.insert([x, y, z], new);
            new
        })
    });
    let number = number.collect();
    (places, number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::geometry::Solid;
    use crate::physics::world::World;
    use crate::shape::{Primitive, Shape};
    use rapier3d::math::Pose3;
    use std::sync::Arc;

    /// A polygon in the x-y plane, drawn out along z by `depth` about z = 0. `triangles` cut the polygon.
    fn prism(outline: &[(f32, f32)], triangles: &[[u32; 3]], depth: f32) -> Piece {
        let count = outline.len() as u32;
        let at = |z: f32| outline.iter().map(move |&(x, y)| Vec3::new(x, y, z));
        let vertices = at(0.5 * depth).chain(at(-0.5 * depth)).collect();
        let mut all: Vec<[u32; 3]> = triangles.to_vec();
        all.extend(triangles.iter().map(|&[a, b, c]| [a + count, c + count, b + count]));
        for i in 0..count {
            let j = (i + 1) % count;
            all.extend([[i, i + count, j], [j, i + count, j + count]]);
        }
        Piece { vertices, triangles: all, extras: None }
    }

    /// An L: a foot of 0.3 m × 0.1 m with a wall of 0.1 m × 0.2 m on its left end, 0.2 m deep.
    fn l() -> Piece {
        let outline = [(0.0, 0.0), (0.3, 0.0), (0.3, 0.1), (0.1, 0.1), (0.1, 0.3), (0.0, 0.3)];
        prism(&outline, &[[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]], 0.2)
    }

    fn solid(concave: Concave) -> Solid {
        Solid::of(&Shape::of(Primitive::Concave(Arc::new(concave))))
    }

    #[test]
    fn the_notch_of_an_l_is_empty_and_its_pieces_fill_the_rest() {
        let solid = solid(concave(closed(&l()).unwrap()).unwrap());
        assert!(solid.parts.len() >= 2);
        let (mut filled, mut empty) = (0, 0);
        for i in 0..60u8 {
            for j in 0..60u8 {
                let (x, y) = (0.005 * (f32::from(i) + 0.5), 0.005 * (f32::from(j) + 0.5));
                let gap_m = solid.distance_to_point_m(&Pose3::identity(), Vec3::new(x, y, 0.07));
                if x < 0.1 || y < 0.1 {
                    assert!(gap_m < 1e-4, "({x}, {y}) is {gap_m} m from the nearest piece");
                    filled += 1;
                } else if x.min(y) > 0.1 + 0.3 / 64.0 {
                    assert!(gap_m > 0.0, "({x}, {y}) lies in a piece");
                    empty += 1;
                }
            }
        }
        assert!(filled > 1500 && empty > 1300, "{filled} {empty}");
        // Unlike its hull.
        let hull = convex::hull_of(&l()).unwrap();
        let hull = Solid::of(&Shape { parts: vec![hull] });
        assert_eq!(hull.distance_to_point_m(&Pose3::identity(), Vec3::new(0.15, 0.15, 0.0)), 0.0);
    }

    #[test]
    fn mass_and_inertia_are_those_of_the_mesh() {
        let solid = solid(concave(closed(&l()).unwrap()).unwrap());
        let mut world = World::new(1.0 / 60.0);
        let handle = world.add_movable(&solid, Pose3::identity(), 2.0, 0.5);
        world.step();
        let found = world.body(handle).mass_properties().local_mprops;
        // By hand: the foot has 6 of 10 parts of the area, the wall 4.
        let (foot_kg, wall_kg, depth) = (1.2_f32, 0.8_f32, 0.2_f32);
        let centre = (Vec3::new(0.15, 0.05, 0.0) * foot_kg + Vec3::new(0.05, 0.2, 0.0) * wall_kg) / 2.0;
        assert!((found.local_com - centre).length() < 1e-4, "{found:?}");
        assert!((found.mass() - 2.0).abs() < 1e-5);
        let block = |kg: f32, w: f32, h: f32| {
            kg / 12.0 * Vec3::new(h * h + depth * depth, w * w + depth * depth, w * w + h * h)
        };
        let aside = |kg: f32, at: Vec3| {
            let d = at - centre;
            kg * Vec3::new(d.y * d.y, d.x * d.x, d.x * d.x + d.y * d.y)
        };
        let expected = block(foot_kg, 0.3, 0.1)
            + block(wall_kg, 0.1, 0.2)
            + aside(foot_kg, Vec3::new(0.15, 0.05, 0.0))
            + aside(wall_kg, Vec3::new(0.05, 0.2, 0.0));
        let inertia = found.reconstruct_inertia_matrix();
        let diagonal = Vec3::new(inertia.x_axis.x, inertia.y_axis.y, inertia.z_axis.z);
        assert!((diagonal - expected).abs().max_element() < 1e-4, "{diagonal} instead of {expected}");
    }

    #[test]
    fn the_same_mesh_gives_the_same_pieces_to_the_bit() {
        let pieces = || concave(closed(&l()).unwrap()).unwrap();
        let text = format!("{:?}", pieces());
        assert_eq!(format!("{:?}", pieces()), text);
        // Noted on x86-64 with AVX2.
        assert_eq!(xxhash_rust::xxh3::xxh3_64(text.as_bytes()), 17451421212537682429);
    }

    #[test]
    fn which_way_round_and_how_often_a_vertex_is_written_does_not_matter() {
        let whole = closed(&l()).unwrap();
        assert!((whole.volume_m3 - 0.01).abs() < 1e-6);
        let mut turned = l();
        for triangle in &mut turned.triangles {
            triangle.swap(0, 1);
        }
        assert!((closed(&turned).unwrap().volume_m3 - 0.01).abs() < 1e-6);
        // Every triangle with corners of its own, a rounding apart.
        let mut split = Piece::default();
        for (index, triangle) in l().triangles.iter().enumerate() {
            let first = split.vertices.len() as u32;
            split.triangles.push([first, first + 1, first + 2]);
            let off = if index % 2 == 0 { 1e-7 } else { -1e-7 };
            split.vertices.extend(triangle.map(|corner| l().vertices[corner as usize] + Vec3::splat(off)));
        }
        assert_eq!(closed(&split).unwrap().vertices.len(), 12);
    }

    #[test]
    fn what_has_no_inside_is_refused() {
        let mut open = l();
        open.triangles.pop();
        assert_eq!(closed(&open), Err(NoSolid::Open { edges: 3 }));
        let mut many = l();
        many.triangles = vec![[0, 1, 2]; TRIANGLES_MOST + 1];
        assert_eq!(closed(&many), Err(NoSolid::TooManyTriangles { triangles: TRIANGLES_MOST + 1 }));
    }
}
